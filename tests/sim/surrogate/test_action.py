"""The action network: values, files, range; and that what is learned of a few motions helps on others.

The skeleton: against MuJoCo's dynamics, its own inverse, and what must be conserved.
"""

import dataclasses

import mujoco
import numpy as np
import pytest

from pneutac_sim.errors import InputError
from pneutac_sim.executor import ExecutorOptions
from pneutac_sim.mpm.body import Body, Material, Spine
from pneutac_sim.surrogate.action import FEWEST, split, train_action
from pneutac_sim.surrogate.collect import Plan, collect_action, joint_targets, read_motions
from pneutac_sim.surrogate.finger import SurrogateFinger, fingerprint, gel_fingerprint, network_of
from pneutac_sim.surrogate.network import MARGIN, ActionNetwork
from pneutac_sim.surrogate.skeleton import Skeleton, advance
from pneutac_sim.twin import Twin, Value


def states(network, count, rng):
    wide = network.high - network.low
    return network.low + wide * rng.uniform(0.02, 0.98, (count, len(wide)))


def test_value_is_that_of_torch(network):
    import torch

    nn = torch.nn
    model = nn.Sequential(
        nn.Linear(9, 128), nn.Softsign(), nn.Linear(128, 128), nn.Softsign(), nn.Linear(128, 4)
    )
    with torch.no_grad():
        for p, layer in zip(model.parameters(), network.layers, strict=True):
            p.copy_(torch.tensor(layer.T))
        x = states(network, 50, np.random.default_rng(1))
        out = model(torch.tensor((x - network.mean) / network.scale, dtype=torch.float32)).numpy()
    straight = (x - network.mean) / network.scale @ network.slope
    expected = network.torque_mean + straight + network.torque_scale * out
    found = network.torque(x[:, :4], x[:, 4:8], x[:, 8])
    np.testing.assert_allclose(found, expected, atol=2e-7)
    assert np.ptp(expected, axis=0).min() > 1e-2  # it is no constant


def test_files_that_are_none(network, tmp_path):
    file = network.save(tmp_path / "action.safetensors")
    whole = file.read_bytes()
    for broken in (whole[: len(whole) // 2], b"", b"not a tensor file"):
        file.write_bytes(broken)
        with pytest.raises(InputError, match=r"action\.safetensors is corrupted.*pneutac surrogate"):
            ActionNetwork.load(file)
    with pytest.raises(InputError, match="There is no action network"):
        ActionNetwork.load(tmp_path / "none.safetensors")
    spoilt = dataclasses.replace(network, mean=np.full(9, np.nan)).save(tmp_path / "nan.safetensors")
    with pytest.raises(InputError, match="array 'mean' must be finite"):
        ActionNetwork.load(spoilt)


def test_motion_ends_where_it_rests(network):
    still = dataclasses.replace(
        network, layers=(*network.layers[:4], network.layers[4] * 0.1, network.layers[5])
    )
    target, p = np.array([0.2, 0.1, 0.15, 0.2]), 7.0
    q, v, in_range = still.roll(target, np.zeros(4), np.tile(target, (501, 1)), np.full(501, p), 2.0)
    assert np.abs(v[-1]).max() < 1e-3
    assert in_range[-1]
    balance = 20.0 * (q[-1] - target) - still.torque(q[-1:], np.zeros((1, 4)), [p])[0]
    assert np.abs(balance).max() < 1e-6


def test_out_of_range_is_told_and_stays_finite(network):
    cmd = joint_targets(Twin.builtin(), np.array(5.0))
    assert network.resistance(cmd, cmd)[2]
    margin = 15.0 * (1 + MARGIN)
    for pressure, inside in ((margin - 0.01, True), (margin + 0.01, False)):
        q = joint_targets(Twin.builtin(), np.array(pressure))
        # the pressure is out of range, the joint angles are not
        assert network.resistance(q, cmd)[2] == inside
    torque, J, inside = network.resistance(cmd, np.full(4, 1e3))
    assert not inside
    straight = network.slope[:4] / network.scale[:4, None]
    assert np.isfinite(torque).all()
    np.testing.assert_allclose(J, (straight + straight.T) / 2, atol=1e-4)  # of numbers of 1e3, in 32 bits
    wild = np.random.default_rng(3).normal(size=(200, 4)) * 5
    q, v, in_range = network.roll(cmd, np.full(4, 100.0), wild, np.full(200, 1e6), 2.0)
    assert not in_range.any()
    assert np.isfinite(q).all()
    assert np.abs(q).max() < 1e3


def test_the_resistance_is_the_difference_of_torques_and_its_slope(network):
    free, q = np.array([0.2, 0.1, 0.15, 0.2]), np.array([0.25, 0.14, 0.12, 0.16])
    torque, J, inside = network.resistance(free, q)
    p = [float(network.pressure_kpa(free))]
    at = [network.torque(x[None], np.zeros((1, 4)), p)[0] for x in (q, free)]
    np.testing.assert_allclose(torque, at[0] - at[1], atol=1e-12)
    assert inside and not network.resistance(q, q)[0].any()
    near = 0.02 * np.eye(4)
    ahead, back = (network.torque(q + h, np.zeros((4, 4)), 4 * p).T for h in (near, -near))
    slope = (ahead - back) / 0.04
    np.testing.assert_allclose(J, (slope + slope.T) / 2, atol=1e-9)


def test_a_network_serves_its_twin_alone(network):
    twin = Twin.builtin()
    for change in (
        lambda t: t.parameters.update(youngs_modulus_mpa=Value(2.0)),
        lambda t: t.parameters.update(poissons_ratio=Value(0.3)),
        lambda t: t.arrays.update(mesh_faces=np.zeros((1, 3), np.int32)),
        lambda t: setattr(t, "length_mm", 111.0),
    ):
        other = twin.copy()
        change(other)
        assert fingerprint(other) != fingerprint(twin)
        assert gel_fingerprint(other) == gel_fingerprint(twin)
        with pytest.raises(InputError, match="another body.*pneutac surrogate"):
            SurrogateFinger(other, network)
    same = twin.copy()
    same.history.append({"version": 0})
    same.effects |= {"camera_misalignment": {}, "valve_lag": {"tau_fill_s": Value(0.3)}}
    same.parameters["gain_rad_per_kpa"] = Value(0.02)
    assert fingerprint(same) == fingerprint(twin)
    stiffer, stickier = twin.copy(), twin.copy()
    stiffer.parameters["gel_youngs_modulus_mpa"] = Value(0.2)  # scales forces and moves nothing
    stickier.parameters["gel_poissons_ratio"] = Value(0.4)
    assert gel_fingerprint(stiffer) == gel_fingerprint(twin) != gel_fingerprint(stickier)


def test_another_modulus_scales_the_torque_of_the_body(network, tmp_path):
    """E f(q), so a network that tells of what modulus it was trained serves every other one."""
    twin, stiffer = Twin.builtin(), Twin.builtin()
    own = twin.parameter("youngs_modulus_mpa")
    stiffer.parameters["youngs_modulus_mpa"] = Value(1.3 * own)
    told = ActionNetwork.load(dataclasses.replace(network, modulus_mpa=own).save(tmp_path / "a.safetensors"))
    free, q = np.array([0.2, 0.1, 0.15, 0.2]), np.array([0.25, 0.14, 0.12, 0.16])
    torque, J, _ = network_of(twin, told).resistance(free, q)
    again = ActionNetwork.load(network_of(stiffer, told).save(tmp_path / "b.safetensors"))
    for scaled in (network_of(stiffer, told), network_of(stiffer, again)):
        more, slope, _ = scaled.resistance(free, q)
        np.testing.assert_allclose(more, 1.3 * torque, rtol=1e-5)
        np.testing.assert_allclose(slope, 1.3 * J, rtol=1e-4, atol=1e-5)
    stiffer.length_mm = 111.0
    with pytest.raises(InputError, match="another body.*pneutac surrogate"):
        SurrogateFinger(stiffer, told)
    odd = tmp_path / "odd.safetensors"
    odd.write_bytes((tmp_path / "b.safetensors").read_bytes().replace(repr(1.3 * own).encode(), b"0" * 6, 1))
    with pytest.raises(InputError, match="'modulus_mpa' is '0"):
        ActionNetwork.load(odd)


def test_too_few_or_missing_trajectories(tmp_path):
    with pytest.raises(InputError, match=f"at least {FEWEST} with `pneutac surrogate`"):
        split([None] * (FEWEST - 1))
    with pytest.raises(InputError, match="no trajectories.*pneutac surrogate"):
        train_action(Twin.builtin(), tmp_path)
    with pytest.raises(InputError, match="of a finger"):
        collect_action(Twin("arm", 110.0), tmp_path)


TINY = Plan(2, 0.05, particles=200)


@pytest.fixture(scope="module")
def collection(tmp_path_factory):
    """Two short motions of a coarse finger."""
    folder = tmp_path_factory.mktemp("motions")
    collect_action(Twin.builtin(), folder, TINY, "cpu")
    return folder


@pytest.mark.nightly  # every day: an interrupted training goes on, in test_surrogate
@pytest.mark.slow
def test_an_interrupted_collection_goes_on(collection):
    twin, plan, told = Twin.builtin(), TINY, []
    assert len(collect_action(twin, collection, plan, "cpu", told.append)) == 2
    assert not told  # nothing was left to do
    with pytest.raises(InputError, match="another twin or plan"):
        collect_action(twin, collection, dataclasses.replace(plan, seed=1), "cpu")
    file = collection / "action_001.safetensors"
    kept = file.read_bytes()
    before = read_motions(collection, twin)[1][1]
    file.unlink()
    with pytest.raises(InputError, match="action_001.*missing.*pneutac surrogate"):
        read_motions(collection, twin)
    collect_action(twin, collection, plan, "cpu", told.append, ExecutorOptions(workers=1))
    assert told[0] == "collected 1 of 2 trajectories"
    after = read_motions(collection, twin)[1][1]
    np.testing.assert_allclose(after.q, before.q, atol=2e-3)
    file.write_bytes(kept[:200])
    with pytest.raises(InputError, match="corrupted"):
        read_motions(collection, twin)
    file.write_bytes(kept)


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
    resting = s.coupling, s.inertia, s.stiffness_nm_per_rad, s.damping_nms_per_rad, s.loss_per_s
    out = [(q.copy(), v.copy())]
    for _ in range(steps):
        advance(*resting, q, v, target, target, torque, h, np.inf)
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
