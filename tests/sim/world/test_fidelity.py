"""Networks and full gel in the world: near the full simulation, same spaces, flags, foreign networks."""

from functools import partial

import numpy as np
import pytest
import trimesh
from played import press_bar
from scipy.spatial.transform import Rotation

from pneutac_sim.errors import InputError
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.probe import probe_grid
from pneutac_sim.mpm import devices
from pneutac_sim.mpm.solve import solve_equilibrium
from pneutac_sim.mpm.total_lagrangian import Loads
from pneutac_sim.surrogate.collect import joint_targets
from pneutac_sim.surrogate.finger import Networks, builtin, fits
from pneutac_sim.twin import Twin, Value
from pneutac_sim.world.env import PneutacEnv
from pneutac_sim.world.mpm_gel import MpmFinger, MpmGel
from pneutac_sim.world.world import World

pytestmark = pytest.mark.slow

PUSH, STILL = np.array([0.05, 0.0, 0.0, 9.0]), np.array([0.0, 0.0, 0.0, 9.0])


@pytest.fixture(scope="module")
def bodies():
    twin = Twin.builtin()
    return twin, MpmFinger(twin), Networks.of(twin).finger(twin)


def tip_mm(twin, q):
    """x + i z of the tip."""
    joints = np.append(twin.spine_joint_positions_mm, twin.length_mm)
    return joints[0] + (np.exp(1j * np.cumsum(q)) * np.diff(joints)).sum()


def under(body, twin, free, force_n):
    """Joint angles under a force x + i z on the tip, by Newton: K_c (free - q) + f(q) - f(free) + tau = 0."""
    q, K = free.copy(), body.controller_nm_per_rad
    for _ in range(8):
        torque, J = body.torque(free, q)
        rest = K * (free - q) + torque + (to_tip(twin, q).conj() * force_n).imag
        q = q + np.linalg.solve(K * np.eye(len(q)) - J, rest)
    assert np.abs(rest).max() < 1e-5
    return q


def to_tip(twin, q):
    """x + i z in m from each joint to the tip."""
    ways = np.diff(np.append(twin.spine_joint_positions_mm, twin.length_mm)) * 1e-3
    return (np.exp(1j * np.cumsum(q)) * ways)[::-1].cumsum()[::-1]


@pytest.mark.parametrize(
    "pressure_kpa", [*(pytest.param(p, marks=pytest.mark.nightly) for p in (0.0, 7.5)), 15.0]
)
def test_a_force_at_the_tip_moves_it_as_far_with_the_network_as_with_material_points(bodies, pressure_kpa):
    """What material points say otherwise of the torque at a loaded pose would move the tip by 5 % at most."""
    twin, _, network = bodies
    free, K = joint_targets(twin, pressure_kpa), network.controller_nm_per_rad * np.eye(4)
    loaded = [under(network, twin, free, n * way) for n in (0.1, 0.3, 0.6) for way in (1j, -1j, 1.0)]
    solver = devices.finger(twin, batch=1 + len(loaded))
    poses = np.stack([free, *loaded])
    rest = solve_equilibrium(solver, Loads(q_cmd=poses * 1.01), tolerance=1e-3)
    for q, held, torque in zip(loaded, rest.q[1:], rest.body_torque[1:], strict=True):
        got, J = network.torque(rest.q[0].astype(float), held.astype(float))
        assert network.in_range
        wrong = np.linalg.solve(K - J, got - (torque - rest.body_torque[0]))
        tip_moves = abs((wrong * 1e3 * to_tip(twin, q)).sum())
        moved = abs(tip_mm(twin, q) - tip_mm(twin, free))
        assert tip_moves < 0.05 * moved + 0.1, "and 0.1 mm for the equilibrium itself"


def test_the_bodys_stiffness_is_that_of_its_material(bodies):
    """Twice the modulus, twice the body's stiffness; the chamber has what is left of the whole."""
    twin, full, network = bodies
    _, J = full.torque(np.zeros(4), np.zeros(4))
    np.testing.assert_allclose(J, J.T, atol=1e-9)
    assert np.linalg.eigvalsh(J).max() < 0
    stiffer = twin.copy()
    stiffer.parameters["youngs_modulus_mpa"] = Value(1.2 * twin.parameter("youngs_modulus_mpa"))
    other = MpmFinger(stiffer)
    _, more = other.torque(np.zeros(4), np.zeros(4))
    np.testing.assert_allclose(more.diagonal(), 1.2 * J.diagonal(), rtol=0.05)
    assert other.controller_nm_per_rad < full.controller_nm_per_rad
    assert network.controller_nm_per_rad == pytest.approx(full.controller_nm_per_rad, rel=0.1)
    scaled = Networks.of(stiffer).finger(stiffer)
    np.testing.assert_allclose(
        scaled.torque(np.zeros(4), np.zeros(4))[1].diagonal(), more.diagonal(), rtol=0.1
    )
    assert scaled.controller_nm_per_rad == pytest.approx(other.controller_nm_per_rad, rel=0.1)
    w = twin.length_mm - np.array(twin.spine_joint_positions_mm)
    for body, twin_ in ((full, twin), (other, stiffer)):
        K = body.controller_nm_per_rad * np.eye(4) - body.torque(np.zeros(4), np.zeros(4))[1]
        whole = (w @ w) / (w @ np.linalg.solve(K, w))
        assert whole == pytest.approx(twin_.parameter("joint_stiffness_nm_per_rad"), rel=1e-4)


def test_a_body_stiffer_than_the_whole_finger_is_refused(bodies):
    twin = bodies[0].copy()
    twin.parameters["joint_stiffness_nm_per_rad"] = Value(0.1)
    with pytest.raises(InputError, match="soft body alone resists.*joint_stiffness_nm_per_rad"):
        World("switch", twin, touch="none", fidelity="surrogate")


def test_all_fidelities_share_the_spaces():
    surrogate, probe = PneutacEnv("switch"), PneutacEnv("switch", fidelity="probe")
    assert surrogate.observation_space == probe.observation_space
    assert surrogate.action_space == probe.action_space
    _, info = surrogate.reset(seed=0)
    assert info["out_of_range"] == 0
    surrogate.close(), probe.close()


def test_a_gel_that_is_pressed_deeper_than_in_training_is_counted():
    world = World("switch", touch="area", fidelity="surrogate")
    world.reset(0)
    world.step(PUSH)
    assert world.out_of_range == 0 and world.touch.in_range
    press_bar(world, 0.004)  # a bar of 6.5 mm radius: 2.5 mm deep
    assert not world.touch.in_range and np.isfinite(world.touch.area) and world.touch.area > 0


def test_another_effect_keeps_the_networks_and_another_body_needs_its_own(tmp_path):
    twin = Twin.builtin()
    twin.effects["stiffening"] = {"linear_1_per_kpa": Value(0.02), "quadratic_1_per_kpa2": Value(0.0)}
    assert fits(builtin("action"), "action", twin) and fits(builtin("perception"), "perception", twin)
    twin.parameters["poissons_ratio"] = Value(0.4)
    with pytest.raises(InputError, match="has no action network.* run `pneutac surrogate"):
        World("switch", twin, touch="none", fidelity="surrogate")
    twin.save(tmp_path / "twin")
    twin.networks = {"action": builtin("action")}
    twin.save(tmp_path / "twin")
    stored = Twin.load(tmp_path / "twin")
    assert stored.networks["action"].parent == tmp_path / "twin"
    with pytest.raises(InputError, match="trained for another finger, or before its shape"):
        Networks.of(stored)
    assert World("switch", stored, touch="none", fidelity="probe").finger is None


@pytest.mark.nightly  # every day: the gel's face lies on the ball, in tests/sim/mpm
def test_the_full_gel_feels_a_ball_as_the_material_points_under_an_indenter_do(monkeypatch):
    """Both with an eighth of the particles."""
    monkeypatch.setattr(devices, "gel", partial(devices.gel, counts=(30, 40, 7)))
    twin, depth = Twin.builtin(), 0.7
    ball = ([2], np.array([[4e-3, 0, 0]]), np.array([[1e-3, 2e-3, 4e-3 - 1e-3 * depth]]), np.eye(3)[None])
    placed = (*ball, np.zeros(3), np.eye(3))
    gel = MpmGel(twin)
    gel.show(*placed)
    moved = gel.displacement(probe_grid(*placed))
    solver = devices.gel(twin)
    solve_equilibrium(solver, devices.press_loads(Press("sphere", 4.0, 1.0, 2.0, depth)))
    wanted = devices.surface_displacement(solver, (12.0, 16.0))[0]
    assert np.abs(moved - wanted).mean() < 0.005 and np.abs(moved - wanted).max() < 0.06
    gel.release()
    triangles = trimesh.creation.icosphere(4, 4e-3).triangles
    turned = Rotation.from_rotvec([0.3, 0.1, 0.2]).as_matrix()
    gel.show([7], [(0, len(triangles), 4e-3)], ball[2], [turned], np.zeros(3), np.eye(3), triangles)
    assert np.abs(gel.displacement(probe_grid(*placed)) - moved).max() < 0.02
