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

from lerobot_pneutac.cli.options import parse_options
from lerobot_pneutac.diagnosis.engine import cores
from lerobot_pneutac.diagnosis.result import Diagnosis, Tested
from lerobot_pneutac.reports.page import write_result
from lerobot_pneutac.reports.sentences import caveats, lead, next_experiment, percent
from lerobot_pneutac.study.body import diagnose
from lerobot_pneutac.study.pair import load_pair, require
from lerobot_pneutac.verbs import diagnose_gel
from pneutac_sim.errors import InputError
from pneutac_sim.finger.quantities import root_mean, squared_distance

LITTLE_ALONE = 0.03  # share of the avoidable error: an effect that alone removes less looks like nothing


@dataclass
class DiagnoseConfig:
    """Options of `pneutac diagnose`.

    Attributes:
        twin: the twin's folder; it is not changed.
        recording: a bench recording of the same finger, arm or gel.
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
        require(self, "twin", "recording")
        if self.out is not None and self.out.exists() and not self.out.is_dir():
            raise InputError(f"--out={self.out} is a file; give a folder.")
        if self.jobs < 0:
            raise InputError(f"--jobs={self.jobs} must be 0 (all cores) or a positive number.")


def main(argv: list[str]) -> None:
    """Runs the verb."""
    cfg = parse_options(DiagnoseConfig, argv)
    twin, recording = load_pair(cfg.twin, cfg.recording)
    console = Console()
    if recording.device == "gel":
        diagnose_gel.run(twin, recording, cfg, console)
        return
    with progress(console) as (tell, done):
        d = diagnose(twin, recording, cfg.seed, cfg.jobs or cores(), tell, done)
    advice, separation = next_experiment(d)
    show(d, advice, console)
    if cfg.out is not None:
        from lerobot_pneutac.reports.diagnosis import write_page

        write_result(cfg.out, result(d, advice))
        console.print(f"report: {write_page(d, advice, separation, cfg.out)}", highlight=False)


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
        table.add_row(t.name, f"{t.heldout:.3g}", percent(t.reduction, t.ci95), values, found(d, t))
    if d.selected:
        table.add_row("(all found)", f"{d.after_error:.3g}", "", "", "")
    console.print(table)
    for u in d.untested:
        console.print(f"  {u.name}: {u.reason}", highlight=False)
    for sentence in caveats(d):
        console.print(sentence, highlight=False)
    console.print(f"[bold]Next experiment:[/] {advice}", highlight=False)
    console.print(f"verdict: {d.verdict}   ({d.seconds:.0f} s)", highlight=False)


def found(d: Diagnosis, t: Tested) -> str:
    """What the table's last column says; some effects show only once others are there."""
    if t.name not in d.selected:
        return ""
    return "found" if t.reduction > LITTLE_ALONE or len(d.selected) == 1 else "found, with the others"


def result(d: Diagnosis, advice: str) -> dict:
    """The contract of `result.json`."""
    train = d.parts.train

    def errors(residual: np.ndarray) -> dict:
        squared = squared_distance(residual)
        return {"train": root_mean(squared[train]), "heldout": math.sqrt(d.judge.value(squared))}

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
