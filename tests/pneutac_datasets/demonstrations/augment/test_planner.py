"""The planner on a world that is written down; `demonstrations/test_planner.py` tries it on the gantry.

The course of a demonstration through a new scene follows the touch, not the clock.
"""

from dataclasses import replace

import numpy as np
import pytest

from pneutac_datasets.demonstrations.augment.planner import (
    EARLY,
    LATE_RELEASE,
    LATE_TOUCH,
    CemPlanner,
    Course,
    PlannerConfig,
    demonstration_cost,
)
from pneutac_datasets.demonstrations.augment.reference import Reference, reaction_hz
from pneutac_sim.errors import InputError
from pneutac_sim.features import ACTION_HIGH, ACTION_LOW

H = 6
JITTER = np.array([0.006, 0.006, 0.006, 0.6])
WARM = np.outer(np.linspace(0.2, 0.5, H), ACTION_HIGH)
STILL = np.zeros(4)
NOWHERE = np.zeros(H), np.zeros((H, 3))


class Written:
    """A flange that goes where it is told, at 15 Hz, and touches by its pressure; keeps what was tried."""

    action_limits = ACTION_LOW, ACTION_HIGH

    def __init__(self):
        self.tried = []

    def rollouts(self, batch):
        self.tried.append(batch.copy())
        return np.cumsum(batch[..., :3], 1) / 15, batch[..., 3] / 30

    def rollout(self, actions):
        position, area = self.rollouts(actions[None])
        return position[0], area[0]


def planner(seed=0, **options):
    config = PlannerConfig(**{"horizon": H, "replan": 2} | options)
    return CemPlanner(Written(), config, np.random.default_rng(seed))


def batches(p, size):
    """The batches (iterations, samples, H, 4) that a planner tried."""
    tried = np.concatenate([t.reshape(-1, *t.shape[-2:]) for t in p._gantry.tried])
    return tried.reshape(-1, size, *tried.shape[1:])


def cost(p, batch):
    """Of each sequence (n, H, 4), where nothing is the goal."""
    position, area = Written().rollouts(batch)
    return np.array(
        [
            demonstration_cost(c, NOWHERE[0], x, NOWHERE[1], a, STILL, p._config)
            for c, x, a in zip(area, position, batch, strict=True)
        ]
    )


FROM_ZERO = ("area_weight", "position_weight", "smoothness_weight", "jitter_m_s", "jitter_kpa")


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"horizon": 1, "replan": 1}, "horizon is 1; it must be 2 or more"),
        ({"iterations": 0}, "iterations is 0; it must be 1 or more"),
        ({"elites": 11, "samples": 10}, r"elites is 11; it must be at most samples \(10\)"),
        ({"replan": 11, "horizon": 10}, r"replan is 11; it must be at most horizon \(10\)"),
        *(({o: x}, f"{o} is {x}; it must be a number from 0 on") for o in FROM_ZERO for x in (-0.1, np.nan)),
    ],
)
def test_a_number_out_of_its_range_is_named(given, said):
    with pytest.raises(InputError, match=f"^{said}"):
        PlannerConfig(**given)


def test_numbers_at_the_ends_of_their_ranges_are_taken():
    PlannerConfig(2, 3, 2, 1, 1, *[0.0] * len(FROM_ZERO))
    PlannerConfig(horizon=10, samples=10, elites=10, replan=10)


def test_the_jitter_has_its_spread_at_every_step_and_is_correlated_in_time():
    p = planner(samples=4000, iterations=1)
    p.begin(WARM, STILL, *NOWHERE)
    p.solve()
    (batch,) = batches(p, 4000)
    np.testing.assert_array_equal(batch[:2], [WARM, WARM])
    noise = (batch[2:] - WARM) / JITTER
    assert np.abs(noise.mean(0)).max() < 0.08
    np.testing.assert_allclose(noise.std(0), 1, rtol=0.05)
    for t in range(1, H):
        one, two = noise[:, t - 1], noise[:, t]
        np.testing.assert_allclose((one * two).mean(0), 0.7, atol=0.06)
    np.testing.assert_allclose((noise[:, 0] * noise[:, 2]).mean(0), 0.49, atol=0.06)
    assert np.abs((noise[..., 0] * noise[..., 1]).mean()) < 0.05


def test_nothing_beyond_the_limits_is_tried():
    p = planner(samples=50, iterations=2)
    p.begin(1.5 * np.tile(ACTION_HIGH, (H, 1)), STILL, *NOWHERE)
    plan = p.solve()
    for actions in (*batches(p, 50), plan):
        assert (actions <= ACTION_HIGH).all() and (actions >= ACTION_LOW).all()
    assert (batches(p, 50)[0, 0] == ACTION_HIGH).all()


def test_the_plan_is_the_best_that_was_tried():
    p = planner(seed=3)
    assert p.cost == 0
    p.begin(WARM, STILL, *NOWHERE)
    plan = p.solve()
    tried = np.concatenate(batches(p, 10))
    costs = cost(p, tried)
    assert p.cost == pytest.approx(costs.min()) and costs.min() < costs[0]
    np.testing.assert_array_equal(plan, tried[np.argmin(costs)])
    assert len(tried) == 20


FIRST, END, LENGTH = 40, 70, 90
NOTHING, UNTOUCHED = np.zeros((3, 2)), np.full(2, np.nan)


@pytest.fixture
def reference():
    """Along x at 1 mm a frame, in contact from FIRST to END."""
    flange, area = np.zeros((LENGTH, 3)), np.zeros(LENGTH)
    flange[:, 0] = 1e-3 * np.arange(LENGTH)
    area[FIRST:END] = 0.1
    return Reference(0, flange, area, np.zeros((LENGTH, 4)), "push")


def go(course, touched, steps, flange_m=(0.0, 0.0, 0.0)):
    """Frames of so many steps; the last is None where a touch has not come."""
    frames = []
    for _ in range(steps):
        frames.append(course.frame if course.advance(touched, UNTOUCHED, np.array(flange_m)) else None)
        if frames[-1] is None:
            break
    return frames


def test_a_touch_as_demonstrated_leads_through_it_frame_by_frame(reference):
    course = Course(reference, 0.0, NOTHING)
    assert go(course, False, FIRST)[-1] == FIRST - 1
    frames = go(course, True, END - FIRST, reference.flange_m[FIRST])
    assert frames == list(range(FIRST, END)) and course.in_contact
    np.testing.assert_allclose(course.offset_m, 0, atol=1e-12)


@pytest.mark.parametrize("step", [3, 25, FIRST - 1])
def test_an_early_touch_begins_the_contact_where_it_came(reference, step):
    course = Course(reference, 0.004, NOTHING)
    go(course, False, step)
    assert not course.offset_m.any()  # the way there stays
    there = np.array([0.01, 0.001, 0.002])
    assert go(course, True, 1, there) == [FIRST]
    assert course.in_contact
    # Along the way as it was touched, to the side as the object stands.
    np.testing.assert_allclose(course.offset_m, [0.01 - 1e-3 * FIRST, 0.004, 0.002])


def test_who_waits_too_long_has_missed_the_object(reference):
    course = Course(reference, 0.0, NOTHING)
    frames = go(course, False, LENGTH)
    assert frames[-1] is None and course.waiting
    assert len(frames) == FIRST + LATE_TOUCH + 1
    late = Course(reference, 0.0, NOTHING)
    go(late, False, FIRST + LATE_TOUCH)
    assert go(late, True, 1)[0] == FIRST


def test_a_contact_ends_when_the_touch_is_gone(reference):
    course = Course(reference, 0.0, NOTHING)
    go(course, False, FIRST)
    go(course, True, END - FIRST - EARLY + 1, reference.flange_m[FIRST])
    assert go(course, False, 2)[-1] == END  # gone for two frames: released early
    assert not course.in_contact
    held = Course(reference, 0.0, NOTHING)
    go(held, False, FIRST)
    frames = go(held, True, END - FIRST + LATE_RELEASE - 1, reference.flange_m[FIRST])
    assert max(frames) == END - 1 and held.in_contact  # it is still felt, so it goes on
    assert held.offset_m[0] > 5e-3  # and so does the path
    assert go(held, True, 3)[-1] is None  # but not for ever: it is not let go while it is felt


def test_touch_is_asked_for_until_the_demonstration_let_go(reference):
    """Asked for beyond that, a plan would cling to what gives way at last, and press what lies behind it."""
    reference.area[END - 2 : END] = 0.2, 0.3
    frames = np.arange(END - 2, END + 2)
    course = Course(reference, 0.0, NOTHING)
    go(course, False, FIRST)
    go(course, True, 1, reference.flange_m[FIRST])
    np.testing.assert_array_equal(course.area_goal(frames), [0.2, 0.3, np.nan, np.nan])
    reference.area[END:] = 0.1
    lasting = Course(reference, 0.0, NOTHING)
    go(lasting, False, FIRST)
    go(lasting, True, 1, reference.flange_m[FIRST])
    np.testing.assert_array_equal(lasting.area_goal(np.arange(LENGTH - 1, LENGTH + 2)), [0.1] * 3)


def test_a_touch_elsewhere_is_answered_as_demonstrations_answer_it(reference):
    """Hands that go back to the middle at 3 per second, with tremor: read from the recordings, and done."""
    rng = np.random.default_rng(0)
    recorded = []
    for _ in range(5):
        centre = np.full((LENGTH, 2), np.nan)
        centre[FIRST:END] = rng.normal(0, 3, (END - FIRST, 2))
        action = np.zeros((LENGTH, 4))
        action[:, :3] = rng.normal(0, 0.003, (LENGTH, 3))
        action[FIRST:END, 1] -= 3e-3 * centre[FIRST:END, 0]
        recorded.append(replace(reference, centre_mm=centre, action=action))
    gain = reaction_hz(recorded)
    np.testing.assert_allclose(gain[1], [-3, 0], atol=0.3)
    assert not gain[[0, 2]].any()  # tremor is no answer
    assert not reaction_hz([reference]).any()

    course = Course(recorded[0], 0.004, gain)
    go(course, False, FIRST)
    there = recorded[0].centre_mm[FIRST]
    course.advance(0.1, there + (2.0, 0.0), reference.flange_m[FIRST])
    assert course.answer[1] == pytest.approx(-6e-3, rel=0.1)
    np.testing.assert_allclose(course.offset_m, [0, course.answer[1] / 15, 0])  # not where the object stands
    course.advance(0.1, recorded[0].centre_mm[FIRST + 1], reference.flange_m[FIRST])
    assert not course.answer.any()
