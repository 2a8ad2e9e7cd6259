"""`pneutac benchmark`: a result names what it can be repeated by."""

import json

from lerobot_pneutac.cli import benchmark

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
    benchmark.command(["tiny"], None)  # which writes nothing
    assert [p.name for p in tmp_path.glob("*/result.json")] == ["result.json"]
