"""The controller made of demonstrations: it searches on, answers late, and does the task from elsewhere."""

import numpy as np
import pytest
from augmenting import demonstrations

from pneutac_datasets.demonstrations.augment.episode import BEND_GAIN, bend_gain_sd
from pneutac_datasets.demonstrations.augment.library import (
    Followers,
    Library,
    lagged_answers,
    regular,
    start_spread_m,
)
from pneutac_datasets.demonstrations.augment.reference import Reference, reaction_hz
from pneutac_sim.least_squares import Z95
from pneutac_sim.twin import Twin, Value
from pneutac_sim.world.expert import Person

LIMITS = np.full(4, -15.0), np.full(4, 15.0)


def walk(source, start_m=(0.0, 0.0, 0.3), touch=(40, 60), frames=90, y_m_s=0.02) -> Reference:
    """Goes along y at 15 Hz, is pressed at 6 kPa in `touch` and ends."""
    action = np.tile([0.0, y_m_s, 0.0, 3.0], (frames, 1))
    area = np.zeros(frames)
    area[slice(*touch)] = 0.05
    action[slice(*touch), 3] = 6.0
    flange = np.add(start_m, np.cumsum(action[:, :3], 0) / 15 - action[0, :3] / 15)
    centre = np.full((frames, 2), np.nan)
    centre[slice(*touch)] = 0.0
    return Reference(source, flange, area, action, "walk", centre)


def follower_of(references, start_m, seed=0) -> Followers:
    """One run of demonstrations as they are, whose touch is not answered."""
    follower = Followers(Library.of(references, np.zeros((3, 3)), 15.0), LIMITS)
    follower.begin(0, np.random.default_rng(seed), np.array(start_m))
    return follower


def next_action(follower, area, flange_m):
    centre_mm = np.full((1, 2), 0.0 if area else np.nan)
    felt = np.array([area]), centre_mm, flange_m[None]
    (action,), (goes_on,) = follower.actions(np.zeros(1, int), *felt)
    return action if goes_on else None


def run(follower, felt, steps, start_m):
    """Actions and places where areas `felt(flange, step)` come back; ends where no action comes."""
    flange, actions, places = np.array(start_m, float), [], []
    for k in range(steps):
        action = next_action(follower, felt(flange, k), flange)
        if action is None:
            break
        actions.append(action)
        places.append(flange)
        flange = flange + action[:3] / 15
    return np.array(actions), np.array(places)


def test_a_free_way_is_followed_and_led_back_to():
    r = walk(0)
    follower = follower_of([r], r.flange_m[0])
    _, places = run(follower, lambda *_: 0.0, 35, r.flange_m[0] + (0.006, 0.0, 0.0))
    aside = places[:, 0]
    assert aside[0] == pytest.approx(0.006) and abs(aside[-1]) < 1e-3
    assert (np.diff(np.abs(aside)) <= 1e-12).all()


@pytest.mark.parametrize("early", [-20, 0, 5])
def test_contact_follows_relative_to_where_touch_came(early):
    """Twenty frames too soon, in time, or five too late: the press is done from there."""
    r, at = walk(0), 40 + early
    follower = follower_of([r], r.flange_m[0])
    felt = lambda flange, k: 0.05 if at <= k < at + 20 else 0.0  # noqa: E731
    actions, places = run(follower, felt, 75, r.flange_m[0])
    assert (actions[at : at + 18, 3] == 6.0).all() and (actions[: at - 1, 3] == 3.0).all()
    moved = places[at + 15] - places[at]
    np.testing.assert_allclose(moved, r.flange_m[55] - r.flange_m[40], atol=2e-3)


def test_where_touch_does_not_come_it_searches_on_with_another_demonstration():
    """The second begins where the first expected its touch, and still has 30 free frames ahead."""
    first = walk(0)
    second = walk(1, first.flange_m[38], touch=(40, 60))
    follower = next(
        f
        for seed in range(9)
        if (f := follower_of([first, second], first.flange_m[0], seed)).paths[0][0][1] == 0
    )
    _, places = run(follower, lambda *_: 0.0, 80, first.flange_m[0])
    assert follower.paths[0][-1][1] == 1
    assert places[-1][1] > second.flange_m[20][1]


def test_alone_it_searches_the_same_way_again_where_touch_does_not_come():
    r = walk(0)
    follower = follower_of([r], r.flange_m[0])
    actions, _ = run(follower, lambda *_: 0.0, 200, r.flange_m[0])
    assert len(follower.paths[0]) > 2 and (actions[50:, 1] < 0).any() and (actions[50:, 1] > 0).any()


def test_far_from_all_demonstrations_it_gives_up():
    r = walk(0)
    far_m = r.flange_m[0] + (0.3, 0.0, 0.0)
    follower = follower_of([r], far_m)
    given = [next_action(follower, 0.0, far_m) for _ in range(100)]
    assert given[0] is not None and given[-1] is None


def test_runs_side_by_side_are_those_of_each_alone():
    """Three that feel a touch at other frames; whoever is asked acts, in any order."""
    demonstrations = [walk(0), walk(1, (0.01, 0.0, 0.3), (30, 55))]
    starts = np.add(demonstrations[0].flange_m[0], [[0.0, 0.0, 0.0], [0.006, 0.0, 0.0], [0.0, 0.01, 0.002]])
    together = Followers(Library.of(demonstrations, np.zeros((3, 3)), 15.0), LIMITS, 3)
    alone = [follower_of(demonstrations, start, seed) for seed, start in enumerate(starts)]
    for k, start in enumerate(starts):
        together.begin(k, np.random.default_rng(k), start)
    flange = starts.copy()
    for step in range(90):
        which = np.roll(np.arange(3), step)[: 2 + step % 2]
        area = np.where((30 + 5 * which <= step) & (step < 50 + 5 * which), 0.05, 0.0)
        centre_mm = np.where(area[:, None] > 0, 0.0, np.full((len(which), 2), np.nan))
        actions, goes_on = together.actions(which, area, centre_mm, flange[which])
        for k, a, action, on in zip(which, area, actions, goes_on, strict=True):
            expected = next_action(alone[k], a, flange[k])
            assert on == (expected is not None) and (not on or np.array_equal(action, expected))
            flange[k] += action[:3] / 15
    assert together.paths == [f.paths[0] for f in alone] and any(len(p) > 1 for p in together.paths)


def test_late_answers_are_found_where_the_same_frame_shows_nothing():
    """A hand that follows a wandering imprint 0.27 s late, 3 1/s along x: found at a lag of four frames."""
    rng, gain, lag = np.random.default_rng(3), 3.0, 4
    made = []
    for source in range(6):
        r = walk(source, touch=(20, 80))
        wander = 2.0 * np.cumsum(rng.standard_normal(60)) / 4
        r.centre_mm[20:80, 0] = wander - np.roll(wander, 7)
        r.action[20 + lag : 80, 0] += gain * 1e-3 * r.centre_mm[20 : 80 - lag, 0]
        r.action[20:80, :3] += 2e-4 * rng.standard_normal((60, 3))
        made.append(r)
    answers, found = lagged_answers(made)
    assert found == lag and answers[0, 0] == pytest.approx(gain, rel=0.1)
    assert not answers[2].any()
    assert abs(reaction_hz(made)[0, 0]) < 0.5 * gain


def test_the_answers_of_a_modelled_person_are_found():
    """On the card, whose x and z velocities it corrects by what it feels 0.15 to 0.35 s before."""
    person = lambda world, rng: Person(world, rng, 0.5)  # noqa: E731
    answers, lag = lagged_answers(demonstrations("card", 8, pilot=person, width=0.5, after=1))
    assert answers.any(1).sum() >= 1 and lag > 0, (answers, lag)


def test_pauses_are_left_out_of_free_ways_alone():
    r = walk(0)
    r.action[10:20, :3] = 0.0
    r.action[45:55, :3] = 0.0
    kept = regular(r)
    assert 78 <= len(kept) <= 84
    assert (kept.area > 0).sum() == 20


def test_starts_are_as_wide_as_the_recorded_ones():
    places = np.random.default_rng(0).normal(0, (0.02, 0.01, 0.001), (400, 3)) + (0.0, 0.0, 0.3)
    made = [walk(k, tuple(p)) for k, p in enumerate(places)]
    x, y, z = start_spread_m(made)
    assert x == pytest.approx(0.02, rel=0.1) and y == pytest.approx(0.01, rel=0.1) and z == 0.004
    assert start_spread_m(made[:1]) == (0.004,) * 3


def test_the_bend_varies_as_far_as_the_twin_knows_its_own():
    twin = Twin.builtin()
    twin.parameters["gain_rad_per_kpa"] = Value(0.03, None)
    assert bend_gain_sd(twin) == BEND_GAIN
    twin.parameters["gain_rad_per_kpa"] = Value(0.03, (0.03 - 0.0006 * Z95, 0.03 + 0.0006 * Z95))
    assert bend_gain_sd(twin) == pytest.approx(0.02)
    twin.parameters["gain_rad_per_kpa"] = Value(
        0.017, (-0.003, 0.037)
    )  # the rest pressure can stand in for it
    assert bend_gain_sd(twin) == BEND_GAIN
