"""`pneutac benchmark diagnosis`: whether the diagnosis finds what a device does, and says so where not."""

import importlib
import json
import multiprocessing
import os
import signal
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

from rich.console import Console
from rich.progress import Progress

from pneutac_benchmarks.diagnosis.cases import BenchmarkDiagnosisConfig, Case
from pneutac_sim.files import write_json

__all__ = ["BenchmarkDiagnosisConfig", "benchmark_diagnosis"]

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
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
    folder, cases = cfg.folder / "cases", of_set.cases(cfg)
    folder.mkdir(parents=True, exist_ok=True)
    todo = [c for c in cases if not (folder / f"{c.key}.json").is_file()]
    console = Console()
    console.print(f"{len(cases)} cases, {len(todo)} to do; Ctrl-C stops, the same command goes on")
    solve_cases(todo, folder, cfg.jobs or len(os.sched_getaffinity(0)), console)
    answers = [json.loads((folder / f"{c.key}.json").read_text()) for c in cases]
    of_table.write_table(answers, cfg.folder, console)


def solve_cases(todo: list[Case], folder: Path, jobs: int, console: Console) -> None:
    """Solves all cases, each in one process and on one thread."""
    if not todo:
        return
    os.environ.update({k: os.environ.get(k, "1") for k in THREADS})
    pool = ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn"), _ignore_interrupt)
    try:
        with Progress(console=console, transient=True) as bar:
            task = bar.add_task("diagnoses", total=len(todo))
            for future in as_completed([pool.submit(solve, c, folder) for c in todo]):
                future.result()
                bar.advance(task)
    except BaseException:
        for p in list(pool._processes.values()):
            p.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _ignore_interrupt() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def solve(case: Case, folder: Path) -> None:
    """Solves one case and writes its answer."""
    module = importlib.import_module(f"pneutac_benchmarks.diagnosis.{SETS[case.set][0]}")
    write_json(folder / f"{case.key}.json", module.solve(case))
