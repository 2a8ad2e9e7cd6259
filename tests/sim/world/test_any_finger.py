"""The world with fingers of other labs: of any size, number of joints, stiffness and range of pressures."""

import logging

import numpy as np
import pytest

from pneutac_sim.features import ACTION_HIGH, CONTROL_HZ
from pneutac_sim.finger.kinematics import gain_profile
from pneutac_sim.twin import Twin, Value
from pneutac_sim.world.env import PneutacEnv
from pneutac_sim.world.expert import ScriptedExpert
from pneutac_sim.world.world import World


def finger(length_mm=80.0, joints=6, stiffness=0.458, range_kpa=(0.0, 60.0)) -> Twin:
    """A finger that bends by 0.9 rad in all from the rest to the farther end of its range."""
    far = max(range_kpa, key=abs)
    parameters = dict(Twin.builtin().parameters)
    parameters |= {
        "gain_rad_per_kpa": Value(0.9 / joints / far),
        "rest_pressure_kpa": Value(0.0),
        "joint_stiffness_nm_per_rad": Value(stiffness),
    }
    at = [length_mm * (i + 0.5) / joints for i in range(joints)]
    return Twin("finger", length_mm, at, parameters, pressure_range_kpa=range_kpa)


@pytest.mark.parametrize(
    ("length_mm", "joints", "stiffness"),
    [
        (40, 2, 2.0),
        (40, 10, 2.0),
        (80, 6, 0.458),
        (110, 4, 20.0),
        (160, 3, 0.05),
        (250, 2, 0.458),
        (250, 10, 5.0),
    ],
)
def test_a_released_bend_dies_away_whatever_the_size_joints_and_stiffness(length_mm, joints, stiffness):
    twin = finger(length_mm, joints, stiffness)
    world = World("switch", twin, "none")
    world.reset(0)
    for _ in range(8):
        world.step([0, 0, 0.05, 60.0])
    profile = gain_profile(joints, twin.parameter("gain_alpha"), twin.parameter("gain_beta"))
    np.testing.assert_allclose(world.spine_rad, 0.9 / joints * profile, atol=0.02)
    spine = world._spine
    world.data.qpos[spine] += 0.1  # let go from beside where it would rest
    energy = []
    for _ in range(25):
        world._advance(world._joints, world.spine_target_rad)
        away, rate = world.spine_rad - world.spine_target_rad, world.data.qvel[spine]
        energy.append(0.5 * stiffness * away @ away + 1e-5 * rate @ rate)
    assert np.isfinite(world.data.qpos).all() and world.data.warning.number.sum() == 0
    first = 0.5 * stiffness * joints * 0.1**2
    # The longest and stiffest swings on for longest, lightly damped as the paper's finger is.
    assert max(energy) < first and max(energy[12:]) < 0.6 * max(energy[:12]) and energy[-1] < 0.1 * first


@pytest.mark.parametrize("range_kpa", [(0.0, 60.0), (-40.0, 0.0), (-20.0, 30.0)])
def test_pressures_reach_as_far_as_the_twin_was_measured_and_no_farther(range_kpa, caplog):
    env = PneutacEnv("switch", "none", finger(range_kpa=range_kpa), "probe")
    low, high = range_kpa
    assert (env.action_space.low[3], env.action_space.high[3]) == range_kpa
    assert env.observation_space["agent_pos"].high[-1] == high
    env.reset(seed=0)
    far = max(range_kpa, key=abs)
    with caplog.at_level(logging.WARNING):
        for _ in range(6):
            info = env.step([0, 0, 0, far])[-1]
        assert info["clipped"] == 0 and not caplog.records
        assert env.world.pressure_kpa == pytest.approx(far)
        assert env.world.spine_rad.sum() == pytest.approx(0.9, abs=0.03)
        for _ in range(2):
            info = env.step([0, 0, 0, 2 * far])[-1]
    assert info["clipped"] == 2 and env.world.pressure_kpa == pytest.approx(far)
    assert len(caplog.records) == 1 and f"{low:g} to {high:g} kPa" in caplog.text  # told once, counted always


def test_driving_beyond_what_was_measured_has_to_be_asked_for():
    env = PneutacEnv("switch", "none", finger(), "probe", pressure_range_kpa=(0.0, 80.0))
    env.reset(seed=0)
    for _ in range(6):
        info = env.step([0, 0, 0, 80.0])[-1]
    assert info["clipped"] == 0 and env.world.spine_rad.sum() == pytest.approx(1.2, abs=0.03)


def test_the_same_bend_by_vacuum_and_by_four_times_the_pressure_does_the_task_alike():
    """An expert's pressures are shares of the range: a finger like the paper's but for its gain is alike."""
    ways = []
    for factor in (1.0, 4.0, -1.0):
        twin = Twin.builtin()
        for name, power in (("gain_rad_per_kpa", -1), ("rest_pressure_kpa", 1)):
            twin.parameters[name] = Value(twin.parameter(name) * factor**power)
        twin.pressure_range_kpa = tuple(sorted((0.0, 15.0 * factor)))
        world = World("switch", twin, "none")
        expert = ScriptedExpert(world, np.random.default_rng(1))
        world.reset(1)
        way = []
        for _ in range(4 * CONTROL_HZ):
            action = expert.action()
            world.step(action)
            way.append([*world.flange_m, *world.spine_rad, action[3] / factor])
        ways.append(way)
    assert np.ptp(np.array(ways[0])[:, -1]) > 1 and np.max(ways[0]) < ACTION_HIGH[3]
    np.testing.assert_allclose(ways[1], ways[0], atol=1e-4)
    np.testing.assert_allclose(ways[2], ways[0], atol=1e-4)
