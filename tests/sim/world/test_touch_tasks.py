"""Fruit and cable: they need touch, and what spoils them is told."""

import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from played import succeeds

from lerobot_robot_pneutac.standin.world import StandinWorld
from pneutac_sim.world.expert import ScriptedExpert
from pneutac_sim.world.world import World

TASKS = ("fruit", "cable")


@pytest.fixture(scope="module", params=TASKS)
def world(request):
    return World(request.param, touch="none")


def play(world, seed, actions):
    """Whether actions, given as a function of the step, end the trial well."""
    each = map(actions, range(150))
    return succeeds(world, seed, lambda *_: SimpleNamespace(action=each.__next__), 150)


def test_the_expert_does_it_and_holding_still_does_not(world):
    assert all(succeeds(world, seed, steps=150) for seed in range(4))
    assert not play(world, 0, lambda k: [0, 0, 0, 3.0]) and world.failure is None


def test_a_fruit_that_is_pressed_on_bursts_and_one_that_is_let_go_falls():
    world = World("fruit", touch="none")
    assert not play(world, 1, lambda k: [0.05, 0, 0, 3.0])
    assert "squeezed the fruit with more than 1.6 N" in world.failure
    world.reset(1)
    expert = ScriptedExpert(world, np.random.default_rng(1))
    while world.task.lifted_m < 0.01:
        world.step(expert.action())
    for _ in range(30):
        world.step([-0.08, 0, 0, 0])
    assert world.task.lifted_m < 1e-3 and not world.success


def test_a_cable_that_is_left_leads_nowhere():
    world = World("cable", touch="none")
    ended = [play(world, seed, lambda k: [0.05 * (k < 40), 0.03 * (k >= 40), 0, 3.0]) for seed in range(4)]
    assert sum(ended) < 4


@pytest.mark.parametrize("standin", [False, True])
@pytest.mark.parametrize("task", TASKS)
@pytest.mark.nightly
def test_with_touch_nine_of_ten_and_blind_at_most_four(task, standin, monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parents[3] / "benchmarks")
    sys.modules.pop("task_difficulty", None)
    from task_difficulty import measure

    done, blind, _ = measure(task, 40, standin)
    assert done >= 36 and blind <= 16


@pytest.mark.parametrize("task", TASKS)
def test_the_stand_in_offers_them_too(task):
    assert succeeds(StandinWorld(task, touch="none"), 0, steps=150)
