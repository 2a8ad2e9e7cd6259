"""Each branch of the verdict, and each objection."""

from types import SimpleNamespace

import pytest

from lerobot_pneutac.diagnosis.verdict import (
    NONE,
    Evidence,
    Explained,
    decide,
    explained,
    mechanism,
    too_few,
)
from lerobot_pneutac.study.body import shown_by_gauge


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
        ({"at_bound": ["lag(p).time_s"], "agreed": 0.2, "later": 1.1}, "missing_effect"),
        ({"forward": False, "later": 1.4}, "insufficient_form"),
        ({"cancelling": ["lag(p)"]}, "insufficient_form"),
        ({"removed": 0.51}, "missing_effect"),
        ({"removed": 0.49, "after": 1.3}, "unknown_effect"),
        ({"removed": 0.49}, "missing_effect"),
        ({"removed": 0.49, "after": 4.0}, "unknown_effect"),
        ({"after": 9.0, "noise_known": False}, "missing_effect"),
        ({"after": 9.0, "noise_known": False, "left_to_black_box": 0.5}, "insufficient_form"),
        (NOTHING | {"before": 1.19, "after": 1.19}, "adequate"),
        (NOTHING | {"before": 1.21, "after": 1.21}, "unknown_effect"),
        (NOTHING | {"before": 1.21, "after": 1.21, "later": 1.1, "program": 1.1}, "adequate"),
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
            ["the noise was not measured", "a black box still removes 40 % of what is left"],
        ),
        (
            {"forward": False},
            ["fitted to the earlier part, less than half of its improvement stays in the later one"],
        ),
        ({"agreed": 2 / 7}, ["only 29 % of the splits chose it"]),
        ({"at_bound": ["a.b", "c.d"]}, ["b of a, d of c stopped at a bound"]),
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


@pytest.mark.parametrize(
    ("change", "answer"),
    [
        ({"interval": (1.0, 1.1), "later": 1.1}, "fully"),
        ({"interval": (1.0, 1.1)}, "fully"),
        ({"interval": (0.9, 1.51), "later": 1.1}, "undetermined"),
        ({"interval": (1.0, 1.1), "later": 1.33}, "fully"),
        ({"interval": (1.0, 1.1), "later": 1.34}, "mostly"),
        ({"interval": (1.0, 1.1), "later": 1.1, "program": 1.41}, "fully"),
        ({"interval": (1.0, 1.1), "later": 1.1, "program": 1.43}, "mostly"),
        ({"after": 1.24, "interval": (1.2, 1.3), "later": 1.0, "program": 1.33}, "fully"),
        ({"after": 1.24, "interval": (1.2, 1.3), "later": 1.2, "program": 1.34}, "mostly"),
        ({"after": 1.21, "interval": (1.0, 1.51), "later": 1.0, "program": 1.0}, "mostly"),
        ({"interval": (1.0, 1.1), "later": 1.1, "unseen": "it was never turned"}, "mostly"),
        ({"interval": (1.0, 1.1), "later": 0.6, "program": 1.51}, "mostly"),
        ({"interval": (1.0, 1.1), "at_bound": ["a.b"], "forward": False, "later": 1.2}, "fully"),
        ({"after": 2.0, "removed": 0.875, "interval": (1.9, 2.1)}, "mostly"),
        ({"after": 3.4, "removed": 0.56, "interval": (3.0, 4.2)}, "undetermined"),
        ({"after": 3.8, "removed": 0.44, "interval": (3.4, 4.2)}, "undetermined"),
        ({"after": 4.0, "removed": 0.37, "interval": (3.9, 4.1)}, "no"),
        ({"after": 4.0, "noise_known": False}, "undetermined"),
        ({"after": 1.1, "noise_known": False}, "fully"),
        (NOTHING | {"after": 1.1}, "fully"),
        (NOTHING | {"after": 5.0}, "no"),
        (NOTHING | {"after": 5.0, "near_miss": ["creep"]}, "undetermined"),
        ({"after": None, "before": None}, "undetermined"),
        ({"poor": True}, "undetermined"),
        ({"after": 0.7, "interval": (0.6, 0.8), "noise_known": False}, "undetermined"),
        ({"after": 0.8, "interval": (0.7, 0.9), "noise_known": False}, "fully"),
        ({"after": 0.7, "interval": (0.6, 0.8)}, "fully"),
    ],
)
def test_how_much_is_explained_follows_error_interval_and_out_of_time_error(change, answer):
    assert explained(evidence(**change)) is Explained(answer)


def test_probabilities_of_a_mechanism_sum_to_one_and_grow_with_the_evidence():
    def of(cause="creep", drop=10.0, removed=0.95, missed=0.0, found=()):
        return mechanism(cause, drop, removed, missed, {cause, *found})

    for m in (of(), of("valve_lag"), of(drop=0.0, removed=0.0), of("no such family")):
        assert sum(p for _, p in m.ranked) == pytest.approx(1.0)
        assert [p for _, p in m.ranked] == sorted((p for _, p in m.ranked), reverse=True)
    assert of(drop=100.0).probability > of(drop=1.0).probability
    assert of(missed=0.3).probability < of(missed=0.1).probability < of().probability
    assert of(removed=0.99).probability > of(removed=0.5).probability
    assert of(drop=1000.0).certain and not of(drop=1e-9, removed=0.2).certain
    assert of(drop=1e-9, removed=0.2).ranked[0][0] == NONE
    # A valve's lag stands for others more often than creep, and for none that was found besides.
    assert of("valve_lag").probability < of().probability
    assert "leak" in dict(of("valve_lag").ranked)
    assert "leak" not in dict(of("valve_lag", found=["leak"]).ranked)


def test_the_measured_pressure_decides_whether_a_lag_is_in_the_air():
    def of(cause, **more):
        return mechanism(cause, 60.0, 0.99, 0.0, {cause}, **more)

    for cause in ("dead_time", "valve_lag"):
        assert not of(cause).named
        assert of(cause, gauge=True).probability > 0.7
        not_shown = of(cause, gauge=False)
        assert not_shown.probability <= 0.1 and "tracker" in dict(not_shown.ranked)
        assert sum(p for _, p in not_shown.ranked) == pytest.approx(1.0)
    assert of("orifice_flow", gauge=True) == of("orifice_flow")
    assert of("dead_time", gauge=True).certain
    assert not of("dead_time", gauge=True, elsewhere=False).certain


@pytest.mark.parametrize(
    ("of_pressure", "error", "cause", "found", "shown"),
    [
        (["dead_time"], 1.0, "dead_time", ["dead_time", "creep"], True),
        (["valve_slew"], 9.0, "valve_lag", ["valve_lag"], True),
        (["valve_lag", "leak"], 1.0, "valve_lag", ["valve_lag"], None),
        (["valve_lag", "leak"], 1.0, "valve_lag", ["valve_lag", "leak"], True),
        (["valve_lag"], 1.0, "dead_time", ["dead_time"], None),
        ([], 1.0, "dead_time", ["dead_time"], False),
        ([], 1.3, "dead_time", ["dead_time"], None),
        (["leak"], 1.0, "dead_time", ["dead_time"], False),  # which the twin has already
        (None, 1.0, "dead_time", ["dead_time"], None),
    ],
)
def test_a_cause_is_shown_where_the_pressure_needs_it_and_no_other(of_pressure, error, cause, found, shown):
    final = SimpleNamespace(value=error**2, model=None)
    air = None
    if of_pressure is not None:
        final.model = SimpleNamespace(structure=SimpleNamespace(effects=of_pressure))
        air = SimpleNamespace(final=final)
    study = SimpleNamespace(air_noise=1.0, twin_effects=["leak"] if of_pressure == ["leak"] else [])
    assert shown_by_gauge(study, SimpleNamespace(air=air), cause, found) is shown
