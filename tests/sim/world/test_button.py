"""The call button: pressed and held twice by the expert, in the twin's world and on the stand-in alike."""

import numpy as np
import pytest

from lerobot_robot_pneutac.standin.world import StandinWorld
from pneutac_sim.world.expert import ScriptedExpert
from pneutac_sim.world.world import World


@pytest.mark.parametrize("kind", [World, StandinWorld])
def test_the_expert_presses_twice_and_holds(kind):
    world = kind("button", touch="none")
    world.reset(2)
    expert, held = ScriptedExpert(world, np.random.default_rng(2)), []
    for _ in range(200):
        world.step(expert.action())
        held.append(world.task.held)
        if world.success or world.failure:
            break
    assert world.success and not world.failure
    assert np.count_nonzero(np.diff(np.array(held, int)) == 1) == 2


def test_a_press_that_is_let_go_too_early_does_not_count():
    world = World("button", touch="none")
    world.reset(2)
    expert = ScriptedExpert(world, np.random.default_rng(2))
    while world.task._force[1] < world.task.press_n:
        world.step(expert.action())
    for _ in range(20):
        world.step([0, 0, 0, 0])
    assert world.task.pressed == 0 and not world.success


@pytest.mark.parametrize("kind", [World, StandinWorld])
def test_the_expert_drags_the_finger_to_both_sides_before_it_lets_go(kind):
    world = kind("button", touch="none")
    world.task.drag_m = 0.006
    world.reset(2)
    expert, ways = ScriptedExpert(world, np.random.default_rng(2)), []
    while not (world.success or world.failure) and world.time_s < 25:
        world.step(expert.action())
        if world.task.pressed == 1 and world.task.held:
            ways.append(1e3 * world.flange_m[1])
    assert world.success
    ways = np.array(ways) - ways[0]
    assert ways.max() > 4 and ways.min() < -4
