"""Looks and shape of soft fingers, one after the other."""

import importlib

from pneutac_benchmarks.body.options import PARTS, BenchmarkBodyConfig


def benchmark_body(cfg: BenchmarkBodyConfig) -> None:
    """Runs one part or both."""
    for part in PARTS if cfg.part == "all" else [cfg.part]:
        module = importlib.import_module(f"pneutac_benchmarks.body.{part}")
        getattr(module, f"benchmark_{part}")(cfg)
