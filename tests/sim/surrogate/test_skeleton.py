"""The skeleton: against MuJoCo's dynamics, its own inverse, and what must be conserved."""

import mujoco
import numpy as np
import pytest

from pneutac_sim.errors import InputError
from pneutac_sim.mpm.body import Body, Material
from pneutac_sim.mpm.spine import Spine
from pneutac_sim.surrogate.skeleton import Skeleton, advance

JOINTS = (0.01, 0.035, 0.06, 0.08)
SPACING = 0.004


def body():
    """A bar of 100 x 16 x 12 mm above its spine, so that the links' centres lie off the hinges' line."""
    rubber = Material(1e6, 0.4, 1100.0)
    return Body.box("bar", (25, 4, 3), SPACING, rubber, origin_m=(0.0, -0.008, -0.002), clamp="x-")


def spine(K=20.0, D=0.01, axes=1):
    return Spine(JOINTS, 0.1, 0.0, 0.0, 0.006, axes, K, D)


@pytest.fixture(scope="module")
def skeleton():
    return Skeleton.of(body(), spine())


@pytest.fixture(scope="module")
def reference():
    """The same chain in MuJoCo: hinges about -y, each link with the mass of the particles beside it."""
    b, spec = body(), mujoco.MjSpec()
    spec.option.gravity = (0, 0, 0)
    parent, at = spec.worldbody, 0.0
    mass = b.material.density_kg_m3 * SPACING**3
    for k, x in enumerate(JOINTS):
        end = JOINTS[k + 1] if k + 1 < len(JOINTS) else np.inf
        own = b.positions[(b.positions[:, 0] > x) & (b.positions[:, 0] < end)] - [x, 0, 0]
        r = own - own.mean(0)
        turn = mass * (np.diag([(r**2).sum()] * 3) - r.T @ r + np.eye(3) * len(r) * SPACING**2 / 6)
        parent = parent.add_body(
            pos=(x - at, 0, 0), mass=mass * len(own), ipos=own.mean(0), explicitinertial=True,
            fullinertia=(*np.diag(turn), turn[0, 1], turn[0, 2], turn[1, 2]),
        )  # fmt: skip
        parent.add_joint(
            type=mujoco.mjtJoint.mjJNT_HINGE, axis=(0, -1, 0), stiffness=[20.0, 0, 0], damping=[0.01, 0, 0]
        )
        at = x
    return spec.compile()


def test_mass_and_inverse_dynamics_are_those_of_mujoco(skeleton, reference):
    data = mujoco.MjData(reference)
    rng = np.random.default_rng(0)
    for _ in range(5):
        q, v, a = rng.normal(size=(3, 4)) * np.array([[0.5], [5.0], [300.0]])
        target = 0.2 * rng.normal(size=4)
        data.qpos, data.qvel, data.qacc = q, v, a
        mujoco.mj_inverse(reference, data)
        M = np.zeros((4, 4))
        mujoco.mj_fullM(reference, data, M)
        np.testing.assert_allclose(skeleton.mass(q), M, rtol=1e-9, atol=1e-12)
        torque = skeleton.residual_torque(q[None], v[None], a[None], target[None])[0]
        np.testing.assert_allclose(torque, data.qfrc_inverse - 20.0 * target, rtol=1e-9, atol=1e-9)


def swing(skeleton, q, v, target, torque, h, steps):
    """Frames (steps + 1, N) of angles and rates under a constant torque."""
    s, q, v = skeleton, np.array(q, float), np.array(v, float)
    out = [(q.copy(), v.copy())]
    for _ in range(steps):
        advance(
            s.coupling,
            s.inertia,
            s.stiffness_nm_per_rad,
            s.damping_nms_per_rad,
            s.loss_per_s,
            q,
            v,
            target,
            target,
            torque,
            h,
            np.inf,
        )
        out.append((q.copy(), v.copy()))
    return [np.array(x) for x in zip(*out, strict=True)]


def energy(skeleton, q, v):
    kinetic = [0.5 * b @ skeleton.mass(a) @ b for a, b in zip(q, v, strict=True)]
    return np.array(kinetic) + 0.5 * skeleton.stiffness_nm_per_rad * (q**2).sum(1)


def test_energy_stays_without_damping_and_falls_with_it():
    free = Skeleton.of(body(), spine(D=0.0))
    start, zero = np.array([0.15, 0.1, 0.12, 0.1]), np.zeros(4)
    lost = []
    for h, steps in ((2e-5, 10_000), (1e-5, 20_000)):
        q, v = swing(free, start, zero, zero, zero, h, steps)
        total = energy(free, q, v)
        lost.append(np.abs(total / total[0] - 1).max())
    assert lost[0] < 0.01
    assert lost[1] < 0.3 * lost[0]  # of second order at least
    q, v = swing(Skeleton.of(body(), spine(D=0.01)), start, zero, zero, zero, 1e-4, 10_000)
    assert energy(free, q[-1:], v[-1:])[0] < 1e-3 * total[0]


def test_stable_at_steps_far_beyond_its_fastest_swing(skeleton):
    rates = np.sqrt(np.linalg.eigvals(20.0 * np.linalg.inv(skeleton.mass(np.zeros(4)))).real)
    h = 10 / rates.max()
    q, v = swing(skeleton, np.zeros(4), 50 * np.ones(4), np.zeros(4), np.zeros(4), h, 2000)
    assert np.isfinite(q).all()
    assert np.abs(q).max() < 5


def test_what_it_cannot_be_made_of():
    with pytest.raises(InputError, match="two axes"):
        Skeleton.of(body(), spine(axes=2))
    with pytest.raises(InputError, match="no particle beyond spine joint 4"):
        Skeleton.of(body(), Spine((0.01, 0.03, 0.05, 0.0995), 0.1, 0.0, 0.0, 0.006))
