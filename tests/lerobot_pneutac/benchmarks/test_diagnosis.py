"""The blind benchmark: what is in it, how it scores, and that it resumes."""

import json

import numpy as np
import pytest
from rich.console import Console

from lerobot_pneutac.benchmarks.diagnosis import main as benchmark_diagnosis
from lerobot_pneutac.benchmarks.diagnosis.main import BenchmarkDiagnosisConfig, DiagnosisCase, cases, solve
from lerobot_pneutac.benchmarks.diagnosis.table import confusion, right, summary, wilson, write_table
from lerobot_pneutac.cli import benchmark
from pneutac_sim.errors import InputError


def answer(kind, effects, verdict, selected, accepts, strength=1.0):
    return {
        "kind": kind, "effects": effects, "strength": strength, "seed": 0, "verdict": verdict,
        "selected": selected,
        "before": 2.5, "after": 0.6, "noise_floor": 0.5, "reduction": 0.95, "seconds": 10.0,
        "truth": {"effects": effects.split(","), "accepts": accepts},
    }  # fmt: skip


ANSWERS = [
    answer("effect", "creep", "missing_effect", ["creep"], [["creep"]]),
    answer("effect", "creep", "insufficient_form", ["creep", "leak"], [["creep"]]),
    answer(
        "effect", "stiffening", "missing_effect", ["gain_saturation"], [["stiffening", "gain_saturation"]]
    ),
    answer("effect", "leak", "unknown_effect", ["leak"], [["leak"]]),
    answer("none", "none", "adequate", [], []),
    answer("none", "none", "unknown_effect", [], []),
    answer("unknown", "disturbance_vibration", "unknown_effect", [], []),
    answer("pair", "creep,gravity", "missing_effect", ["gravity", "creep"], [["creep"], ["gravity"]]),
    answer("pair", "creep,gravity", "missing_effect", ["gravity"], [["creep"], ["gravity"]]),
]


def test_scoring_is_strict():
    assert [right(a) for a in ANSWERS] == [True, True, True, False, True, False, True, True, False]


def test_table_and_picture(tmp_path):
    write_table(ANSWERS, tmp_path, Console(quiet=True))
    text = (tmp_path / "table.md").read_text()
    assert (
        "| one effect, strength 1 | 3 of 4 |" in text and "| leak | 1 | 0 of 1 | unknown_effect 1 |" in text
    )
    result = json.loads((tmp_path / "result.json").read_text())
    assert len(result["wrong"]) == 3
    assert {r["group"]: r["with_extra"] for r in result["groups"]}["one effect, strength 1"] == 1
    picture = confusion(ANSWERS)
    assert picture.dtype == np.uint8 and picture.shape[2] == 3 and len(np.unique(picture)) > 10
    assert summary(ANSWERS)[0]["ci95"] == pytest.approx(wilson(3, 4))


def test_the_full_benchmark_holds_every_effect_strength_and_seed():
    full = cases(BenchmarkDiagnosisConfig())
    assert len({c.key for c in full}) == len(full)
    singles = [c for c in full if c.kind == "effect"]
    assert len(singles) == len({c.effects for c in singles}) * 3 * 5
    assert sum(c.kind == "none" for c in full) == 40
    assert {c.kind for c in full} == {"effect", "pair", "none", "unknown"}
    assert len(cases(BenchmarkDiagnosisConfig(fast=True))) < len(full) / 8


def test_a_case_is_solved_blindly_and_kept(tmp_path, monkeypatch):
    """The truth is read after the answer was written; a finished case is not repeated."""
    case = DiagnosisCase("none", "none", 1.0, 5004, 2.0)
    solve(case, tmp_path)
    kept = json.loads((tmp_path / f"{case.key}.json").read_text())
    assert kept["truth"]["effects"] == [] and kept["verdict"] in ("adequate", "ambiguous")
    out = tmp_path / "out"
    (out / "cases").mkdir(parents=True)
    (out / "cases" / f"{case.key}.json").write_text(json.dumps(kept))
    monkeypatch.setattr(benchmark_diagnosis, "cases", lambda cfg: [case])
    monkeypatch.setattr(benchmark_diagnosis, "solve", None)
    benchmark.main(["diagnosis", f"--out={out}"])
    assert (out / "table.md").is_file() and (out / "confusion.png").is_file()


def test_other_tables_say_so_in_one_sentence():
    with pytest.raises(InputError, match="no benchmark; give one of diagnosis"):
        benchmark.main(["cooking"])
