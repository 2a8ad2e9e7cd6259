from dataclasses import replace

import numpy as np
import pytest
from augmenting import demonstrations, setup_of

from pneutac_datasets.demonstrations.augment import episode as augment_episode
from pneutac_datasets.demonstrations.augment.episode import Generator, Variant
from pneutac_datasets.demonstrations.augment.planner import PlannerConfig, demonstration_cost
from pneutac_datasets.demonstrations.augment.reference import Reference, onset_sigma_m
from pneutac_datasets.demonstrations.augment.scene import Scene, command_latency
from pneutac_datasets.demonstrations.episodes import Episode
from pneutac_datasets.demonstrations.pool import previous_actions
from pneutac_sim.errors import InputError
from pneutac_sim.features import ACTION_HIGH
from pneutac_sim.world.base import Variation
from pneutac_sim.world.gantry import Gantry
from pneutac_sim.world.world import World

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def switch():
    """Generator with two demonstrations of the switch, acted late by a control step, in their own scenes."""
    recorded = demonstrations("switch", 2, late=1)
    generator = Generator(setup_of(recorded), touch="area")
    return generator, [Scene(r.source, (0.0, 0.0, 0.0), True, 0.0, 0.0) for r in recorded]


def test_cost_is_the_papers_sum():
    H, c = 3, PlannerConfig(area_weight=2.0, position_weight=50.0, smoothness_weight=0.01)
    area, goal = np.array([0.1, 0.2, 0.3]), np.array([0.1, 0.1, 0.1])
    x, x_goal = np.zeros((H, 3)), np.array([[0.01, 0, 0], [0, 0.02, 0], [0, 0, 0]])
    actions = np.tile(ACTION_HIGH * 0.5, (H, 1)).astype(float)
    actions[2, 3] = 0.0
    previous = np.zeros(4)
    expected = 2.0 * (0.01 + 0.04) + 50 * (1e-4 + 4e-4) + 0.01 * (4 * 0.25 + 0.25)
    assert demonstration_cost(area, goal, x, x_goal, actions, previous, c) == pytest.approx(expected)
    assert demonstration_cost(goal, goal, x_goal, x_goal, actions * 0, previous, c) == 0.0
    both = [np.stack(pair) for pair in ((area, goal), (x, x_goal), (actions, actions * 0))]
    costs = demonstration_cost(both[0], goal, both[1], x_goal, both[2], previous, c)
    np.testing.assert_allclose(costs, [expected, 0.0])


def synthetic(source: int, onset_m, onset: int = 5) -> Reference:
    flange, area = np.zeros((10, 3)), np.zeros(10)
    flange[onset] = onset_m
    area[onset:8] = 0.1
    return Reference(source, flange, area, np.zeros((10, 4)), "push")


def test_sigma_is_that_of_the_contact_onsets():
    points = np.random.default_rng(0).normal(0.4, [0.01, 0.004, 0.0], (40, 3))
    sigma = onset_sigma_m([synthetic(i, p) for i, p in enumerate(points)])
    np.testing.assert_allclose(sigma, points.std(0, ddof=1))
    assert synthetic(0, points[0]).contact_phase == (1, 10)
    with pytest.raises(InputError, match="Episode 7 holds numbers that are not finite"):
        synthetic(7, [np.nan, 0, 0])
    with pytest.raises(InputError, match="needs two demonstrations"):
        onset_sigma_m([synthetic(0, points[0])])
    untouched = synthetic(3, points[0])
    untouched.area[:] = 0
    with pytest.raises(InputError, match="Episode 3 never touches"):
        onset_sigma_m([untouched, untouched])
    pressed = synthetic(4, points[0])
    pressed.area[:] = 0.1
    with pytest.raises(InputError, match="Episode 4 touches something in its first frame"):
        onset_sigma_m([pressed, pressed])


@pytest.mark.parametrize(
    "task", ["switch", *(pytest.param(t, marks=pytest.mark.nightly) for t in ("egg", "card"))]
)
def test_gantry_goes_the_arms_way(task):
    r = demonstrations(task, 1)[0]
    world = World(task, touch="area", fidelity="probe")
    gantry = Gantry(world)
    world.variation = Variation(start_m=tuple(r.flange_m[0]))
    world.reset(r.source)
    gantry.mirror(world)
    flange, area = gantry.rollout(r.action)
    gel = gantry.gel_m
    ours = []
    for action in r.action:
        world.step(action)
        ours.append([*world.flange_m, world.touch.area])
    ours = np.array(ours)
    assert np.abs(flange - ours[:, :3]).max() < 2e-4
    assert np.linalg.norm(gel - world.gel_m) < 1e-3
    assert np.sqrt(np.mean((area - ours[:, 3]) ** 2)) < 0.02
    # And from the middle of the contact, also where what was sent acts too late and so goes first.
    middle = r.onset + 3
    for late in (0, 2):
        world.variation = replace(world.variation, late_commands=late)
        world.reset(r.source)
        for action in r.action[: middle + late]:
            world.step(action)
        gantry.mirror(world)
        flange, area = gantry.rollout(r.action[middle + late : middle + late + 8])
        np.testing.assert_allclose(flange, ours[middle : middle + 8, :3], atol=2e-4)
        np.testing.assert_allclose(area, ours[middle : middle + 8, 3], atol=0.03)


def test_variation_moves_the_object_and_scales_the_bend():
    world = World("switch", touch="area", fidelity="probe")
    bar = world.data.geom("bar")
    world.reset(4)
    place, start = bar.xpos.copy(), world.flange_m
    world.variation = Variation(tuple(start + [0.02, 0, 0]), (0.03, -0.01, 0.0), 1.2, 0.5)
    for _ in range(2):  # it does not add up
        world.reset(4)
    np.testing.assert_allclose(bar.xpos - place, [0.03, -0.01, 0.0], atol=1e-6)
    assert world.flange_m[0] - start[0] == pytest.approx(0.02, abs=0.0085)
    assert world.model.geom("pad").friction[0] == pytest.approx(0.5)
    bends = []
    for gain in (1.0, 1.2):
        world.variation = Variation(bend_gain=gain)
        world.reset(4)
        rest = world.spine_rad
        for _ in range(20):
            world.step([0, 0, 0, 8.0])
        bends.append(np.sum(world.spine_rad - rest))
    assert bends[1] / bends[0] == pytest.approx(1.2, rel=0.05)


@pytest.mark.nightly  # every day: scenes are found for the datasets of test_augment_cli
def test_the_touch_tells_where_the_object_stood():
    """Replayed there, they do the task, and it is where the object was; 1 is to feel nothing."""
    generator = Generator(setup_of(demonstrations("switch", 2, late=1), candidates=8), touch="area")
    scenes = [generator.scene(i) for i in range(2)]
    assert all(scene.works for scene in scenes)
    felt = [np.sqrt(np.mean(r.area[slice(*r.contact_phase)] ** 2)) for r in generator.setup.references]
    left = [scene.area_rmse / f for scene, f in zip(scenes, felt, strict=True)]
    assert max(left) < 1
    beside = []
    for r, scene in zip(generator.setup.references, scenes, strict=True):
        bars = []
        for seed, shift in ((r.source, (0.0, 0.0, 0.0)), (scene.seed, scene.shift_m)):
            generator.world.variation = Variation(shift_m=shift)
            generator.world.reset(seed)
            bars.append(generator.world.data.geom("bar").xpos.copy())
        beside.append(np.linalg.norm(bars[1] - bars[0]))
    assert max(beside) < 0.015  # where the switch may stand is 80 mm by 64 mm
    assert np.mean(beside) < 0.010


@pytest.mark.parametrize("late", [1, *(pytest.param(n, marks=pytest.mark.nightly) for n in (0, 3))])
def test_the_free_way_tells_how_late_commands_act(late):
    references = demonstrations("switch", 2, late)
    world = World("switch", touch="area", fidelity="probe")
    assert command_latency(world, references) == late


def test_what_is_laid_out_around_a_hand_is_what_a_reset_lays_out():
    """For every task: the object under the hand as at the start, and tried actions meet it alike."""
    for task in ("switch", "egg", "card"):
        r = demonstrations(task, 1)[0]
        world = World(task, touch="area", fidelity="probe")
        gantry, shift = Gantry(world), (0.01, -0.004, 0.0)
        world.variation = Variation(tuple(r.flange_m[0]), shift)
        world.reset(r.source)
        gantry.mirror(world)
        flange, area = gantry.rollout(r.action)
        world.variation = Variation(tuple(r.flange_m[0]), (0.0, 0.0, -5.0))
        world.reset(r.source)  # the same jitter of the hand
        gantry.mirror(world)
        assert not gantry.rollout(r.action)[1].any()
        gantry.stage(77, (0.0, 0.03, 0.0))
        gantry.rollout(r.action)
        gantry.stage(r.source, shift)
        again, felt = gantry.rollout(r.action)
        n = int(np.flatnonzero(area)[0]) + 5 if area.any() else len(area)
        np.testing.assert_allclose(again[:n], flange[:n], atol=1e-4)
        np.testing.assert_allclose(felt[:n], area[:n], atol=0.02)


@pytest.fixture
def blindly(switch, monkeypatch):
    """The same generator, which replays a reference's actions in place of a plan."""
    generator, scenes = switch
    limits = generator.world.action_limits
    monkeypatch.setattr(generator, "_plan", lambda r, *_: iter(np.clip(r.action, *limits)))
    return generator, scenes


@pytest.mark.parametrize(("steps", "short"), [(augment_episode.SHORTEST - 1, True), (30, False)])
def test_what_is_done_at_once_is_no_demonstration(blindly, monkeypatch, steps, short):
    generator, scenes = blindly
    world = generator.world
    taken, step = [], world.step
    monkeypatch.setattr(world, "step", lambda action: (taken.append(action), step(action))[1])
    monkeypatch.setattr(world.task, "success", lambda: len(taken) >= steps)
    variant = Variant(0, (0.0, 0.0, 0.0), 1.0, 0.0, 1.0)
    trial = generator.carry_out(variant, scenes[0], np.random.default_rng(0))
    assert len(trial.action) == steps
    assert (trial.reason == augment_episode.IN_THE_WAY) == short


def test_a_demonstration_keeps_its_turn(blindly, monkeypatch):
    """Else those that are hard to vary would be left out, and with them what they alone show."""
    generator, scenes = blindly
    tried, real = [], generator.carry_out
    works = [False] * 6 + [True]

    def carry_out(variant, scene, rng):
        tried.append(variant.source)
        trial = real(variant, scene, rng)
        return replace(trial, reason=None if works[len(tried) - 1] else "no")

    monkeypatch.setattr(generator, "carry_out", carry_out)
    _, line = generator.episode(5, scenes)
    assert tried == [1] * 7
    assert len(line["rejected"]) == 6
    assert all(r["late_commands"] == 1 for r in line["rejected"])


def test_variants_draw_their_conditions_and_the_world_has_them(blindly):
    generator, scenes = blindly
    hot = {"temperature_c": [20.0, 30.0], "payload_g": 5.0}
    drawn = [Variant.draw(0, np.zeros(3), 0, np.random.default_rng(k), hot) for k in range(3)]
    assert len({v.conditions["temperature_c"] for v in drawn}) == 3
    generator.carry_out(drawn[1], scenes[0], np.random.default_rng(0))
    assert drawn[1].conditions.items() <= generator.world.conditions.items()


def test_an_episode_is_a_function_of_seed_and_index(switch):
    generator, scenes = switch
    quick = PlannerConfig(horizon=6, samples=4, elites=2, iterations=1)
    generator.setup = setup_of(generator.setup.references, planner=quick)
    generator.world.step([0.05, 0, 0, 9.0])  # whatever was done before
    first, line = generator.episode(1, scenes)
    variant = Variant(1, (0.006, 0.0, 0.0), 1.1, 0.3, 0.96)
    generator.carry_out(variant, scenes[1], np.random.default_rng(9))
    again, same = generator.episode(1, scenes)
    np.testing.assert_array_equal(first.action, again.action)
    np.testing.assert_array_equal(first.state, again.state)
    assert line == same
    assert first.reason is None
    other, _ = generator.episode(2, scenes)
    n = min(len(other.action), len(first.action))
    assert np.abs(other.action[:n] - first.action[:n]).max() > 1e-4


@pytest.mark.parametrize("method", ["library", "expert"])
def test_the_task_is_done_from_starts_and_objects_that_nobody_showed(method):
    recorded = demonstrations("switch", 3)
    options = {"method": method, "start_range": (0.01, 0.01, 0.004), "attempts": 8}
    generator = Generator(setup_of(recorded, **options))
    made = [generator.episode(k, []) for k in range(1 + (method == "expert"))]
    for attempt, provenance in made:
        assert attempt.reason is None and provenance["method"] == method
        assert (attempt.area > 0).any() and len(attempt.state) == len(attempt.action) == provenance["frames"]
        assert ("path" in provenance) == (method == "library") == (attempt.carried_out is None)
    starts = np.array([a.state[0, 14:17] for a, _ in made])
    shown = np.array([r.flange_m[0] for r in recorded])
    assert np.linalg.norm(starts[:, None] - shown, axis=2).min(1).max() > 0.003
    if method == "expert":
        again = Generator(replace(generator.setup)).episode(1, [])[0]
        np.testing.assert_array_equal(again.action, made[1][0].action)


def test_an_attempt_whose_physics_diverges_is_rejected_and_the_next_is_made(monkeypatch):
    generator = Generator(setup_of(demonstrations("switch", 2), method="expert", attempts=8), touch="area")
    step, diverges = generator.world.step, iter([False, True])

    def pushed(action):
        generator.world.data.qvel[0] += 1e12 * next(diverges, False)
        return step(action)

    monkeypatch.setattr(generator.world, "step", pushed)
    made, line = generator.episode(0, [])
    assert line["rejected"][0]["reason"] == "the physics diverged"
    assert made.reason is None and np.isfinite(made.state).all()


def test_what_leads_the_expert_astray_is_carried_out_and_not_stored():
    setup = setup_of(demonstrations("switch", 2), method="expert", start_range=(0.004, 0.004, 0.004))
    made, _ = Generator(setup, touch="area").episode(0, [])
    astray = made.carried_out - made.action
    free, kpa = made.area == 0, 15.0 * augment_episode.NOISE_SHARE
    assert np.std(astray[free, 1]) == pytest.approx(augment_episode.NOISE_FREE_M_S, rel=0.5)
    assert 0 < np.abs(astray[~free, :3]).max() < 5 * augment_episode.NOISE_TOUCH_M_S
    assert 0 < np.std(astray[:, 3]) < 2 * kpa
    # Labels are the expert's own, without noise: on the free way it keeps to few velocities.
    assert np.median(np.abs(np.diff(made.action[free, 0]))) < 0.3 * np.median(
        np.abs(np.diff(astray[free, 0]))
    )
    # What a policy sees as its previous action is the label of the frame before, not what was carried out.
    images = np.zeros((len(made.state), 2, 2, 3), np.uint8)
    previous = previous_actions(Episode(made.state, made.action, images, "flip", 15))
    np.testing.assert_array_equal(previous[1:], made.action[:-1])
    assert np.abs(previous[1:] - made.carried_out[:-1]).max() > 1e-3
    world = World("switch", touch="area", fidelity="probe")
    seed, world.variation = made.start
    states = [world.reset(seed).state]
    for action in made.carried_out[:-1]:
        states.append(world.step(action).state)
    assert np.array_equal(states, made.state)
