"""Latency of a varied world: the same physics, later."""

import numpy as np
import pytest
from played import played

from pneutac_sim.gel.sensor import TactileSensor
from pneutac_sim.world.base import Variation
from pneutac_sim.world.expert import ScriptedExpert
from pneutac_sim.world.gantry import Gantry
from pneutac_sim.world.world import World


def play(actions, **late):
    """States (T, 20) and contact areas (T,) of actions (T, 4)."""
    world = World("switch", touch="area", fidelity="probe")
    world.variation = Variation(**late)
    world.reset(3)
    states = [world.step(a).state for a in actions]
    return np.array(states), world


def demonstration():
    return played(World("switch", touch="area", fidelity="probe"), 3, steps=200)[1]


def test_latency_shifts_commands_and_touch_and_nothing_else():
    actions = demonstration()
    waiting = np.vstack([np.zeros((1, 4)), actions[:-1]])
    prompt, _ = play(waiting)
    late, world = play(actions, late_commands=1)
    np.testing.assert_array_equal(late, prompt)
    np.testing.assert_allclose(world.command, actions[-1], atol=1e-7)  # what was sent, as others record it
    touch = slice(17, 19)
    assert prompt[:, 17].max() > 0.01
    felt, _ = play(waiting, late_touch=1)
    np.testing.assert_array_equal(felt[1:, touch], prompt[:-1, touch])
    rest = np.delete(np.arange(20), np.r_[touch])
    np.testing.assert_array_equal(felt[:, rest], prompt[:, rest])


def test_plans_feel_with_the_gel_of_the_world():
    """A rollout in contact goes on where the world is, with its network, from whichever start."""
    world = World("egg", touch="area", fidelity="surrogate")
    gantry, formula = Gantry(world), TactileSensor(world.twin)
    by_formula, ahead = [], []
    for seed in range(1, 9):
        world.reset(seed)
        expert = ScriptedExpert(world, np.random.default_rng(seed))
        while world.touch.area < 0.005 and world.time_s < 10:
            action = expert.action()
            world.step(action)
        gantry.mirror(world)
        felt = gantry.touch.depth_mm
        assert gantry.touch.area == pytest.approx(world.sensor.contact_from_depth(felt).area, abs=1e-6)
        by_formula.append(abs(formula.contact_from_depth(felt).area - gantry.touch.area))
        _, area = gantry.rollout(np.tile(action, (2, 1)))
        np.testing.assert_array_equal(gantry.rollout(np.tile(action, (2, 1)))[1], area)
        world.step(action)
        ahead.append(abs(area[0] - world.touch.area))
    assert np.median(by_formula) > 1e-3, "formula and network differ here"
    # The arm does not hold its orientation quite as the gantry does.
    assert np.median(ahead) < 2e-3


def test_after_a_shifted_start_the_tasks_own_home_is_home_again():
    """Who takes the last start as home lets starts wander from one reset to the next."""
    world = World("card", touch="none", fidelity="probe")
    own = world.home_m
    world.variation = Variation(start_m=tuple(own + (0.02, -0.01, 0.03)))
    world.reset(1)
    np.testing.assert_allclose(world.home_m, own + (0.02, -0.01, 0.03))
    world.variation = Variation()
    np.testing.assert_array_equal(world.home_m, own)
    world.reset(1)
    np.testing.assert_array_equal(world.home_m, own)
    assert np.abs(world.flange_m - own).max() < 0.01
