"""Worlds of other control rates are the same world."""

import numpy as np
import pytest

from pneutac_sim.world.gantry import Gantry
from pneutac_sim.world.station import Station
from pneutac_sim.world.varied import Variation, VariedWorld

HELD_S = 0.2  # of each command: whole control steps at all of these rates
AWAY = Variation(shift_m=(0.0, 0.0, -5.0))


def free_world(control_hz):
    world = VariedWorld("switch", touch="probe", station=Station(control_hz=control_hz))
    world.variation = AWAY
    world.reset(3)
    return world


def free_way(control_hz):
    """Flange (n, 3) in mm, tip (n, 3) in mm and pressure (n,) after each of some commands in free air."""
    world, rng, rows = free_world(control_hz), np.random.default_rng(0), []
    for _ in range(15):
        action = np.append(rng.uniform(-0.05, 0.05, 3), rng.uniform(2, 12))
        for _ in range(world.station.steps(HELD_S)):
            world.step(action)
        rows.append([*1e3 * world.flange_m, *world.tip[:3], world.pressure_kpa])
    assert world.time_s == pytest.approx(15 * HELD_S)
    return np.array(rows)


@pytest.mark.parametrize("control_hz", [5, 10, 30, 60])
def test_the_free_finger_goes_the_same_way_in_seconds(control_hz):
    at_15, other = free_way(15), free_way(control_hz)
    assert np.ptp(at_15[:, 5]) > 10  # mm: the finger bends
    np.testing.assert_allclose(other[:, :6], at_15[:, :6], atol=0.1)  # mm
    np.testing.assert_allclose(other[:, 6], at_15[:, 6], atol=1e-9)


def test_the_gantry_looks_ahead_at_the_rate_of_its_world():
    world = free_world(30)
    gantry = Gantry(world)
    actions = np.tile([0.05, 0.0, -0.02, 8.0], (12, 1))
    gantry.mirror(world)
    planned, _ = gantry.rollouts(actions[None])
    for action in actions:
        world.step(action)
    np.testing.assert_allclose(planned[0, -1], world.flange_m, atol=2e-4)
