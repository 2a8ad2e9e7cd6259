"""The benchmark of experiments: a foreign device that remembers its programs, and how an answer is scored."""

import numpy as np
import pandas as pd
import pytest

from lerobot_pneutac.verbs.benches import save_program
from pneutac_benchmarks.experiments import _known_at
from pneutac_datasets.generate.truth_bench import TruthBench
from pneutac_truths.programs import given


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
        save_program(file, t, np.where((t > 1) & (t < 5), top * bench.range_kpa[1], 0.0), "steps")
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
