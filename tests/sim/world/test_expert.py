"""Experts: they manage, by touch, and a blind replay of what they did does not."""

import importlib.util
from pathlib import Path

import mujoco
import numpy as np
import pytest
from played import played

from pneutac_sim.features import ACTION_HIGH, ACTION_LOW, CONTROL_HZ, TASK_NAMES
from pneutac_sim.world.expert import VENTED_KPA, ScriptedExpert
from pneutac_sim.world.world import World

pytestmark = pytest.mark.slow

BENCHMARK = Path(__file__).parents[3] / "benchmarks" / "task_difficulty.py"
spec = importlib.util.spec_from_file_location("task_difficulty", BENCHMARK)
difficulty = importlib.util.module_from_spec(spec)
spec.loader.exec_module(difficulty)


@pytest.fixture(scope="module")
def worlds():
    return {task: World(task, touch="none") for task in TASK_NAMES}


@pytest.mark.parametrize("task", TASK_NAMES)
def test_expert_succeeds_within_limits(worlds, task):
    world = worlds[task]
    lengths = []
    for seed in range(200, 210):
        _, actions = played(world, seed, steps=difficulty.STEPS)
        assert np.all(actions >= ACTION_LOW) and np.all(actions <= ACTION_HIGH)
        if world.success and not world.failure:
            assert world.clipped == 0  # who has missed the deck goes on to the workspace's end
            lengths.append(len(actions))
    assert len(lengths) >= 9
    assert np.median(lengths) <= 8 * CONTROL_HZ


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("task", "standin", "trials", "least"),
    [
        *((task, False, 60, 0.95) for task in TASK_NAMES),
        *((task, standin, 40, 0.9) for task in ("fruit", "cable") for standin in (False, True)),
    ],
)
def test_task_needs_touch(task, standin, trials, least):
    expert, replayed, _ = difficulty.measure(task, trials, standin)
    assert expert >= least * trials
    assert replayed <= 0.40 * trials


def until_touch(world, seed, shift_m):
    """Actions of the expert until anything touches the finger, with the object shifted (3,)."""
    world.reset(seed)
    body = world.model.body(world.task.name)
    body.pos[:] += shift_m
    mujoco.mj_forward(world.model, world.data)
    expert = ScriptedExpert(world, np.random.default_rng(seed))
    actions = []
    finger = [g for g in range(world.model.ngeom) if world.model.geom_contype[g] == 1]
    while len(actions) < 150:
        touched = any(c.geom1 in finger or c.geom2 in finger for c in world.data.contact)
        if touched or world.press_mm > 0.1:
            break
        actions.append(expert.action())
        world.step(actions[-1])
    return np.array(actions)


@pytest.mark.parametrize("task", TASK_NAMES)
def test_before_the_touch_the_expert_does_not_know_where_the_object_is(worlds, task):
    world = worlds[task]
    compared = []
    for seed in (4, 6, 7):  # far enough away to search for
        first = until_touch(world, seed, (0.0, 0.0, 0.0))
        for shift in ((0.01, 0.012, 0), (-0.01, -0.02, 0), (0.02, 0, 0)):
            other = until_touch(world, seed, shift)
            n = min(len(first), len(other)) - 2  # a first bump may be over at the end of a step
            compared.append(n)
            np.testing.assert_allclose(first[:n], other[:n], atol=1e-4)  # cards and lever settle a little
    assert min(compared) >= 5 and np.mean(compared) > 8


@pytest.mark.parametrize("task", [pytest.param("switch", marks=pytest.mark.nightly), "egg"])
def test_search_ends_on_the_object_wherever_it_is(worlds, task):
    """The lane in which the touch that counts happened is the one in front of the object."""
    world = worlds[task]
    hits, offsets = [], []
    for seed in range(12):
        world.reset(seed)
        part = {"switch": "bar", "egg": "carton_tab"}[task]
        offset = world.data.geom(part).xpos[1]
        played(world, seed, steps=difficulty.STEPS)
        if world.success:
            offsets.append(offset)
            hits.append(world.gel_m[1])
    assert len(hits) >= 10
    assert np.corrcoef(hits, offsets)[0, 1] > 0.75


@pytest.mark.parametrize(
    "task, wide_m", [("switch", 0.032), pytest.param("egg", 0.026, marks=pytest.mark.nightly)]
)
def test_search_keeps_its_lanes_though_the_hand_is_carried_aside(worlds, task, wide_m):
    """A policy errs by some millimetres a second all the time, which would add up from lane to lane."""
    world, lanes = worlds[task], []
    for seed in range(12):
        world.reset(seed)
        expert = ScriptedExpert(world, np.random.default_rng(seed))
        ahead = []
        while len(ahead) < difficulty.STEPS and not (world.success or world.failure):
            action = expert.action()
            ahead.append(world.flange_m[1] if action[0] > 0.05 and action[3] > VENTED_KPA else np.nan)
            world.step(action + [0, 0.004, 0, 0])
        runs = np.split(ahead, np.flatnonzero(np.isnan(ahead)))
        y = [np.nanmean(run) for run in runs if len(run) > 5]
        lanes += list(np.diff(y))
    lanes = np.array(lanes)
    assert np.sum(lanes > 0) >= 2
    assert np.all(lanes[lanes > 0] < wide_m)  # what gel and object cover together


@pytest.mark.parametrize("task", TASK_NAMES)
def test_expert_has_no_memory_but_its_last_command(worlds, task):
    """What a policy can imitate: the same pose, touch and last command, the same action."""
    world = worlds[task]
    world.reset(7)
    expert = ScriptedExpert(world, np.random.default_rng(7))
    for _ in range(40):
        world.step(expert.action())
    fresh = ScriptedExpert(world, np.random.default_rng(8))
    fresh._habits = expert._habits
    fresh._rng, expert._rng = np.random.default_rng(1), np.random.default_rng(1)
    fresh._velocity, fresh._pressure = expert._velocity.copy(), expert._pressure
    assert np.array_equal(fresh.action(), expert.action())
