"""Ordinary logs: what is drawn, the table, and a fixed part of the benchmark itself."""

import numpy as np
import pytest

from pneutac_benchmarks.diagnosis import logs
from pneutac_benchmarks.diagnosis.cases import BenchmarkDiagnosisConfig, Case
from pneutac_sim.errors import InputError

PLAIN = (2, 3, 5, 8, 14, 17, 18, 21, 23, 26, 29, 31, 33, 36)
EFFECTS = (
    ("valve", 160),
    *(pytest.param(*c, marks=pytest.mark.nightly) for c in (("creep", 120), ("hysteresis", 140))),
)


def test_each_level_comes_at_least_forty_times_in_600_plain_logs():
    made = logs.cases(BenchmarkDiagnosisConfig(set="logs", seeds=600))
    drawn = [logs.drawn(c) for c in made if c.kind == "plain"]
    assert len(drawn) == 600 and len({c.key for c in made}) == len(made) == 720
    levels = {
        "hz": logs.RATES_HZ, "hold_s": logs.HOLDS_S, "program": logs.PROGRAMS, "trials": (1, 2, 3, 6),
        **dict.fromkeys(("repeats", "gauge", "sent", "stated", "tips"), (False, True)),
    }  # fmt: skip
    for name, values in levels.items():
        for value in values:
            assert sum(getattr(x, name) == value for x in drawn) >= 40, (name, value)


def off_a_line(r) -> float:
    """Standard deviation of the bend from the straight line in pressure that fits it best."""
    line, bend = np.c_[r.column("pressure_cmd_kpa"), np.ones(len(r))], r.column("bend_angle_rad")
    return (bend - line @ np.linalg.lstsq(line, bend, rcond=None)[0]).std()


def test_a_plain_log_is_a_straight_line_and_noise():
    for seed in range(6):
        log, r, noise = logs.made(Case("logs", "plain", "plain", seed))
        if log.tips:
            continue
        assert off_a_line(r) == pytest.approx(noise, rel=0.1)
        assert ("time_sent_s" in r.samples) == log.sent and ("pressure_kpa" in r.samples) == log.gauge
        assert ("noise" in r.meta) == log.stated and r.samples["trial"].nunique() == log.trials


def test_an_effect_is_five_times_the_noise():
    for effect in logs.ACCEPTED:
        log, r, noise = logs.made(Case("logs", "effect", effect, 3))
        if not log.tips:
            assert off_a_line(r) / noise == pytest.approx(26**0.5, rel=0.1)


def test_other_effects_are_refused_in_one_sentence():
    with pytest.raises(InputError, match="'cooking' must be one of plain, creep, hysteresis, valve"):
        logs.cases(BenchmarkDiagnosisConfig(set="logs", effects=("cooking",)))


@pytest.mark.nightly  # every day: where nothing is missing, in test_diagnose
@pytest.mark.parametrize("seed", PLAIN)
def test_nothing_is_named_where_nothing_is(seed):
    a = logs.solve(Case("logs", "plain", "plain", seed))
    assert "crash" not in a, a.get("where")
    assert (a["verdict"], a["selected"]) == ("adequate", [])
    assert a["floor"] == pytest.approx(a["noise"], rel=0.2)
    assert all("no measured pressure" in f for f in a["findings"])


@pytest.mark.slow
@pytest.mark.parametrize(("effect", "seed"), EFFECTS)
def test_an_effect_of_five_times_the_noise_is_found(effect, seed):
    a = logs.solve(Case("logs", "effect", effect, seed))
    assert "crash" not in a, a.get("where")
    before, after = a["error_over_noise"]
    assert a["right"] and after < 0.5 * before
