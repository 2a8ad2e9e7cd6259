"""Each branch of the verdict, and each objection."""

import pytest

from lerobot_pneutac.diagnosis.verdict import Evidence, decide, too_few


def evidence(**change):
    base = {
        "before": 5.0, "after": 1.05, "selected": ["lag(p)"], "removed": 0.99,
    }  # fmt: skip
    return Evidence(**(base | change))


NOTHING = {"selected": [], "removed": 0.0}


@pytest.mark.parametrize(
    ("change", "verdict"),
    [
        ({}, "missing_effect"),
        ({"after": 1.49}, "missing_effect"),
        ({"after": 1.51}, "insufficient_form"),
        ({"after": 1.21, "left_to_black_box": 0.19}, "missing_effect"),
        ({"after": 1.21, "left_to_black_box": 0.21}, "insufficient_form"),
        ({"after": 1.19, "left_to_black_box": 0.9}, "missing_effect"),
        ({"forward": False}, "insufficient_form"),
        ({"agreed": 0.49}, "insufficient_form"),
        ({"agreed": 0.5}, "missing_effect"),
        ({"at_bound": ["lag(p).time_s"]}, "insufficient_form"),
        ({"cancelling": ["lag(p)"]}, "insufficient_form"),
        ({"removed": 0.51}, "missing_effect"),
        ({"removed": 0.49, "after": 1.3}, "unknown_effect"),
        ({"removed": 0.49}, "missing_effect"),
        ({"removed": 0.49, "after": 4.0}, "unknown_effect"),
        ({"after": 9.0, "noise_known": False}, "missing_effect"),
        ({"after": 9.0, "noise_known": False, "left_to_black_box": 0.5}, "insufficient_form"),
        (NOTHING | {"before": 1.19, "after": 1.19}, "adequate"),
        (NOTHING | {"before": 1.21, "after": 1.21}, "unknown_effect"),
        (NOTHING | {"after": 5.0, "near_miss": ["creep"]}, "ambiguous"),
        (NOTHING | {"before": 1.1, "after": 1.1, "near_miss": ["creep"]}, "adequate"),
        (NOTHING | {"before": 5.0, "after": 1.1}, "adequate"),
        (NOTHING | {"after": 5.0, "noise_known": False}, "adequate"),
        (NOTHING | {"after": 5.0, "noise_known": False, "left_to_black_box": 0.5}, "unknown_effect"),
        ({"poor": True}, "ambiguous"),
        (NOTHING | {"before": 1.0, "poor": True}, "ambiguous"),
    ],
)
def test_verdicts_follow_the_evidence(change, verdict):
    assert decide(evidence(**change)) == verdict


@pytest.mark.parametrize(
    ("given", "few"),
    [((59, 20), True), ((60, 6), False), ((60, 5), True), ((9, 20, 10), True), ((10, 6, 10), False)],
)
def test_too_few_samples_or_pieces_of_time_are_no_base_for_a_claim(given, few):
    assert too_few(*given) == few


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({}, []),
        ({"after": 2.34}, ["the error stays at 2.3 times the noise"]),
        ({"after": 1.4, "left_to_black_box": 0.4}, ["a black box still removes 40 % of what is left"]),
        (
            {"noise_known": False, "after": 9.0, "left_to_black_box": 0.4},
            ["the noise is not known", "a black box still removes 40 % of what is left"],
        ),
        ({"forward": False}, ["fitted to the earlier part, it does not hold in the later one"]),
        ({"agreed": 2 / 7}, ["only 29 % of the splits chose it"]),
        ({"at_bound": ["a.b", "c.d"]}, ["a.b, c.d stopped at a bound"]),
        (
            {"cancelling": ["a", "b"]},
            ["a and b would alone move it by more than it travels, and cancel with the rest"],
        ),
    ],
)
def test_each_objection_is_one_phrase(change, said):
    assert evidence(**change).objections == said


def test_objections_add_up():
    all_at_once = {
        "after": 3.0,
        "left_to_black_box": 0.4,
        "forward": False,
        "agreed": 0.1,
        "at_bound": ["a.b"],
    }
    assert len(evidence(**all_at_once).objections) == 5
