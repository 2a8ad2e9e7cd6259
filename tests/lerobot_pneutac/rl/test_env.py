"""The reinforcement learner's world: reward by term, what actor and critic see, Gymnasium's rules."""

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from lerobot_pneutac.rl.env import WEIGHTS, PpoEnv, actor_size, pool
from pneutac_sim.effects import get_effect
from pneutac_sim.errors import InputError
from pneutac_sim.features import TASK_NAMES, task_names
from pneutac_sim.twin import Twin
from pneutac_sim.world.station import Station
from pneutac_sim.world.tasks import make_task


def move(env: PpoEnv, direction: np.ndarray, steps: int = 5) -> dict[str, float]:
    """Sums of the weighted terms while the flange moves along `direction` (3,) at full speed."""
    action = np.append(direction / np.abs(direction).max(), -1.0)
    sums = dict.fromkeys(WEIGHTS, 0.0)
    for _ in range(steps):
        for name, value in env.step(action)[4]["terms"].items():
            sums[name] += WEIGHTS[name] * value
    return sums


@pytest.mark.parametrize("task", TASK_NAMES)
def test_follows_gymnasium_and_repeats_under_a_seed(task):
    env = PpoEnv(task)
    check_env(env, skip_render_check=True)
    runs = []
    for _ in range(2):
        first, _ = env.reset(seed=5)
        runs.append((first, env.step(np.array([0.5, 0.1, -0.2, 0.3], np.float32))[0]))
    for a, b in zip(*runs, strict=True):
        assert all(np.array_equal(a[k], b[k]) for k in a)
    other, _ = env.reset()
    assert not np.array_equal(other["object"], runs[0][0]["object"])


@pytest.mark.parametrize("task", TASK_NAMES)
def test_approach_is_earned_towards_the_object_and_paid_back_away_from_it(task):
    env = PpoEnv(task, randomise=False)
    env.reset(seed=1)
    way = env.view.seen().point_m - env.world.gel_m
    there = move(env, way)
    assert there["approach"] > 0.1 * WEIGHTS["approach"] * np.linalg.norm(way)
    back = move(env, -way, 8)
    assert back["approach"] < 0
    assert there["progress"] == pytest.approx(0, abs=0.02)


def test_the_actor_does_not_see_the_object_but_the_critic_does():
    env = PpoEnv("switch", randomise=False)
    before, _ = env.reset(seed=3)
    model, data = env.world.model, env.world.data
    model.body("switch").pos[1] += 0.03
    data.joint("lever").qvel = 0.3
    import mujoco

    mujoco.mj_kinematics(model, data)
    env.world.touch.sense(data)
    env._look()
    after = env._observe(env.world._observe().state)
    assert np.array_equal(before["actor"], after["actor"])
    assert not np.array_equal(before["object"], after["object"])
    assert before["actor"].shape == (actor_size(),)
    grid = np.random.default_rng(0).uniform(0, 2, (3, 80, 59))
    assert np.array_equal(pool(grid).max((1, 2)), grid.max((1, 2))) and pool(grid).shape == (3, 10, 8)


def test_with_another_arm_the_actor_sees_its_joints_about_its_own_home():
    env = PpoEnv("switch", randomise=False, station=Station(arm="so101"))
    check_env(env, skip_render_check=True)
    seen = env.reset(seed=3)[0]["actor"]
    assert seen.shape == (actor_size(5),) == (actor_size() - 4,)
    assert np.abs(seen[:5]).max() < 1.5 and np.abs(seen[10:13]).max() <= 1.2


def test_randomised_worlds_differ_in_what_only_the_critic_sees():
    env = PpoEnv("switch")
    seen = {tuple(env.reset(seed=k)[0]["object"][-2:].tolist()) for k in range(5)}
    assert len(seen) == 5


def test_conditions_reach_the_world_and_are_drawn_for_each_episode():
    twin = Twin.builtin()
    twin.effects["thermal"] = get_effect("thermal").start(15.0)
    with pytest.raises(InputError, match="effect 'thermal' needs the condition 'temperature_c'"):
        PpoEnv("switch", twin)
    env = PpoEnv("switch", twin, conditions={"temperature_c": [20.0, 30.0]})
    drawn = set()
    for k in range(4):
        env.reset(seed=k)
        drawn.add(env.world.conditions["temperature_c"])
    assert len(drawn) == 4 and all(20.0 <= t <= 30.0 for t in drawn)


def test_every_task_has_a_goal_and_an_unknown_one_is_refused():
    assert all(make_task(name).goal for name in task_names())
    with pytest.raises(InputError, match="no task 'door'"):
        PpoEnv("door")


def test_pushing_at_the_contact_point_earns_every_term_and_flips_the_switch():
    env = PpoEnv("switch")
    env.reset(seed=0)
    sums, touched, over = dict.fromkeys(WEIGHTS, 0.0), False, False
    while not over:  # a controller that sees the object
        way = env.view.seen().point_m - env.world.gel_m
        touched |= env.world.press_mm > 0.12
        beyond = way + (0.004, 0, 0)
        action = (
            np.append([0.25, *(20 * way[1:])], 0.8)
            if touched
            else np.append(beyond / max(np.abs(way).max(), 0.02), -0.5)
        )
        _, _, terminated, truncated, info = env.step(action)
        over = terminated or truncated
        for name, value in info["terms"].items():
            sums[name] += value
    assert info["is_success"] and sums["success"] == 1 and sums["failure"] == 0
    assert sums["progress"] == pytest.approx(1, abs=0.05)
    assert sums["approach"] > 0.02 and sums["contact"] > 5 and sums["depth"] > 3
