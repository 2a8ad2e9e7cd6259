"""`pneutac benchmark`: a result names what it can be repeated by."""

import json

import pytest

from lerobot_pneutac.cli import benchmark
from lerobot_pneutac.reports.page import write_result
from pneutac_benchmarks.diagnosis import table_truths, truths
from pneutac_sim.errors import InputError

MODULE = '''
from dataclasses import dataclass
from pathlib import Path

from lerobot_pneutac.reports.page import write_result


@dataclass
class BenchmarkTinyConfig:
    """Options of `pneutac benchmark tiny`."""

    out: Path | None = None  # folder
    runs: int = 1  # number of runs


def benchmark_tiny(config):
    if config.out:
        write_result(config.out, {"rows": [config.runs]})
        write_result(config.out / "part", {"rows": []})
'''


def test_a_result_names_command_version_and_commit(tmp_path, monkeypatch):
    (tmp_path / "tiny_benchmark.py").write_text(MODULE)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(benchmark.TABLES, "tiny", "tiny_benchmark")
    monkeypatch.setattr("sys.argv", ["pneutac benchmark"])
    benchmark.command(["tiny", "--runs=3", f"--out={tmp_path / 'my out'}"], None)
    found = json.loads((tmp_path / "my out" / "result.json").read_text())
    assert found["rows"] == [3] and found["version"] and found.get("commit") != ""
    assert found["made_by"] == f"pneutac benchmark tiny --runs=3 '--out={tmp_path}/my out'"
    part = json.loads((tmp_path / "my out" / "part" / "result.json").read_text())
    assert part["made_by"] == found["made_by"]
    benchmark.command(["tiny"], None)  # which writes nothing
    assert [p.name for p in tmp_path.glob("*/result.json")] == ["result.json"]
    assert "made_by" not in json.loads(write_result(tmp_path, {"rows": []}).read_text()), "it has ended"


def test_a_benchmark_that_chooses_its_folder_names_its_command_too(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(truths, "cases", lambda cfg: [])
    monkeypatch.setattr(table_truths, "write_table", lambda answers, out, _: write_result(out, {}))
    monkeypatch.setattr("sys.argv", ["pneutac benchmark"])
    benchmark.command(["diagnosis"], None)
    found = json.loads((tmp_path / "outputs/benchmark_diagnosis/truths/result.json").read_text())
    assert found["made_by"] == "pneutac benchmark diagnosis"
    with pytest.raises(InputError, match="holds a run with another set; give another folder"):
        benchmark.command(["diagnosis", "--set=lab", "--out=outputs/benchmark_diagnosis/truths"], None)
