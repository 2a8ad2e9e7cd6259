"""Set `real`: recordings of real devices, split by blocks and forward in time, against black boxes."""

import os
import time
from dataclasses import asdict
from pathlib import Path

import numpy as np

from pneutac_benchmarks.diagnosis.cases import BenchmarkDiagnosisConfig, Case, diagnosed
from pneutac_benchmarks.diagnosis.rivals import METHODS
from pneutac_benchmarks.diagnosis.truths import rms
from pneutac_sim.errors import InputError

RECORDINGS = ("sopra_segment", "asu_segment", "three_bellow_arm")
MOST_SEEDS = 3
EARLIER = 0.6  # of the samples: `forward` learns from them and is judged on the rest


def cases(cfg: BenchmarkDiagnosisConfig) -> list[Case]:
    """Each recording, split by blocks with several seeds, and once forward in time.

    Raises InputError: a recording is missing.
    """
    names = RECORDINGS[:1] if cfg.fast else RECORDINGS
    root = os.environ.get("PNEUTAC_DATA", "")
    if lacking := [name for name in names if not (Path(root) / "soft" / name / "recording.json").is_file()]:
        raise InputError(
            f"PNEUTAC_DATA={root} holds no recording soft/{lacking[0]}; set it to the folder that holds"
            f" soft/{', soft/'.join(names)}."
        )
    seeds = range(cfg.first_seed, cfg.first_seed + min(cfg.seeds, MOST_SEEDS))
    made = [Case("real", "blocks", name, seed) for seed in seeds for name in names]
    return made + [Case("real", "forward", name, cfg.first_seed) for name in names]


def solve(case: Case) -> dict:
    """Diagnoses what may be learnt from, and judges on the rest."""
    from lerobot_pneutac.verbs.new import new_twin
    from pneutac_datasets.recording.checks import check
    from pneutac_datasets.recording.recording import Recording

    whole, _ = check(Recording.load(Path(os.environ["PNEUTAC_DATA"]) / "soft" / case.effects))
    learn = whole
    if case.kind == "forward":
        learn = whole.keep(np.arange(len(whole)) < EARLIER * len(whole))
    began = time.perf_counter()
    d = diagnosed(new_twin(whole.device, learn), learn, case.seed)
    answer = asdict(case) | {
        "verdict": d.verdict, "selected": d.selected, "unit": d.study.unit, "noise": d.study.noise.value,
        "noise_known": d.study.noise.known, "objections": d.outcome.evidence.objections,
        "agreed": d.outcome.evidence.agreed, "black_box": d.outcome.evidence.left_to_black_box,
        "seconds": time.perf_counter() - began,
    }  # fmt: skip
    return answer | (_forward(d, whole) if case.kind == "forward" else _blocks(d, case.seed))


def _blocks(d, seed: int) -> dict:
    """Errors on the test blocks of the study's own split."""
    from lerobot_pneutac.study.body_base import features

    study, test = d.study, d.study.parts.test
    before = d.outcome.before.residual
    signals = features(study)
    return {
        "before": d.before["heldout"],
        "after": d.after["heldout"],
        "methods": _black_boxes(signals[~test], before[~test], signals[test], before[test], seed),
    }


def _forward(d, whole) -> dict:
    """Errors on the later part; twins run through the whole, so that they remember the earlier part."""
    from types import SimpleNamespace

    from lerobot_pneutac.diagnosis.design import predict, read
    from lerobot_pneutac.study.body_base import features

    later = np.arange(len(whole)) >= EARLIER * len(whole)

    def residual(twin) -> np.ndarray:
        data = read(whole, twin)
        return data.measured[:, : data.counted] - predict(twin, data)[0]

    before, after = (residual(m.twin) for m in (d.outcome.before, d.outcome.after))
    signals = features(SimpleNamespace(recording=whole, twin=d.study.twin, start=d.study.start))
    methods = _black_boxes(signals[~later], before[~later], signals[later], before[later], 0)
    return {"before": rms(before[later]), "after": rms(after[later]), "methods": methods}


def _black_boxes(F, target, G, rest, seed: int) -> dict[str, float | None]:
    """Error on the rest of each black box on top of the twin as it is; None where it is not installed."""
    made = {name: method(F, target, G, seed) for name, method in METHODS.items()}
    return {name: None if m is None else rms(rest - m) for name, m in made.items()}
