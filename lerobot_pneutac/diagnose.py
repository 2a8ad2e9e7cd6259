"""`pneutac diagnose`: which physical effect a twin lacks, with rivals, intervals and the next experiment."""

import math
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table

from lerobot_pneutac.diagnosis.engine import cores
from lerobot_pneutac.diagnosis.result import Diagnosis
from lerobot_pneutac.diagnosis.sentences import caveats, lead, next_experiment
from lerobot_pneutac.diagnosis.study import diagnose
from lerobot_pneutac.options import parse_options
from lerobot_pneutac.report import write_result
from pneutac_datasets.recording import BenchRecording
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin


@dataclass
class DiagnoseConfig:
    """Options of `pneutac diagnose`.

    Attributes:
        twin: the twin's folder; it is not changed.
        recording: a bench recording of the same finger or arm.
        out: folder for `result.json` and `report.html`.
        jobs: processes; 0 for all cores.
        seed: decides which blocks of time are held out, and every bootstrap.
    """

    twin: Path | None = None
    recording: Path | None = None
    out: Path | None = None
    jobs: int = 0
    seed: int = 0

    def __post_init__(self):
        for name in ("twin", "recording"):
            if getattr(self, name) is None:
                raise InputError(f"Give the {name}'s folder with --{name}=DIR.")
        if self.out is not None and self.out.exists() and not self.out.is_dir():
            raise InputError(f"--out={self.out} is a file; give a folder.")
        if self.jobs < 0:
            raise InputError(f"--jobs={self.jobs} must be 0 (all cores) or a positive number.")


def main(argv: list[str]) -> None:
    """Runs the verb."""
    cfg = parse_options(DiagnoseConfig, argv)
    twin, recording = load_pair(cfg.twin, cfg.recording)
    console = Console()
    with progress(console) as (tell, done):
        d = diagnose(twin, recording, cfg.seed, cfg.jobs or cores(), tell, done)
    advice, separation = next_experiment(d)
    show(d, advice, console)
    if cfg.out is not None:
        from lerobot_pneutac.diagnosis.page import write_page

        write_result(cfg.out, result(d, advice))
        console.print(f"report: {write_page(d, advice, separation, cfg.out)}", highlight=False)


def load_pair(twin_path: Path, recording_path: Path) -> tuple[Twin, BenchRecording]:
    """The twin and a recording that may be diagnosed; raises InputError where they do not fit together."""
    twin, recording = Twin.load(twin_path), BenchRecording.load(recording_path)
    if recording.device == "gel":
        raise InputError(
            f"{recording_path} is of a gel; effects are sought in recordings of a finger or an arm."
        )
    if recording.device != twin.device:
        raise InputError(
            f"{recording_path} is of a {recording.device} and {twin_path} of a {twin.device}; "
            "diagnose a twin with a recording of its own device."
        )
    if recording.length_mm is not None and abs(recording.length_mm - twin.length_mm) > 0.02 * twin.length_mm:
        raise InputError(
            f"{recording_path}/recording.json: length_mm is {recording.length_mm:g}, the twin's is "
            f"{twin.length_mm:g}; make the twin with `pneutac new --twin=DIR --recording={recording_path}`."
        )
    return twin, recording


class progress:  # noqa: N801
    """A bar that grows as more fits become necessary; gives `tell(text, fits)` and `done()`."""

    def __init__(self, console: Console):
        self._bar = Progress(
            TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
            TimeRemainingColumn(), console=console, transient=True,
        )  # fmt: skip

    def __enter__(self):
        self._bar.start()
        self._task, self._total = self._bar.add_task("starting", total=1), 0

        def tell(text: str, fits: int) -> None:
            self._total += fits
            self._bar.update(self._task, description=text[:48], total=self._total)

        return tell, lambda: self._bar.advance(self._task)

    def __exit__(self, *_) -> None:
        self._bar.stop()


def show(d: Diagnosis, advice: str, console: Console) -> None:
    """The short table on the terminal."""
    for sentence in d.findings:
        console.print(f"[yellow]note:[/] {sentence}", highlight=False)
    console.print(f"\n[bold]{lead(d)}[/]\n", highlight=False)
    table = Table(title=f"held-out error, {d.noise.unit} (noise {d.noise.value:.3g})")
    for head in ("effect", "error alone", "avoidable error removed", "parameters", ""):
        table.add_column(head)
    table.add_row("(as it is)", f"{d.before_error:.3g}", "", "", "")
    chosen = [t for t in d.tested if t.name in d.selected]
    rest = [t for t in d.tested if t.name not in d.selected][: max(2, 6 - len(chosen))]
    for t in chosen + rest:
        values = ", ".join(f"{k} {v['value']:.3g}" for k, v in list(t.parameters.items())[:3])
        share = f"{100 * t.reduction:.0f} % [{100 * t.ci95[0]:.0f} to {100 * t.ci95[1]:.0f}]"
        table.add_row(t.name, f"{t.heldout:.3g}", share, values, "found" if t.name in d.selected else "")
    if d.selected:
        table.add_row("(all found)", f"{d.after_error:.3g}", "", "", "")
    console.print(table)
    for u in d.untested:
        console.print(f"  {u.name}: {u.reason}", highlight=False)
    for sentence in caveats(d):
        console.print(sentence, highlight=False)
    console.print(f"[bold]Next experiment:[/] {advice}", highlight=False)
    console.print(f"verdict: {d.verdict}   ({d.seconds:.0f} s)", highlight=False)


def result(d: Diagnosis, advice: str) -> dict:
    """The contract of `result.json`."""
    train = d.parts.train

    def errors(residual: np.ndarray) -> dict:
        squared = (residual**2).sum(1)
        return {"train": math.sqrt(squared[train].mean()), "heldout": math.sqrt(d.judge.value(squared))}

    share, interval = d.removed
    return {
        "verdict": d.verdict,
        "sentence": lead(d),
        "unit": d.noise.unit,
        "noise_floor": d.noise.value,
        "noise_floor_how": d.noise.how,
        "baseline": errors(d.before),
        "selected": d.selected,
        "after": errors(d.after),
        "reduction": share,
        "reduction_ci95": list(interval),
        "parameters": {
            name: {k: {"value": v.value, "ci95": v.ci95} for k, v in d.twin.effects[name].items()}
            for name in d.selected
        },
        "ladder": [{"change": label, **errors(r)} for label, r in d.ladder],
        "effects": [
            {
                "name": t.name, "heldout": t.heldout, "reduction": t.reduction,
                "reduction_ci95": list(t.ci95), "parameters": t.parameters, "tested_by": t.tested_by,
            }
            for t in d.tested
        ]
        + [
            {
                "name": u.name, "heldout": None, "reduction": None, "reduction_ci95": None, "parameters": {},
                "tested_by": u.reason,
            }
            for u in d.untested
        ],
        "indistinguishable": [[r.effect, r.rival] for r in d.rivals],
        "correlated": [{"effects": [a, b], "correlation": c} for a, b, c in d.correlated],
        "profile": [
            {
                "parameter": p.name, "value": p.value, "unit": p.unit, "interval95": list(p.interval),
                "bounded_below": p.below, "bounded_above": p.above, "remark": p.remark,
                "points": [{"value": v, "chi2": c} for v, c in p.points],
            }
            for p in d.profiles
        ],
        "at_bound": d.evidence.at_bound,
        "error_over_noise": {k: getattr(d.evidence, k) for k in ("before", "after", "limit")},
        "measured_pressure": d.measured_pressure,
        "findings": d.findings,
        "notes": caveats(d),
        "fingerprints": [
            {"effect": f.effect, "share": f.share, "chance": f.chance, "p_value": f.p_value} for f in d.prints
        ],
        "next_experiment": advice,
        "seconds": d.seconds,
        "time": time.strftime("%Y-%m-%d %H:%M"),
    }  # fmt: skip
