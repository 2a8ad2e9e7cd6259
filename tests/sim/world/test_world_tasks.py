"""Tasks and experts: what counts as success and failure, and that the experts manage."""

import numpy as np
import pytest

from pneutac_sim.features import ACTION_HIGH, ACTION_LOW
from pneutac_sim.world.expert import Habits, ScriptedExpert
from pneutac_sim.world.world import DT, World


@pytest.fixture(scope="module")
def worlds():
    return {task: World(task, touch="none") for task in ("switch", "egg", "card")}


def episode(world, seed, expert_seed=None):
    """Runs the expert until the trial ends; returns its actions."""
    world.reset(seed)
    expert = ScriptedExpert(world, np.random.default_rng(seed if expert_seed is None else expert_seed))
    actions = []
    while not (world.success or world.failure or len(actions) == 150):
        actions.append(expert.action())
        world.step(actions[-1])
    return np.array(actions)


@pytest.mark.parametrize("task", ["switch", "egg", "card"])
def test_expert_succeeds_within_limits(worlds, task):
    world = worlds[task]
    for seed in range(200, 210):
        actions = episode(world, seed)
        assert world.success and world.failure is None, seed
        assert world.clipped == 0
        assert np.all(actions >= ACTION_LOW) and np.all(actions <= ACTION_HIGH)
        assert len(actions) * DT < (8.0 if task == "switch" else 10.0)


@pytest.mark.parametrize("task", ["switch", "egg", "card"])
def test_nothing_happens_without_action(worlds, task):
    world = worlds[task]
    world.reset(0)
    for _ in range(60):
        world.step([0, 0, 0, 0])
    assert not world.success and world.failure is None


def test_expert_needs_its_eyes(worlds):
    """A blind replay of one start's actions on another start is not the same episode."""
    world = worlds["switch"]
    world.reset(0)
    expert = ScriptedExpert(world, np.random.default_rng(0))
    ends = []
    for seed in (0, 1):
        episode(world, seed, expert_seed=0)
        ends.append(world.flange_m)
    assert np.linalg.norm(ends[0] - ends[1]) > 1e-3
    assert not expert.done


def test_same_rng_same_demonstration_and_people_differ(worlds):
    world = worlds["switch"]
    a, b, c = episode(world, 5, 5), episode(world, 5, 5), episode(world, 5, 6)
    assert np.array_equal(a, b)
    assert len(a) != len(c) or not np.allclose(a, c, atol=1e-3)
    speeds = [Habits.draw(np.random.default_rng(s)).speed for s in range(50)]
    assert max(speeds) / min(speeds) > 1.4


def test_expert_is_done_after_its_script_and_then_holds_still(worlds):
    world = worlds["switch"]
    world.reset(4)
    expert = ScriptedExpert(world, np.random.default_rng(4))
    for _ in range(150):
        world.step(expert.action())
    assert expert.done and world.success
    action = expert.action()
    assert np.all(action[:3] == 0) and action[3] > 10


def test_switch_must_rest_in_the_other_well(worlds):
    world = worlds["switch"]
    task = world.task
    world.reset(0)
    assert task.lever_rad == pytest.approx(-task.well_rad, abs=0.02)
    world.data.joint("lever").qpos = task.well_rad
    rested = 0
    while not world.success:
        world.step([0, 0, 0, 0])
        rested += 1
    assert rested * DT == pytest.approx(0.5, abs=2 * DT)


def test_switch_has_a_ridge_of_the_stated_torque(worlds):
    world = worlds["switch"]
    world.reset(0)
    lever = world.data.joint("lever")
    dof = world.model.joint("lever").dofadr[0]

    def side(torque):
        world.reset(0)
        for _ in range(20):
            world.data.qfrc_applied[dof] = torque
            world.step([0, 0, 0, 0])
        world.data.qfrc_applied[dof] = 0
        return np.sign(lever.qpos[0])

    ridge = world.task.ridge_torque_nm
    assert side(0.9 * ridge) < 0 < side(1.1 * ridge)  # the lever's own weight is within the tenth


def test_egg_fails_when_pressed_hard_and_latch_holds_a_light_pull(worlds):
    world = worlds["egg"]
    world.reset(0)
    dof = world.model.joint("lid").dofadr[0]
    weight = 0.026 * 9.81 * world.task.reach_m / 2
    world.data.qfrc_applied[dof] = weight + 0.5 * world.task.latch_n * world.task.reach_m
    for _ in range(10):
        world.step([0, 0, 0, 0])
    assert world.task.lid_rad < 0.02
    world.data.qfrc_applied[dof] = weight + 1.5 * world.task.latch_n * world.task.reach_m
    for _ in range(10):
        world.step([0, 0, 0, 0])
    assert world.task.lid_rad > 0.2
    world.data.qfrc_applied[dof] = 0
    world.reset(0)
    for _ in range(60):
        world.step([0.08, 0, 0.0, 0])  # over the carton ...
        if world.flange_m[0] > 0.55:
            break
    for _ in range(80):
        world.step([0, 0, -0.1, 0])  # ... and down on it
    assert "8 N" in world.failure


def test_card_pressed_too_hard_draws_two(worlds):
    world = worlds["card"]
    world.reset(0)
    task, data = world.task, world.data
    dofs = [world.model.joint(f"card_{i}").dofadr[0] for i in (1, 2, 3)]

    def draw(press_n, friction):
        world.reset(0)
        task._mu = np.array(friction)
        task._set_friction(world.model, press_n)
        task.update = lambda *a: None  # keep the friction of this press
        data.qfrc_applied[dofs] = (
            0.35 * press_n + task.edge_n + 0.1
        )  # pulls card 1: acts in all joints behind it
        for _ in range(8):
            world.step([0, 0, 0, 0])
            if world.success:
                break
        data.qfrc_applied[dofs] = 0
        del task.update
        return task.drawn_m(1), task.drawn_m(2)

    light = draw(0.4, (0.35, 0.2, 0.2))
    assert light[0] > 0.02 and light[1] < 0.005
    hard = draw(4.0, (0.35, 0.2, 0.2))
    assert hard[1] > 0.010
