"""Networks and full gel in the world: near the full simulation, same spaces, flags, foreign networks."""

import numpy as np
import pytest

from pneutac_sim.errors import InputError
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.probe import probe_grid
from pneutac_sim.surrogate.networks import Networks, builtin, fits
from pneutac_sim.surrogate.programs import joint_targets
from pneutac_sim.twin import Twin, Value
from pneutac_sim.world.env import PneutacEnv
from pneutac_sim.world.mpm_finger import MpmFinger
from pneutac_sim.world.mpm_gel import MpmGel, signed_distance
from pneutac_sim.world.world import World

pytestmark = pytest.mark.slow

PUSH = np.array([0.05, 0.0, 0.0, 9.0])


def flown(fidelity: str, steps: int) -> World:
    world = World("switch", touch="none", fidelity=fidelity)
    world.reset(0)
    for _ in range(steps):
        world.step(PUSH)
    return world


def test_in_free_air_the_finger_bends_alike_at_every_fidelity():
    """The pipeline was calibrated with the soft body on the spine, whose resistance is no news to it."""
    by_network, full, formula = (flown(f, 12).spine_rad for f in ("surrogate", "mpm", "probe"))
    assert np.abs(by_network - formula).max() < np.radians(0.01)
    assert np.abs(full - formula).max() < np.radians(0.01)


def test_under_a_load_the_network_gives_way_as_the_material_points_do():
    twin, torque = Twin.builtin(), np.array([0.08, 0.05, 0.02, 0.005])
    q = joint_targets(twin, 8.0)
    by_points, by_network = MpmFinger(twin), Networks.of(twin).finger(twin)
    np.testing.assert_allclose(by_network.bend(q), q, atol=1e-5)
    np.testing.assert_allclose(by_points.bend(q), q, atol=1e-4)
    for _ in range(2):
        full = by_points.bend(q, torque)
    stiff = q + torque / twin.parameter("joint_stiffness_nm_per_rad")  # with a body that does not resist
    assert np.abs(full - stiff).max() > np.radians(0.1)
    assert np.abs(by_network.bend(q, torque) - full).max() < 0.5 * np.abs(full - stiff).max()


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
    gel = world.data.site_xpos[world.model.site("gel").id]
    normal = world.data.site_xmat[world.model.site("gel").id].reshape(3, 3)[:, 2]
    bar = world.model.geom("bar").id
    world.data.geom_xpos[bar] = gel + 0.004 * normal  # a bar of 6.5 mm radius: 2.5 mm deep
    world.touch.sense(world.data)
    assert not world.touch.in_range and np.isfinite(world.touch.area) and world.touch.area > 0


def test_a_twin_with_another_effect_needs_its_own_networks(tmp_path):
    twin = Twin.builtin()
    assert fits(builtin("action"), "action", twin) and fits(builtin("perception"), "perception", twin)
    twin.effects["stiffening"] = {"linear_1_per_kpa": Value(0.02), "quadratic_1_per_kpa2": Value(0.0)}
    with pytest.raises(InputError, match="has no action network.* run `pneutac surrogate"):
        World("switch", twin, touch="none", fidelity="surrogate")
    twin.save(tmp_path / "twin")
    twin.networks = {"action": builtin("action")}
    twin.save(tmp_path / "twin")
    stored = Twin.load(tmp_path / "twin")
    assert stored.networks["action"].parent == tmp_path / "twin"
    with pytest.raises(InputError, match="trained for another finger, or before its parameters"):
        Networks.of(stored)
    assert World("switch", stored, touch="none", fidelity="probe").finger is None


def test_networks_travel_with_the_twin(tmp_path):
    twin = Twin.builtin()
    twin.networks = {"action": builtin("action")}
    twin.save(tmp_path / "one")
    Twin.load(tmp_path / "one").save(tmp_path / "two")
    there = Twin.load(tmp_path / "two").networks
    assert list(there) == ["action"] and there["action"].parent == tmp_path / "two"
    assert there["action"].read_bytes() == builtin("action").read_bytes()


@pytest.mark.parametrize("kind, size, surface", [
    (2, (0.004, 0, 0), [(0.004, 0, 0), (0, 0, -0.004)]),
    (3, (0.003, 0.005, 0), [(0.003, 0, 0.004), (0, 0, 0.008)]),
    (4, (0.006, 0.018, 0.006), [(0.006, 0, 0), (0, 0.018, 0)]),
    (5, (0.004, 0.006, 0), [(0.004, 0, 0.001), (0.001, 0, -0.006)]),
    (6, (0.002, 0.003, 0.004), [(0.002, 0.001, 0), (0, 0, 0.004)]),
])  # fmt: skip
def test_signed_distances_of_the_shapes_of_a_world(kind, size, surface):
    points = np.array(surface)
    assert np.abs(signed_distance(kind, np.array(size), points)).max() < 1e-12
    out = signed_distance(kind, np.array(size), 1.001 * points)
    assert (out > 0).all() and (out < 1.01e-3 * np.linalg.norm(points, axis=1)).all()
    assert (signed_distance(kind, np.array(size), 0.9 * points) < 0).all()
    with pytest.raises(InputError, match="full gel knows"):
        signed_distance(0, np.ones(3), points)


def test_the_full_gel_feels_a_ball_as_the_material_points_under_an_indenter_do():
    from pneutac_sim.mpm import devices
    from pneutac_sim.mpm.solve import solve_equilibrium

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
