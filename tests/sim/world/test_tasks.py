"""Tasks: physics, random starts, and what counts as success and failure, by hand-made actions and experts.

The call button, fruit and cable: done by the expert, in the twin's world and on the stand-in alike.
"""

from types import SimpleNamespace

import numpy as np
import pytest
from played import succeeds, until

from lerobot_robot_pneutac.standin.world import StandinWorld
from pneutac_sim.features import TASK_NAMES
from pneutac_sim.world.expert import ScriptedExpert
from pneutac_sim.world.station import Station
from pneutac_sim.world.world import World

DT = Station().dt_s

# Which point of the task's body starts at random, metres in its frame, and its mean place.
MIDDLES = {"switch": (-0.029, 0.511), "egg": (-0.05, 0.53), "card": (0.0, 0.56)}


# Flange in front of the object's middle.
BEFORE_IT = {"switch": (0.41, 0.0, 0.255), "egg": (0.395, 0.0, 0.275), "card": (0.40, 0.0, 0.315)}


@pytest.fixture(scope="module")
def worlds():
    return {task: World(task, touch="none") for task in TASK_NAMES}


@pytest.fixture
def in_the_middle():
    """Plays moves (steps, action) with the object in the middle of its random starts."""

    def play(name, moves):
        world = World(name, touch="none")
        world.task.spread_x_m = world.task.spread_y_m = world.task.spread_yaw_rad = 0.0
        world.task.home_m = BEFORE_IT[name]
        world.reset(0)
        world.target_m = np.array(world.task.home_m)
        for steps, action in moves:
            for _ in range(steps):
                world.step(action)
                if world.success or world.failure:
                    return world
        return world

    return play


@pytest.mark.parametrize("name", TASK_NAMES)
def test_nothing_happens_without_action(worlds, name):
    world = worlds[name]
    world.reset(0)
    for _ in range(60):
        world.step([0, 0, 0, 0])
    assert not world.success and world.failure is None


@pytest.mark.parametrize("name", TASK_NAMES)
def test_random_starts_fill_their_range_about_the_part_to_be_found(worlds, name):
    world = worlds[name]
    along, mean_x = MIDDLES[name]
    starts = []
    for seed in range(80):
        world.reset(seed)
        body = world.model.body(name)
        yaw = 2 * np.arctan2(body.quat[3], body.quat[0])
        starts.append([body.pos[0] + along * np.cos(yaw), body.pos[1] + along * np.sin(yaw), yaw])
    offset = np.array(starts) - (mean_x, 0, 0)
    t = world.task
    limit = np.array([t.spread_x_m, t.spread_y_m, getattr(t, "spread_yaw_rad", 0.0)]) + 1e-4
    assert np.all(np.abs(offset) <= limit)
    assert np.all(np.ptp(offset, axis=0) / 2 > 0.85 * limit - 1e-4)
    assert t.spread_x_m >= 0.020 and t.spread_y_m >= 0.020  # a few centimetres
    if name != "card":
        assert np.degrees(t.spread_yaw_rad) == pytest.approx(15)


# ---------------------------------------------------------------- switch


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
    assert 0.05 <= ridge <= 0.1
    assert side(0.9 * ridge) < 0 < side(1.1 * ridge)  # the lever's own weight is within the tenth


REACH = [(2, [0, 0, -0.06, 3]), (10, [0.08, 0, 0, 3])]
RETREAT = [(15, [-0.05, 0, 0.02, 12]), (10, [0, 0, 0, 12])]


def test_switch_flips_when_pushed_with_a_pressurised_finger_only(in_the_middle):
    push = [(12, [0.02, 0, 0.02, 12]), (20, [0.04, 0, 0.02, 12])]
    assert in_the_middle("switch", [*REACH, *push, *RETREAT]).success
    touched = in_the_middle("switch", [*REACH, (15, [0, 0, 0, 3]), *RETREAT])
    assert not touched.success and touched.task.lever_rad < 0


OVER_AND_DOWN = [(8, [0, 0, 0.08, 0]), (16, [0.1, 0, 0, 0]), (80, [0, 0, -0.1, 0])]


@pytest.mark.parametrize("name", ["switch", "egg"])
def test_pressing_hard_fails(in_the_middle, name):
    assert "8 N" in in_the_middle(name, OVER_AND_DOWN).failure


# ---------------------------------------------------------------- egg


def test_carton_opens_when_the_tab_is_hooked_and_lifted(in_the_middle):
    below = [(6, [0.08, 0, -0.04, 3]), (14, [0.08, 0, 0, 3])]
    hook = [(16, [0, 0, 0.05, 3]), (8, [0, 0, 0.02, 12])]
    lift = [(20, [0.005, 0, 0.06, 12]), (20, [0.03, 0, 0.06, 12]), (20, [0.06, 0, 0.03, 12])]
    world = in_the_middle("egg", [*below, *hook, *lift])
    assert world.success and world.failure is None and world.task.lid_rad > np.radians(60)
    beside = in_the_middle("egg", [(9, [0, 0.05, 0, 3]), *below, *hook, *lift])  # 30 mm
    assert not beside.success


@pytest.mark.parametrize("start_rad, opens", [(0.0, False), (0.1, True)])
def test_lid_springs_open_once_it_is_off_its_latch(worlds, start_rad, opens):
    world = worlds["egg"]
    world.reset(0)
    world.data.joint("lid").qpos = start_rad
    for _ in range(30):
        world.step([0, 0, 0, 0])
    assert world.success == opens and (world.task.lid_rad < 0.01) != opens


# ---------------------------------------------------------------- card


def test_card_comes_out_when_pressed_lightly_and_drawn(in_the_middle):
    reach = [(6, [0.06, 0, -0.02, 3]), (8, [0.06, 0, 0, 8]), (8, [0.032, 0, 0, 8])]
    world = in_the_middle("card", [*reach, (25, [-0.01, 0, 0.04, 8])])
    assert world.success and world.task.drawn_m(1) > 0.030 and world.task.drawn_m(2) < 0.010
    short = in_the_middle("card", [*reach[:2], (8, [-0.02, 0, 0, 8]), (25, [-0.01, 0, 0.04, 8])])
    assert not short.success


def draw(world, press_n, friction):
    """Pulls the front card with what its own friction takes and 0.1 N, at a press and given frictions."""
    task, data = world.task, world.data
    world.reset(0)
    dofs = [world.model.joint(f"card_{i + 1}").dofadr[0] for i in range(task.cards)]
    task._mu = np.full(task.cards, 0.2)
    task._mu[: len(friction)] = friction
    task._set_friction(world.model, press_n)
    task.update = lambda *a: None  # keep the friction of this press
    # A pull on the front card acts in the joints of all cards behind it.
    data.qfrc_applied[dofs] = friction[0] * press_n + task.edge_n + 0.1
    for _ in range(8):
        world.step([0, 0, 0, 0])
        if world.success:
            break
    data.qfrc_applied[dofs] = 0
    del task.update
    return [task.drawn_m(i) for i in (1, 2, 3)]


def test_card_pressed_too_hard_draws_two(worlds):
    """The second card follows where (mu_1 - mu_2) N exceeds the holder's drag on it."""
    world = worlds["card"]
    drag = world.task.edge_n
    light = draw(world, 0.25 * drag / 0.15, (0.35, 0.2))
    assert light[0] > 0.02 and light[1] < 0.005
    hard = draw(world, 1.2 * drag / 0.15, (0.35, 0.2))
    assert hard[1] > 0.010
    assert hard[2] < 0.005  # the drag on two cards is more than the pull


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
    until(world, 2, lambda: world.task._force[1] > world.task.press_n)
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
    until(world, 1, lambda: world.task.lifted_m > 0.01)
    for _ in range(30):
        world.step([-0.08, 0, 0, 0])
    assert world.task.lifted_m < 1e-3 and not world.success


def test_a_cable_that_is_left_leads_nowhere():
    world = World("cable", touch="none")
    ended = [play(world, seed, lambda k: [0.05 * (k < 40), 0.03 * (k >= 40), 0, 3.0]) for seed in range(4)]
    assert sum(ended) < 4


@pytest.mark.parametrize("task", TASKS)
def test_the_stand_in_offers_them_too(task):
    assert succeeds(StandinWorld(task, touch="none"), 0, steps=150)
