"""Set `hidden`: recordings of devices built like the twin, with effects in other mathematical forms.

The answer lies in a file of its own that is opened only after the diagnosis.
"""

import json
import tempfile
import time
from dataclasses import asdict
from pathlib import Path

from pneutac_benchmarks.diagnosis.cases import BenchmarkDiagnosisConfig, Case, diagnosed

STRENGTHS = (1.0, 0.5, 0.2)
PAIRS = (
    ("creep", "hysteresis"), ("creep", "gravity"), ("creep", "thermal"), ("stiffening", "creep"),
    ("hysteresis", "gravity"), ("stiffening", "thermal"), ("valve_lag", "creep"), ("leak", "hysteresis"),
    ("dead_time", "gravity"), ("friction", "thermal"),
)  # fmt: skip
NONE = 40


def cases(cfg: BenchmarkDiagnosisConfig) -> list[Case]:
    """All recordings of the set."""
    from pneutac_datasets.generate.hidden.generate import disturbance_names, effect_names

    strengths = STRENGTHS[:1] if cfg.fast else STRENGTHS
    nones = 3 if cfg.fast else NONE
    made = []

    def put(kind, effects, seed, strength=1.0):
        made.append(Case("hidden", kind, effects, seed, cfg.minutes, strength))

    for i in range(cfg.seeds):  # a seed's cases come together, so that a stopped run is a smaller benchmark
        seed = cfg.first_seed + i
        for strength in strengths:
            for effect in effect_names():
                put("effect", effect, seed, strength)
        for effect in disturbance_names():
            put("unknown", effect, seed)
        for pair in PAIRS[: 3 if cfg.fast else 10] if i < 2 else ():
            put("pair", ",".join(pair), seed)
        for k in range(i * nones // cfg.seeds, (i + 1) * nones // cfg.seeds):
            put("none", "none", cfg.first_seed + 100 + k)
    return made


def solve(case: Case) -> dict:
    """Generates one recording, diagnoses it blindly, then looks up the truth."""
    from pneutac_datasets.generate.hidden.generate import generate
    from pneutac_datasets.recording.recording import Recording
    from pneutac_sim.twin import Twin

    with tempfile.TemporaryDirectory() as tmp:
        hidden = Path(tmp) / "recording"
        generate(case.effects.split(","), hidden, case.seed, case.strength, case.minutes)
        recording = Recording.load(hidden)
        twin = Twin(recording.device, recording.length_mm, recording.spine_joint_positions_mm)
        began = time.perf_counter()
        d = diagnosed(twin, recording, case.seed)
        answer = asdict(case) | {
            "verdict": d.verdict,
            "selected": d.selected,
            "rivals": [[r.effect, r.rival] for r in d.outcome.rivals],
            "noise_floor": d.study.noise.value,
            "before": d.before["heldout"],
            "after": d.after["heldout"],
            "reduction": d.reduction[0],
            "error_over_noise": [d.outcome.evidence.before, d.outcome.evidence.after],
            "seconds": time.perf_counter() - began,
        }
        truth = json.loads((Path(tmp) / "truth" / "recording.json").read_text())
    answer["truth"] = {
        "effects": truth["effects"],
        "accepts": [x["accepts"] for x in truth["details"]],
        "misfit": truth["misfit_mm"],
    }
    return answer
