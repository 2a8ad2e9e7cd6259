"""Set `lab`: the whole loop on fingers with turned, loaded and warm runs, as a lab would do it.

Each finger is a rod of `pneutac_truths` with its weight, weights hung on its tip and one missing effect. The
twin is calibrated and diagnosed on day 1, what was found is added, and day 2 judges. Then effects that the
finger does not have are added by name to the corrected twin; each must be refused.
"""

import tempfile
import time
from dataclasses import asdict
from pathlib import Path

from pneutac_benchmarks.diagnosis.cases import BenchmarkDiagnosisConfig, Case, diagnosed
from pneutac_benchmarks.diagnosis.rules import COUNTS, counts
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin
from pneutac_truths import generate, write

MISSING = (
    "creep_fractional", "standard_solid", "hysteresis_preisach", "friction_maxwell", "fill_orifice",
    "valve_slew", "leak", "temperature_drift", "mullins", "unfolding",
)  # fmt: skip
ALWAYS = ("gravity", "payload")
TRIED = (
    "creep", "hysteresis", "friction", "leak", "thermal", "valve_lag", "gain_saturation", "cyclic_softening",
    "dead_time", "orifice_flow", "stiffening",
)  # fmt: skip
MOST_TRIED = 8


def cases(cfg: BenchmarkDiagnosisConfig) -> list[Case]:
    """Each missing effect with each seed: the loop on both days in turn."""
    for name in cfg.effects:
        if name not in MISSING:
            raise InputError(f"--effects: '{name}' must be one of {', '.join(MISSING)}.")
    seeds = range(cfg.first_seed, cfg.first_seed + cfg.seeds)
    names = cfg.effects or MISSING
    return [
        Case("lab", kind, name, seed, cfg.minutes, device="rod")
        for kind in ("loop", "friday") for seed in seeds for name in names
    ]  # fmt: skip


def solve(case: Case) -> dict:
    """The loop of one finger; of `friday` only what the other day's diagnosis names."""
    from lerobot_pneutac import add, calibrate, compare

    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as tmp:
        days = []
        for day in (1, 2):
            truth = generate("rod", [case.effects, *ALWAYS], case.seed, day, minutes=case.minutes, lab=True)
            days.append(Recording.load(write(truth, Path(tmp) / f"day{day}")))
        learn, judge = days if case.kind == "loop" else days[::-1]
        calibrated = calibrate(Twin("finger", learn.length_mm or 110.0), learn)
        d = diagnosed(calibrated.twin, learn, 0)
        out = asdict(case) | {
            "verdict": d.verdict, "selected": d.selected, "floor": truth.noise_floor,
            "known": sorted({*d.outcome.known, *calibrated.twin.effects}), "test": d.after["heldout"],
            "calibrated": calibrated.error["heldout"], "objections": d.outcome.evidence.objections,
        }  # fmt: skip
        if case.kind == "loop":
            added = add(calibrated.twin, learn, d) if d.selected else None
            twin = added.twin if added is not None and added.accepted else calibrated.twin
            out |= {
                "accepted": added is not None and added.accepted,
                "reason": "" if added is None else added.reason,
                "same_error": added is None or added.after["heldout"] == d.after["heldout"],
                "before": compare(calibrated.twin, judge).heldout,
                "after": compare(twin, judge).heldout,
                "tried": {x: _tried(twin, learn, x) for x in _absent(case.effects, twin)},
            }
    return out | {"seconds": time.perf_counter() - began}


def _absent(truth: str, twin: Twin) -> list[str]:
    """Effects that neither the finger nor the twin has."""
    own = [n for t in (truth, *ALWAYS) for n in COUNTS[t]]
    return [x for x in TRIED if not counts(x, own) and x not in twin.effects][:MOST_TRIED]


def _tried(twin: Twin, recording: Recording, effect: str) -> dict:
    from lerobot_pneutac import add

    result = add(twin, recording, effect)
    errors = [e and e["heldout"] for e in (result.baseline, result.after)]
    return {"accepted": result.accepted, "reason": result.reason, "errors": errors}
