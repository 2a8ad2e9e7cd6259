"""The spine: skeleton dynamics, two-way coupling, balance of torques."""

import numpy as np
import pytest

from pneutac_sim.errors import InputError
from pneutac_sim.mpm.body import Body, Material, Spine
from pneutac_sim.mpm.solve import simulate, solve_equilibrium
from pneutac_sim.mpm.total_lagrangian import Loads, TotalLagrangian

SPACING = 4e-3
COUNTS = (24, 4, 4)
LENGTH = COUNTS[0] * SPACING
MIDDLE = 2 * SPACING


class Skeleton(Spine):
    """Carries every node, so that no soft part is left behind by a fast swing."""

    def bind(self, body, grid):
        link = np.searchsorted(self.joint_positions_m, grid.nodes[:, 0]) * self.axes
        return np.where(grid.mirrored, -1, link).astype(np.int32)


def arm(material, joints=(0.2, 0.45, 0.7), spine=Spine, **values):
    body = Body.box("arm", COUNTS, SPACING, material, clamp="x-")
    values = {"radius_m": 6e-3, "stiffness_nm_per_rad": 1.0, "damping_nms_per_rad": 1e-3} | values
    places = tuple(LENGTH * j for j in joints)
    return TotalLagrangian(body, spine(places, LENGTH, MIDDLE, MIDDLE, **values), device="cpu")


def lumps(solver):
    """Mass (kg), centre x (m) from the base, and inertia about y through it, of each moving link."""
    rho = solver.body.material.density_kg_m3
    rows = []
    for link in range(1, solver.hinges + 1):
        m, p = rho * solver.grid.volume[solver.role == link], solver.grid.nodes[solver.role == link]
        c = (m[:, None] * p).sum(0) / m.sum()
        rows.append((m.sum(), c[0], (m * ((p - c)[:, [0, 2]] ** 2).sum(1)).sum()))
    return np.array(rows)


# Of the bare chain after so many ms, from Lagrange's equations by SciPy's integrator, which is in this
# repository's history (`skeleton` of this file); without Coriolis' terms 0.06 rad off after 3 ms.
LAGRANGE_RAD = {
    3: (0.2242, -0.5498, 0.4720),
    6: (0.2131, -0.3799, 0.1941),
    12: (0.2408, -0.3115, 0.3566),
    24: (0.4406, -0.2411, 0.3750),
    36: (0.4857, -0.2250, 0.3753),
    48: (0.3453, -0.3034, 0.3457),
    60: (0.2001, -0.3852, 0.3180),
}
AIR = Material(1.0, 0.0, 1000.0)  # as heavy as rubber, a hundred thousand times softer


@pytest.mark.slow
def test_one_joint_swings_as_a_damped_oscillator():
    """Period and decay of I q'' + K_d q' + K_p (q - q_cmd) = 0 with the lump's inertia."""
    solver = arm(AIR, joints=(0.3,), spine=Skeleton, damping_nms_per_rad=4e-4)
    m, x, inertia = lumps(solver)[0]
    whole = inertia + m * (x - 0.3 * LENGTH) ** 2
    omega = np.sqrt(1.0 / whole)
    zeta = 4e-4 / (2 * np.sqrt(whole * 1.0))
    assert 0.01 < zeta < 0.5  # the decay can be seen
    period = 2 * np.pi / (omega * np.sqrt(1 - zeta**2))
    out = simulate(
        solver, Loads(q_cmd=np.array([[0.2]])), 2 * period, period / 100, dt=period / 4000, particles=False
    )
    t, w = out.time_s, omega * np.sqrt(1 - zeta**2)
    decay = np.exp(-zeta * omega * t)
    expected = 0.2 * (1 - decay * (np.cos(w * t) + zeta / np.sqrt(1 - zeta**2) * np.sin(w * t)))
    assert np.abs(out.q[:, 0, 0] - expected).max() < 0.02 * 0.2


@pytest.mark.slow
def test_three_joints_move_as_the_bare_skeleton():
    """Large swings, so that Coriolis' and centrifugal terms count, under gravity."""
    solver = arm(AIR, spine=Skeleton, stiffness_nm_per_rad=0.5, damping_nms_per_rad=2e-4)
    loads = Loads(q_cmd=np.array([[0.35, -0.3, 0.35]]), gravity=np.array([3.0, 0, -9.81]))
    out = simulate(solver, loads, 0.06, 1e-3, dt=5e-6, particles=False)
    for ms, angles in LAGRANGE_RAD.items():
        np.testing.assert_allclose(out.q[ms, 0], angles, atol=0.01)


RUBBER = Material(2e5, 0.4, 1100.0)
BEND = Loads(q_cmd=np.array([[0.3, 0.25, 0.2]]), gravity=np.array([0, 0, -9.81]))


@pytest.fixture(scope="module")
def bent():
    solver = arm(RUBBER, stiffness_nm_per_rad=0.5)
    parts = []
    rest = solve_equilibrium(
        solver, BEND, tolerance=1e-3, progress=lambda _, done, of: parts.append((done, of))
    )
    assert parts == sorted(parts) and parts[-1] == (100, 100)  # how far the search has come is told
    return solver, rest


def test_torques_balance_at_rest(bent):
    _, e = bent
    assert np.abs(e.controller_torque + e.body_torque).max() < 0.01 * np.abs(e.body_torque).max()
    assert np.abs(BEND.q_cmd - e.q).min() > 0.02  # the body really pushes back


def test_torque_of_the_body_is_the_slope_of_its_energy(bent, reference):
    """At rest the free nodes bear no force: moving the carried ones with a joint costs its torque."""
    solver, e = bent
    x = solver.nodes()[0].astype(float)
    weight = 1100.0 * solver.grid.volume[:, None] * BEND.gravity

    def potential(q):
        moved = x.copy()
        poses = solver.spine.poses(q)
        for link in range(solver.hinges + 1):
            here = solver.role == link
            moved[here] = solver.grid.nodes[here] @ poses[link, :, :3].T + poses[link, :, 3]
        return reference.energy(solver, moved) - (weight * moved)[~solver.grid.mirrored].sum()

    for h in range(solver.hinges):
        step = 1e-5 * np.eye(solver.hinges)[h]
        torque = -(potential(e.q[0] + step) - potential(e.q[0] - step)) / 2e-5
        assert torque == pytest.approx(e.body_torque[0, h], abs=0.01 * float(np.abs(e.body_torque).max()))


def test_the_coupling_does_not_depend_on_the_step():
    ends = []
    for fraction in (1.0, 0.5):
        solver = arm(RUBBER, stiffness_nm_per_rad=0.5)
        step = fraction * solver.stable_dt[0]
        out = simulate(solver, BEND, 0.6, 0.6, damping=60.0, dt=step)
        ends.append((out.q[-1, 0], out.positions[-1, 0]))
    assert np.abs(ends[0][0] - ends[1][0]).max() < 1e-3 * np.abs(ends[0][0]).max()
    assert np.abs(ends[0][1] - ends[1][1]).max() < 0.02 * SPACING


def test_a_spine_outside_the_body_is_refused():
    with pytest.raises(InputError, match="Body 'arm': the spine's link after joint 1 .* outside the body"):
        body = Body.box("arm", COUNTS, SPACING, RUBBER, clamp="x-")
        TotalLagrangian(body, Spine((0.02,), LENGTH, 0.1, 0.1, radius_m=5e-3), device="cpu")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"joint_positions_m": (0.03, 0.02)}, "from base to tip, ascending"),
        ({"length_m": 0.01}, "length_m is 0.01; it must exceed"),
        ({"radius_m": 0.0}, "radius_m is 0.0; it must be positive"),
        ({"cap_m": 0.06}, "cap_m is 0.06; it must lie between 0 and the last link's length"),
    ],
)
def test_an_impossible_spine_is_refused(change, words):
    good = {"joint_positions_m": (0.02, 0.05), "length_m": 0.1, "y_m": 0.01, "z_m": 0.01, "radius_m": 5e-3}
    with pytest.raises(InputError, match=words):
        Spine(**(good | change))


def test_a_joint_target_that_is_no_number_is_refused():
    solver = arm(RUBBER)
    with pytest.raises(InputError, match="Body 'arm': a joint target is not a finite number"):
        simulate(solver, Loads(q_cmd=np.array([[0.1, np.nan, 0.1]])), 0.01, 0.01)
    with pytest.raises(InputError, match="a joint target is not a finite number"):
        solve_equilibrium(solver, Loads(q_cmd=np.array([[0.1, np.nan, 0.1]])))
