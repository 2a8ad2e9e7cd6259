"""`pneutac benchmark body --part=shape`: hidden fingers and arms calibrated from photographs.

Photographs at six pressures are fitted; tips, joints and pictures are judged at pressures never seen. Where
an effect was hidden in the body, the twin is judged as it is, then with the effect added from the markers.
The answer lies in a file of its own that is opened only after the twin was made.

    benchmark_shape(BenchmarkBodyConfig(part="shape", out="outputs/benchmark_body"))
"""

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from lerobot_pneutac.verbs.fit_photographs import calibrate_photographs
from pneutac_benchmarks.body.options import BenchmarkBodyConfig
from pneutac_benchmarks.body.shape_case import (
    HIDDEN,
    TRAIN_KPA,
    BodyCase,
    add_effect,
    at_rest,
    first_twin,
    heldout,
    photographed,
    take_photographs,
)
from pneutac_benchmarks.body.shape_table import write_tables
from pneutac_sim.errors import InputError
from pneutac_sim.files import read_made, write_json
from pneutac_sim.finger import Pipeline
from pneutac_sim.mpm.solid import parameter
from pneutac_sim.twin import Twin, Value


def cases(cfg: BenchmarkBodyConfig) -> list[BodyCase]:
    """All bodies of the benchmark."""
    first, options = cfg.first_seed, (cfg.evaluations, cfg.particles)
    made = [BodyCase("finger", first + i, "", *options) for i in range(cfg.fingers)]
    made += [BodyCase("arm", first + i, "", *options) for i in range(cfg.arms)]
    effects = list(HIDDEN)[: 1 if cfg.fast else None]
    return made + [BodyCase("finger", first + i, e, *options) for i in range(cfg.hidden) for e in effects]


def benchmark_shape(cfg: BenchmarkBodyConfig) -> dict:
    """Calibrates every body whose result is not in `cfg.out` yet, then writes the tables.

    Returns:
        What `result.json` holds: `bodies`, one a body, and the tables `shape`, `parameters`, `effects`.
    """
    out, console = cfg.out / "shape", Console()
    everything = cases(cfg)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        whole = bar.add_task("bodies", total=len(everything))
        search = bar.add_task("evaluations", total=cfg.evaluations)
        for case in everything:
            bar.update(whole, description=f"{case.device} {case.seed} {case.hidden}")
            bar.reset(search, total=cfg.evaluations)
            file = out / "bodies" / f"{case.key}.json"
            if not file.is_file():
                answer = solve(case, out, cfg.device, lambda done: bar.update(search, completed=done))
                write_json(file, answer)
            bar.advance(whole)
    bodies = [read_made(out / "bodies" / f"{c.key}.json") for c in everything]
    return write_tables(bodies, out, console)


def solve(case: BodyCase, out: Path, device: str = "auto", progress=lambda done: None) -> dict:
    """Photographs a hidden body, calibrates a twin to it, adds the effect, then looks up the truth.

    Args:
        case: which body.
        out: folder of recordings and of searches that were stopped.
        device: of the material points.
        progress: called with the evaluations so far.

    Returns:
        `before` and `after` (None where nothing was hidden): `tip_mm` of each held-out sample and mean
        `joints_deg`; `heldout` pictures; `parameters` and `effect` beside their truth. Where photographs were
        refused as not of such a body, `refused` says why instead.
    """
    recording = take_photographs(case, out / "recordings")
    file = out / "bodies" / f"{case.key}.search"
    answer = asdict(case) | {"length_mm": recording.length_mm}
    try:
        found = calibrate_photographs(
            first_twin(recording),
            photographed(recording),
            TRAIN_KPA,
            evaluations=case.evaluations,
            particles=case.particles,
            file=file,
            device=device,
            progress=lambda text, done, total: progress(done),
        )
    except InputError as e:
        return answer | {"refused": str(e)}
    calibrated = found.to_dict()
    rows, after = heldout(recording), None
    made = {"before": at_rest(found.twin, recording, rows, case.particles, device)}
    if case.hidden:
        after = add_effect(found.twin, recording, HIDDEN[case.hidden].add)
        made["after"] = at_rest(after, recording, rows, case.particles, device)
    truth = json.loads((out / "recordings" / "truth" / f"{case.recording}.json").read_text())
    q, tips = np.array(truth["joints_rad"])[rows], np.array(truth["tips_mm"])[rows]
    answer |= {
        "seconds": found.seconds,
        "heldout": {"iou": calibrated["iou"]["heldout"], "rmse": calibrated["error"]["heldout"]},
        "parameters": against_truth(calibrated, found.twin, truth["parameters"]),
        "before": None,
        "after": None,
    }
    for name, (joints, there) in made.items():
        answer[name] = {
            "tip_mm": np.linalg.norm(there - tips, axis=1).tolist(),
            "joints_deg": float(np.degrees(np.abs(joints - q).mean())),
        }
    effect = HIDDEN[case.hidden].add if case.hidden else ""
    if effect:
        hidden = truth["disturbances"]["effects"].get(effect, {})
        fitted = {k: v.value for k, v in after.effects[effect].items()}
        answer["effect"] = {"name": effect, "fitted": fitted, "truth": hidden}
    file.unlink(missing_ok=True)
    return answer


def against_truth(calibrated: dict, twin: Twin, truth: dict[str, float]) -> dict[str, dict]:
    """Each calibrated parameter beside its truth.

    Args:
        calibrated: what the calibration reports.
        twin: that it made.
        truth: parameters of the hidden device; what is not among them has the model's default.
    """
    hidden = Twin(
        twin.device, twin.length_mm, twin.spine_joint_positions_mm, {k: Value(v) for k, v in truth.items()}
    )
    pipeline = Pipeline.of(hidden)
    known = dict(zip(pipeline.names, pipeline.theta(hidden).tolist(), strict=True))
    rows = {}
    for name, p in calibrated["parameters"].items():
        true = known[name] if name in known else parameter(hidden, name)
        low, high = p["ci95"]
        rows[name] = {
            "value": p["value"],
            "truth": true,
            "unit": p["unit"],
            "ci95": [low, high],
            "identified": name not in calibrated["not_identified"],
            "covered": bool(low <= true <= high),
        }
    return rows
