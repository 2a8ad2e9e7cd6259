"""Set `rivals`: the same two days for other methods; each learns what the twin as it is leaves of day 1."""

import time
from collections.abc import Callable
from dataclasses import asdict, replace
from types import SimpleNamespace

import numpy as np

from pneutac_benchmarks.diagnosis import regressors, truths
from pneutac_benchmarks.diagnosis.cases import BenchmarkDiagnosisConfig, Case, diagnosed
from pneutac_benchmarks.diagnosis.rules import removed

METHODS: dict[str, Callable] = {
    "ridge on products": regressors.ridge,
    "STLSQ": regressors.stlsq,
    "Gaussian process": regressors.gaussian_process,
    "network": regressors.network,
    "symbolic regression (pyoperon)": regressors.symbolic,
}


def cases(cfg: BenchmarkDiagnosisConfig) -> list[Case]:
    """The truths."""
    return truths.cases(cfg)


def solve(case: Case) -> dict:
    """Laws, library alone and every black box on one device."""
    from pneutac_sim.effects.registry import body_effects

    with truths.two_days(case) as days:
        answer = asdict(case) | {
            "truth": list(days.truth.effects),
            "physics": days.physics,
            "floor": days.floor,
        }
        constant, methods = days.constant(), {}
        for name, wanted in (("laws", None), ("library alone", lambda n: n in body_effects())):
            began = time.perf_counter()
            d = diagnosed(days.twin, days.learn, case.seed, wanted)
            found = truths.scored(days, d, time.perf_counter() - began)
            methods[name] = {
                k: found[k] for k in ("after", "ratio", "removed", "seconds", "verdict", "selected")
            }
            answer["before"] = found["before"] if name == "laws" else answer["before"]
        shared = [c for c in d.study.recording.samples if c in days.judge.samples]
        first, second = (_features(r, shared, d.study) for r in (d.study.recording, days.judge))
        left, rest = d.outcome.before.residual, days.residual(d.outcome.before.twin)
        for name, method in METHODS.items():
            began = time.perf_counter()
            made = method(first, left, second, case.seed)
            if made is None:
                methods[name] = {"skipped": "not installed"}
                continue
            after = truths.rms(rest - made)
            gone = removed(answer["before"], constant, after, days.floor)
            seconds = time.perf_counter() - began
            methods[name] = {"after": after, "ratio": after / days.floor, "removed": gone, "seconds": seconds}
    return answer | {"constant": constant, "methods": methods}


def _features(recording, shared: list[str], study) -> np.ndarray:
    """(n, f) causal signals of the command and the conditions of any day, by columns that both days have."""
    from lerobot_pneutac.study.body_base import features

    return features(
        SimpleNamespace(
            recording=replace(recording, samples=recording.samples[shared]),
            twin=study.twin,
            start=study.start,
        )
    )
