"""The benchmark of the diagnosis: what is in each set, how it scores, and that it resumes.

The two answers scored: weights come back from made-up causes, and reported shares are counted.

The benchmark of experiments: a foreign device that remembers its programs, and how an answer is scored.

The benchmark of demonstrations: what is hidden, and when an answer is right.
"""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from lerobot_pneutac.reports.page import save_table
from pneutac_benchmarks.demonstrations import VALVE, names_right
from pneutac_benchmarks.diagnosis import (
    real,
    rules,
    table_truths,
    truths,
)
from pneutac_benchmarks.diagnosis.answers import fitted, predicted
from pneutac_benchmarks.diagnosis.cases import BenchmarkDiagnosisConfig, Case, diagnosed
from pneutac_benchmarks.diagnosis.rules import COUNTS, counts
from pneutac_benchmarks.experiments import _known_at
from pneutac_datasets.generate.finger import TruthBench
from pneutac_sim.effects.laws import FAMILIES, family, law_names
from pneutac_sim.effects.registry import body_effects
from pneutac_sim.errors import InputError
from pneutac_truths import EFFECTS, PAIRS, generate
from pneutac_truths.programs import given

# ---------------------------------------------------------------- truths


def truth_answer(effects, selected, verdict="missing_effect", ratio=1.1, kind="effect", device="rod"):
    parts = PAIRS.get(effects, (effects,) if effects in EFFECTS else ())
    floor, before = 0.4, 2.0
    return {
        "set": "truths", "kind": kind, "effects": effects, "device": device, "seed": 0, "truth": list(parts),
        "physics": [p for p in parts if EFFECTS[p].physics], "verdict": verdict, "selected": selected,
        "floor": floor, "constant": 20.0, "before": before, "after": ratio * floor, "ratio": ratio,
        "removed": rules.removed(before, 20.0, ratio * floor, floor), "seconds": 30.0,
        "explained": "fully" if ratio <= 1.2 else "no", "causes": [],
    }  # fmt: skip


def test_the_rules_know_every_truth_and_every_name():
    names = {*FAMILIES, *map(family, law_names()), *law_names(), *body_effects(), rules.BASE}
    assert set(rules.COUNTS) == set(EFFECTS)
    assert {n for accepted in rules.COUNTS.values() for n in accepted} <= names


def test_the_share_removed_counts_only_what_could_be_removed():
    assert rules.removed(2.0, 9.0, 0.4, 0.4) == 1.0
    assert rules.removed(2.0, 9.0, 2.0, 0.4) == 0.0
    assert rules.removed(2.0, 1.0, 1.0, 0.4) == 0.0, "a twin worse than a constant has no credit for that"
    assert rules.removed(2.0, 9.0, 3.0, 0.4) < -1
    assert rules.removed(0.402, 9.0, 0.4, 0.4) is None
    assert rules.removed(1.0, 9.0, 0.1, 0.4) == 1.0, "below the floor is no more than all"


@pytest.mark.parametrize("effects, selected, verdict, ratio, expected", [
    ("creep_fractional", ["power_law_memory(p)"], "missing_effect", 1.1, True),
    ("creep_fractional", ["creep"], "insufficient_form", 1.6, True),
    ("creep_fractional", ["lag(p) #2"], "missing_effect", 1.1, True),
    ("creep_fractional", ["lag(p)"], "unknown_effect", 1.1, False),
    ("creep_fractional", ["play(p)", "lag(p)"], "missing_effect", 1.1, False),
    ("creep_fractional", [], "adequate", 1.0, False),
    ("hunting", ["play(p)"], "missing_effect", 1.1, False),
    ("hunting", [], "unknown_effect", 3.0, True),
    ("soft_clamp", [], "adequate", 1.1, True),
    ("soft_clamp", [], "unknown_effect", 4.0, False),
    ("creep_and_hysteresis", ["play(p)", "lag(p)"], "missing_effect", 1.1, True),
    ("creep_and_hysteresis", ["lag(p)"], "missing_effect", 1.1, False),
    ("tube_kink", ["lag(p; time moves with p)"], "missing_effect", 1.1, True),
    ("tube_kink", ["lag(p)"], "missing_effect", 1.1, False),
    ("marker_slip", [], "unknown_effect", 5.0, True),
    ("marker_slip", ["lag(p)"], "unknown_effect", 5.0, False),
    ("tracker_lowpass", ["tracker_lag"], "missing_effect", 1.1, True),
    ("plain", [], "adequate", 1.0, True),
    ("plain", ["p^3"], "missing_effect", 1.0, False),
])  # fmt: skip
def test_right_physics(effects, selected, verdict, ratio, expected):
    kind = "plain" if effects == "plain" else "pair" if effects in PAIRS else "effect"
    assert table_truths.score(truth_answer(effects, selected, verdict, ratio, kind))["right"] is expected


def test_truths_are_what_applies_to_each_device():
    full = truths.cases(BenchmarkDiagnosisConfig(seeds=2))
    assert len({c.key for c in full}) == len(full)
    singles = {c.effects for c in full if c.device == "rod"} & set(EFFECTS)
    assert singles == {e.name for e in EFFECTS.values() if "rod" in e.devices}
    moving = {c.effects for c in full if c.device == "cosserat"} - {"plain", "device"}
    assert moving == {e.name for e in EFFECTS.values() if e.devices == ("cosserat",)}
    out = truths.cases(BenchmarkDiagnosisConfig(set="own_form_out", seeds=1))
    assert {"creep_fractional", "hysteresis_preisach"} <= {c.effects for c in out}
    assert {"gravity", "dead_time", "stretch", "line_second_order"} <= {c.effects for c in out}
    assert not {"hunting", "soft_clamp", "marker_slip"} & {c.effects for c in out}
    with pytest.raises(InputError, match="there is no truth 'cooking'"):
        truths.cases(BenchmarkDiagnosisConfig(effects=("cooking",)))


@pytest.mark.nightly
@pytest.mark.parametrize(("truth", "out"), [("leak", COUNTS["leak"])])
def test_lines_and_parts_of_the_base_are_taken_out_too(truth, out, tmp_path, monkeypatch):
    """What a search would try, without running it: nothing that counts as the truth's own physics."""
    from lerobot_pneutac.study.body import BodyStudy
    from lerobot_pneutac.study.body_base import base_effects
    from lerobot_pneutac.study.body_search import BodySearch
    from pneutac_datasets.recording.recording import Recording
    from pneutac_sim.twin import Twin
    from pneutac_truths import generate, write

    tried = {}

    def look(study, jobs, steps):
        tried["base"] = base_effects(study)
        with pytest.raises(InterruptedError):
            BodySearch(study, map, lambda text: None).find()

    def stop(search):
        tried["space"] = search.space
        raise InterruptedError

    monkeypatch.setattr("lerobot_pneutac.study.body_search.Search.find", stop)
    monkeypatch.setattr(BodyStudy, "search", look)
    recording = Recording.load(write(generate("rod", [truth], 3, minutes=4.0), tmp_path / "day"))
    recording.samples.drop(columns="pressure_kpa", inplace=True)  # so that air and body are searched at once
    twin = Twin(recording.device, recording.length_mm)
    for wanted in (None, lambda name: not counts(name, out)):
        diagnosed(twin, recording, 0, wanted)
        space = tried["space"]
        names = {*tried["base"], *space.candidates, *(e for line in space.actuations for e in line)}
        assert bool(names & set(out)) == (wanted is None)
        assert "valve_lag" in names and "creep" in names


# ---------------------------------------------------------------- rivals


def test_options_are_told_what_is_right():
    with pytest.raises(InputError, match="--set=cooking must be one of truths"):
        BenchmarkDiagnosisConfig(set="cooking")
    with pytest.raises(InputError, match="must be some of rod, arm, cosserat"):
        BenchmarkDiagnosisConfig(devices=("tentacle",))
    assert BenchmarkDiagnosisConfig(set="real").out.name == "real"


def test_weights_come_back_from_answers_that_they_made():
    rng, true, own = np.random.default_rng(0), np.array([-1.0, 0.5, 1.5]), {"creep": 1.0, "snap": -1.0}
    X = np.column_stack([np.ones(20_000), rng.normal(2.0, 3.0, 20_000), rng.random(20_000) < 0.5])
    every = [{"features": x, "cause": c} for x, c in zip(X, rng.choice([*own], len(X)), strict=True)]
    p = predicted(every, true, own)
    every = [c | {"right": r} for c, r in zip(every, rng.random(len(X)) < p, strict=True)]
    np.testing.assert_allclose(predicted(every, *fitted(every)), p, atol=0.03)


def test_what_is_given_is_commanded_and_rests_lie_between():
    time_s, share = np.array([0.0, 1.0, 2.5]), np.array([0.2, 0.8, 0.0])
    p = given([("a", time_s, share), ("b", time_s, share)], 10.0)
    assert p.programs == ["a", "b"] and p.pauses_s == [0.0, 10.0]
    assert p.time_s[p.starts[1]] - p.time_s[p.ends[0] - 1] == pytest.approx(10.0, abs=0.02)
    first = p.command[p.starts[0] : p.ends[0], 0]
    at = p.time_s[p.starts[0] : p.ends[0]]
    np.testing.assert_array_equal(first, np.where(at < 1 - 1e-9, 0.2, np.where(at < 2.5 - 1e-9, 0.8, 0.0)))
    assert not p.command[p.ends[0] : p.starts[1]].any()
    assert set(p.sent_s[p.starts[0] : p.ends[0]]) == {0.0, 1.0, 2.5}


@pytest.mark.slow
def test_a_device_remembers_the_programs_before(tmp_path):
    t = np.arange(0, 6.05, 0.05)
    bench = TruthBench(("creep_fractional",), 3)
    for number, top in enumerate((0.9, 0.3)):
        file = tmp_path / f"{number}.csv"
        kpa = np.where((t > 1) & (t < 5), top * bench.range_kpa[1], 0.0)
        save_table(file, {"time_s": t, "pressure_cmd_kpa": kpa, "program": "steps"})
        after = bench.follow(file, tmp_path / str(number), number)
        assert bench.pause_s == (None if number == 0 else 120.0)
    fresh = TruthBench(("creep_fractional",), 3).follow(file, tmp_path / "fresh", 0)
    pd.testing.assert_series_equal(after.samples["pressure_cmd_kpa"], fresh.samples["pressure_cmd_kpa"])
    apart = np.abs(after.column("tip_z_mm") - fresh.column("tip_z_mm"))[:15].mean()  # before the step
    assert apart > 3 * after.meta["noise"]["tip_z_mm"] / np.sqrt(15)


def test_known_counts_from_the_moment_after_which_it_stays_known():
    def step(minute, selected, ratio):
        return {"min": minute, "verdict": "missing_effect", "selected": selected, "ratio": ratio}

    right, wrong = ["power_law_memory(p)"], ["play(p)"]
    assert _known_at("creep_fractional", [step(1, right, 1.2), step(2, wrong, 1.2), step(3, right, 1.4)]) == 3
    assert _known_at("creep_fractional", [step(1, right, 1.6), step(2, right, 1.1)]) == 2
    assert _known_at("creep_fractional", [step(1, right, 1.2), step(2, right, 1.7)]) is None
    assert _known_at("creep_fractional", []) is None


def test_an_answer_is_right_where_it_names_all_that_was_hidden():
    assert names_right((), []) and not names_right((), ["creep"])
    assert names_right(("creep",), ["creep", "hysteresis"]) and not names_right(("creep",), ["hysteresis"])
    assert not names_right(("late_commands", "creep"), ["late_commands"])
    assert names_right(VALVE, ["valve_lag"]) and not names_right(VALVE, ["creep"])


@pytest.mark.nightly
def test_a_temperature_that_is_followed_minutes_late_is_found_through_unknown_pauses():
    answer = truths.solve(Case("truths", "effect", "temperature_lag", 967, 6.0, device="rod"))
    late_s = 60 * generate("rod", ["temperature_lag"], 967, minutes=0.5).effects["temperature_lag"]["minutes"]
    assert answer["terms"] == ["p lag(dT)"]
    assert answer["values"]["p lag(dT)"]["time_s"] == pytest.approx(late_s, rel=0.15)
    assert answer["ratio"] < 1.5


def test_both_days_state_their_pauses_where_that_is_asked():
    case = Case("truths", "effect", "mullins", 967, 1.0, device="rod")
    for asked in (case, replace(case, pauses=True)):
        with truths.two_days(asked) as days:
            for r in (days.learn, days.judge, days.logged):
                known = [s.pause_s for s in r.starts.values()][1:]
                assert all((p is not None) == asked.pauses for p in known) and known
    assert asked.key == f"{case.key}_pauses"


@pytest.mark.parametrize("held", [(), ("sopra_segment", "three_bellow_arm")])
def test_real_recordings_that_are_missing_are_named_before_work_starts(tmp_path, monkeypatch, held):
    for name in held:
        (tmp_path / "soft" / name).mkdir(parents=True)
        (tmp_path / "soft" / name / "recording.json").write_text("{}")
    monkeypatch.setenv("PNEUTAC_DATA", str(tmp_path))
    missing = "asu_segment" if held else "sopra_segment"
    with pytest.raises(
        InputError, match=f"PNEUTAC_DATA={tmp_path} holds no recording soft/{missing}; set it"
    ):
        real.cases(BenchmarkDiagnosisConfig(set="real"))
    monkeypatch.delenv("PNEUTAC_DATA")
    with pytest.raises(InputError, match="PNEUTAC_DATA= holds no recording soft/sopra_segment; set it to"):
        real.cases(BenchmarkDiagnosisConfig(set="real", fast=True))
