"""`pneutac benchmark diagnosis`: whether the diagnosis finds what a device does, and says so where not."""

import importlib
import json
from functools import partial
from pathlib import Path

from rich.console import Console

from lerobot_pneutac.cli.terminal import progress_bar
from pneutac_benchmarks.diagnosis.cases import BenchmarkDiagnosisConfig, Case
from pneutac_sim.executor import run_pieces
from pneutac_sim.files import claim, write_json

__all__ = ["BenchmarkDiagnosisConfig", "benchmark_diagnosis"]

# set -> its module with `cases(cfg)` and `solve(case)`, and the one with `write_table(answers, out, console)`
SETS = {
    "truths": ("truths", "table_truths"),
    "real": ("real", "table_real"),
    "extrapolation": ("truths", "table_truths"),
    "own_form_out": ("truths", "table_truths"),
    "rivals": ("rivals", "table_rivals"),
    "logs": ("logs", "table_logs"),
    "lab": ("lab", "table_lab"),
}


def benchmark_diagnosis(cfg: BenchmarkDiagnosisConfig) -> None:
    """Runs what is not there yet, then prints and writes the table."""
    of_set, of_table = (
        importlib.import_module(f"pneutac_benchmarks.diagnosis.{name}") for name in SETS[cfg.set]
    )
    cases = of_set.cases(cfg)
    files = [cfg.out / "cases" / f"{c.key}.json" for c in cases]
    console = Console()
    claim(cfg.out / "run.json", {"set": cfg.set})
    missing = sum(not file.is_file() for file in files)
    console.print(f"{len(cases)} cases, {missing} to do; Ctrl-C stops, the same command goes on")
    with progress_bar(Console(stderr=True)) as progress:
        run_pieces(partial(solve, cases, files), files, cfg.out / "logs", cfg, progress, "diagnoses")
    of_table.write_table([json.loads(file.read_text()) for file in files], cfg.out, console)


def solve(cases: list[Case], files: list[Path], number: int) -> None:
    """Solves the case of a number and writes its answer."""
    module = importlib.import_module(f"pneutac_benchmarks.diagnosis.{SETS[cases[number].set][0]}")
    write_json(files[number], module.solve(cases[number]))
