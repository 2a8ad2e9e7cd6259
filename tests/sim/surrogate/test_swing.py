"""The first swing: of a motion by formula, and of the world's finger against material points."""

import numpy as np
import pytest

from pneutac_sim.surrogate.swing import Swing, released
from pneutac_sim.world.soft_finger import sensor
from pneutac_sim.world.station import Station
from pneutac_sim.world.world import World

DT = Station().dt_s


@pytest.mark.parametrize("step_s, seconds", [(0.002, 0.5), (DT, 2.0)])
def test_a_damped_cosine_is_found_again(step_s, seconds):
    time_s = step_s * np.arange(int(seconds / step_s))
    bend = 0.3 + 0.02 * np.exp(-0.2 * 27 * time_s) * np.cos(27 * time_s + 0.4)
    found = Swing.of(time_s, bend)
    assert found.frequency_hz == pytest.approx(27 / (2 * np.pi), rel=1e-4)
    assert found.damping_ratio == pytest.approx(0.2 / np.hypot(1, 0.2), rel=1e-3)


@pytest.mark.nightly
def test_the_worlds_finger_swings_as_material_points_do():
    """First frequency and damping of a bend that is let go, with the sensor on; nothing of it is fitted."""
    world = World("switch", touch="none", fidelity="surrogate")
    world.reset(0)
    levers = 1e-3 * (world.twin.length_mm - np.array(world.twin.spine_joint_positions_mm))
    world.data.qfrc_applied[world._spine] = 0.1 * levers
    for _ in range(30):
        world.step([0.0, 0.0, 0.0, 0.0])
    world.data.qfrc_applied[:] = 0.0
    bends = []
    for _ in range(25):
        world.step([0.0, 0.0, 0.0, 0.0])
        bends.append(world.spine_rad @ levers)
    own = Swing.of(DT * np.arange(25), np.array(bends))
    full = released(world.twin, world.finger.controller_nm_per_rad, 0.4, sensor=sensor(world.twin))
    assert 3.0 < full.frequency_hz < 6.0 and 0.1 < full.damping_ratio < 0.3
    assert own.frequency_hz == pytest.approx(full.frequency_hz, rel=0.03)
    assert own.damping_ratio == pytest.approx(full.damping_ratio, rel=0.05)
