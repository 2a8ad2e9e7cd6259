"""The course of a demonstration through a new scene follows the touch, not the clock."""

from dataclasses import replace

import numpy as np
import pytest

from pneutac_datasets.demonstrations.augment.planner import EARLY, LATE_RELEASE, LATE_TOUCH, Course
from pneutac_datasets.demonstrations.augment.reference import Reference, reaction_hz

FIRST, END, LENGTH = 40, 70, 90
NOTHING, NOWHERE = np.zeros((3, 2)), np.full(2, np.nan)


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
        frames.append(course.frame if course.advance(touched, NOWHERE, np.array(flange_m)) else None)
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
