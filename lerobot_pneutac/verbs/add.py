"""`pneutac add`: switches an effect on in a twin, re-fits everything, shows the error before and after."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from lerobot_pneutac.cli.options import parse_options
from lerobot_pneutac.diagnosis import pneumatics
from lerobot_pneutac.diagnosis.bootstrap import Resampler
from lerobot_pneutac.diagnosis.candidates import sort_candidates
from lerobot_pneutac.diagnosis.parts import Parts, deal
from lerobot_pneutac.diagnosis.refit import Refit, refit
from lerobot_pneutac.reports.page import Report, write_result
from lerobot_pneutac.reports.sentences import percent
from lerobot_pneutac.study.pair import enough_rows, load_pair, require
from lerobot_pneutac.verbs import add_gel
from lerobot_pneutac.verbs.diagnose import progress
from pneutac_datasets.recording.checks import check
from pneutac_datasets.recording.mounts import on_one_mount
from pneutac_datasets.recording.noise import NoiseFloor, noise_floor
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.errors import InputError
from pneutac_sim.finger.quantities import root_mean, squared_distance
from pneutac_sim.twin import Twin


@dataclass
class AddConfig:
    """Options of `pneutac add`.

    Attributes:
        twin: the twin's folder; its next version is written there if the error falls.
        recording: a bench recording of the same finger, arm or gel.
        effect: name of the effect to switch on.
        out: folder for `result.json` and `report.html`.
        seed: decides which blocks of time are held out, and the bootstrap.
    """

    twin: Path | None = None
    recording: Path | None = None
    effect: str = ""
    out: Path | None = None
    seed: int = 0

    def __post_init__(self):
        require(self, "twin", "recording")
        if not self.effect:
            raise InputError(
                "Give the effect with --effect=NAME; `pneutac diagnose` tells which one is missing."
            )
        if self.out is not None and self.out.exists() and not self.out.is_dir():
            raise InputError(f"--out={self.out} is a file; give a folder.")


@dataclass
class Added:
    """What switching an effect on did.

    Attributes:
        effect: its name.
        before: the twin without it, re-fitted.
        after: the twin with it, re-fitted.
        parts: training and held-out samples.
        noise: noise floor.
        fall: of the held-out mean square error: value, lower 1 % and upper 99 % bound.
        reduction: share of the avoidable error removed, and its 95 % interval.
        judge: resamples the held-out blocks.
        said: what the data check found, one sentence each.
    """

    effect: str
    before: Refit
    after: Refit
    parts: Parts
    noise: NoiseFloor
    fall: tuple[float, float, float]
    reduction: tuple[float, tuple[float, float]]
    judge: Resampler
    said: list[str]

    @property
    def falls(self) -> bool:
        """Whether the held-out error falls for sure."""
        return self.fall[1] > 0

    def errors(self, residual: np.ndarray) -> dict:
        """Training and held-out error, and the interval of the latter."""
        squared = squared_distance(residual)
        lo, hi = np.sqrt(np.quantile(self.judge.mse(squared), [0.025, 0.975]))
        return {
            "train": root_mean(squared[self.parts.train]),
            "heldout": math.sqrt(self.judge.value(squared)),
            "heldout_ci95": [float(lo), float(hi)],
        }


def main(argv: list[str]) -> None:
    """Runs the verb."""
    cfg = parse_options(AddConfig, argv)
    get_effect(cfg.effect)
    twin, recording = load_pair(cfg.twin, cfg.recording, "add to")
    console = Console()
    if recording.device == "gel":
        add_gel.run(twin, recording, cfg, console)
        return
    with progress(console) as (tell, done):
        tell(f"fitting with and without {cfg.effect}", 2)
        added = add(twin, recording, cfg.effect, cfg.seed, done)
    for sentence in added.said:
        console.print(f"[yellow]note:[/] {sentence}", highlight=False)
    before, after = added.errors(added.before.residual), added.errors(added.after.residual)
    _show(added, before, after, console)
    unit = added.noise.unit
    if not added.falls:
        raise InputError(
            f"Nothing was written: with {cfg.effect} the held-out error goes from {before['heldout']:.4g} to "
            f"{after['heldout']:.4g} {unit}, and the change of its square, {-added.fall[0]:+.3g} "
            f"[{-added.fall[2]:+.3g} to {-added.fall[1]:+.3g}] {unit}^2, is no sure fall; "
            "`pneutac diagnose` tells what is missing."
        )
    added.after.twin.save_version(
        cfg.twin,
        f"added {cfg.effect}",
        str(cfg.recording),
        {"train": after["train"], "heldout": after["heldout"], "unit": unit, "seed": cfg.seed},
    )
    result = {
        "effect": cfg.effect,
        "unit": unit,
        "noise_floor": added.noise.value,
        "before": before,
        "after": after,
        "reduction": added.reduction[0],
        "reduction_ci95": list(added.reduction[1]),
        "parameters": parameters(added.after.twin, cfg.effect),
        "at_bound": sorted(added.after.at_bound),
        "not_identified": added.after.not_identified,
        "checks": added.said,
        "twin": str(cfg.twin),
        "version": len(added.after.twin.history) - 1,
    }
    console.print(f"wrote version {result['version']} of {cfg.twin}", highlight=False)
    if cfg.out is not None:
        write_result(cfg.out, result)
        console.print(f"report: {_page(added, result).write(cfg.out)}", highlight=False)


def add(twin: Twin, recording: Recording, effect: str, seed: int = 0, done=lambda: None) -> Added:
    """Fits the twin with and without an effect and compares them on held-out blocks.

    Raises:
        InputError: the effect is on already, is unknown, or the recording lacks the column that it needs.
    """
    get_effect(effect)
    if effect in twin.effects:
        raise InputError(
            f"The twin has the effect '{effect}' already (it has {', '.join(twin.effects)}); "
            "`pneutac calibrate` re-fits it."
        )
    recording, said = check(recording)
    for u in sort_candidates(recording, twin)[1]:
        if u.name == effect:
            raise InputError(f"{recording.folder}: effect '{effect}' {u.reason}.")
    parts = deal(recording, seed, choose=False)
    enough_rows(twin, recording, [*twin.effects, effect], parts.train)
    recording, moved = on_one_mount(recording, twin, parts.train)
    noise = noise_floor(recording)
    before = refit(twin, recording, list(twin.effects), parts, done)
    start = before.twin if not pneumatics.is_pneumatic(effect) else twin
    after = refit(start, recording, [*twin.effects, effect], parts, done)
    judge = Resampler(parts.heldout, parts.unit, parts.stratum, seed)
    b, a = (before.residual**2).sum(1), (after.residual**2).sum(1)
    reduction = judge.reduction(b, a, noise.value)
    return Added(effect, before, after, parts, noise, judge.drop(b, a), reduction, judge, said + moved)


def parameters(twin: Twin, effect: str) -> dict:
    """Value, interval and unit of an effect's parameters."""
    units = {p.name: p.unit for p in get_effect(effect).parameters}
    return {
        k: {"value": v.value, "ci95": list(v.ci95) if v.ci95 else None, "unit": units.get(k, "")}
        for k, v in twin.effects[effect].items()
    }


def _show(added: Added, before: dict, after: dict, console: Console) -> None:
    table = Table(title=f"error, {added.noise.unit} (noise {added.noise.value:.3g})")
    for head in ("", "train", "held-out", "95 % interval"):
        table.add_column(head)
    for name, e in (("before", before), (f"with {added.effect}", after)):
        lo, hi = e["heldout_ci95"]
        table.add_row(name, f"{e['train']:.4g}", f"{e['heldout']:.4g}", f"{lo:.4g} to {hi:.4g}")
    console.print(table)
    if added.falls:
        console.print(_physics(added), highlight=False)
        console.print(
            f"{added.effect} removes {percent(*added.reduction)} of what could be avoided", highlight=False
        )
    if added.after.at_bound:
        console.print(f"[yellow]at a bound:[/] {', '.join(added.after.at_bound)}", highlight=False)


def _physics(added: Added) -> str:
    """What the effect does to this device, with the fitted numbers."""
    twin = added.after.twin
    values = {k: v.value for k, v in twin.effects[added.effect].items()}
    return get_effect(added.effect).describe(values, twin.device)


def _page(added: Added, result: dict) -> Report:
    import plotly.graph_objects as go

    unit = added.noise.unit
    page = Report(f"Added {added.effect}")
    page.lead(
        f"{_physics(added)} With {added.effect} the held-out error fell from "
        f"{result['before']['heldout']:.3g} to {result['after']['heldout']:.3g} {unit}: "
        f"{percent(*added.reduction)} of what could be avoided."
    )
    figure = go.Figure()
    for name, e, colour in (("before", result["before"], "#9aa5b1"), ("after", result["after"], "#0b6e99")):
        a, b = e["heldout_ci95"]
        error = {"type": "data", "array": [b - e["heldout"]], "arrayminus": [e["heldout"] - a]}
        figure.add_bar(x=[name], y=[e["heldout"]], error_y=error, marker_color=colour, showlegend=False)
    figure.add_hline(y=added.noise.value, line_dash="dash", annotation_text="noise")
    page.figure(figure.update_yaxes(title=f"held-out error ({unit})", rangemode="tozero"))
    page.table(
        [
            {
                "parameter": k,
                "value": v["value"],
                "95 % interval": "{:.4g} to {:.4g}".format(*v["ci95"]) if v["ci95"] else "held",
                "unit": v["unit"] or "(a ratio)",
            }
            for k, v in result["parameters"].items()
        ],
        "Fitted to the training blocks.",
    )
    if added.said:
        page.heading("What the data check found")
        page.text("\n\n".join(added.said))
    return page
