"""Calibrates a finger or an arm to marker or angle data: all parameters by bounded least squares.

Where the pressure was measured, pneumatic effects are fitted to it and the body is driven by it, so that a
slow valve cannot pass for a creeping body; else everything is fitted to the pose at once.
"""

import time
from dataclasses import dataclass

import numpy as np
from rich.console import Console
from rich.table import Table

from lerobot_pneutac.reports.page import Report, write_result
from lerobot_pneutac.study.pair import enough_rows
from pneutac_datasets.recording.checks import check
from pneutac_datasets.recording.mounts import on_one_mount
from pneutac_sim.errors import InputError
from pneutac_sim.finger import BodyData, Pipeline, PipelineFit, fit, simulate
from pneutac_sim.twin import Twin


@dataclass(frozen=True)
class BodyFit:
    """A calibrated body.

    Attributes:
        twin: the next version, not yet written.
        fits: one fit a stage: of the measured pressure, if any, then of the pose.
        bench: the recording as the body fit sees it, driven by the measured pressure where there is one.
        train: (n,) mask.
        before: held-out error of the twin as it was, from the command; None where nothing was held out.
        error: `train` and `heldout` error of the new one, from the command.
        said: where sessions were brought onto one mount, a sentence that tells so.
        seconds: wall time.
    """

    twin: Twin
    fits: list[PipelineFit]
    bench: BodyData
    train: np.ndarray
    before: float | None
    error: dict[str, float | None]
    said: list[str]
    seconds: float


def fit_body(twin: Twin, recording, seed: int = 0) -> BodyFit:
    """Fits all parameters of the twin and of its effects to 70 % of a recording, by whole blocks of time.

    Args:
        twin: of the recording's device; where the fit starts.
        recording: a bench recording, checked for faults.
        seed: decides which blocks are held out, and the starting points.

    Raises:
        InputError: the recording has images alone, or too few samples.
    """
    began = time.perf_counter()
    if not [c for c in recording.observations if not c.startswith("image")]:
        raise InputError(
            f"{recording.folder}: no column tip_x_mm, bend_angle_rad, curvature_x_1_per_m or q_1_rad tells "
            "what the device did; add one of them."
        )
    train, heldout = recording.split(seed)
    enough_rows(twin, recording, list(twin.effects), train)
    recording, said = on_one_mount(recording, twin, train)
    bench = BodyData.of(recording, twin)
    command = BodyData.of(recording, twin, source="command")
    start, before = twin, simulate(twin, bench)
    fits = []
    air = [name for name in twin.effects if name in before.left_out and bench.inputs.measured]
    air = [name for name in air if "measured pressure" in before.left_out[name]]
    if air:
        fits.append(fit(twin, BodyData.of(recording, twin, target="pressure"), None, train, air, seed=seed))
        twin = fits[0].twin
    fits.append(fit(twin, bench, train=train, seed=seed))
    after = fits[-1].twin

    def error(model: Twin, mask: np.ndarray) -> float | None:
        return command.error(simulate(model, command).residual, mask) if mask.any() else None

    return BodyFit(
        twin=after,
        fits=fits,
        bench=bench,
        train=train,
        before=error(start, heldout),
        error={"train": error(after, train), "heldout": error(after, heldout)},
        said=said,
        seconds=time.perf_counter() - began,
    )


def calibrate_body(twin: Twin, recording, cfg, console: Console) -> dict:
    """Fits, saves the twin's next version, prints the table, writes result and report.

    Args:
        twin: of the recording's device.
        recording: of a finger or an arm.
        cfg: `CalibrateConfig`.
        console: where the table goes.

    Returns:
        The content of `result.json`.
    """
    clean, said = check(recording)
    for sentence in said[len(recording.warnings) :]:
        console.print(f"[yellow]note:[/] {sentence}", highlight=False)
    with console.status("fitting"):
        found = fit_body(twin, clean, cfg.seed)
    for sentence in found.said:
        console.print(f"[yellow]note:[/] {sentence}", highlight=False)
    unit = found.bench.unit
    errors = {**found.error, "unit": unit, "seed": cfg.seed}
    found.twin.save_version(cfg.twin, "calibrated", str(recording.folder), errors)
    rows = parameter_rows(found)
    result = {
        "parameters": {r["parameter"]: {k: r[k] for k in ("value", "ci95", "unit", "note")} for r in rows},
        "error": found.error,
        "before": {"heldout": found.before},
        "unit": unit,
        "evaluations": sum(f.evaluations for f in found.fits),
        "seconds": found.seconds,
        "recording": str(recording.folder),
        "twin": str(cfg.twin),
        "version": found.twin.history[-1]["version"],
    }
    _print(rows, found, result, console)
    if cfg.out is not None:
        write_result(cfg.out, result)
        console.print(f"report: {_report(rows, found, result).write(cfg.out)}", highlight=False)
    return result


def parameter_rows(found: BodyFit) -> list[dict]:
    """One row a parameter: value, 95 % interval where it was fitted, unit, and what to know about it."""
    model = Pipeline.of(found.twin)
    theta = model.theta(found.twin, found.bench.inputs.pressure_range_kpa)
    rows = []
    for name, spec, value in zip(model.names, model.specs, theta, strict=True):
        row = {"parameter": name, "value": float(value), "ci95": None, "unit": spec.unit, "note": "held"}
        for f in found.fits:
            if name in f.ci95:
                row |= {"ci95": list(f.ci95[name]), "note": ""}
            if name in f.at_bound:
                row["note"] = f"stopped at its {f.at_bound[name]} bound: a look at the physics is due"
            if name in f.not_identified:
                row["note"] = f"not identified: {f.not_identified[name]}"
        rows.append(row)
    return rows


def _print(rows: list[dict], found: BodyFit, result: dict, console: Console) -> None:
    table = Table("parameter", "value", "95 % interval", "unit", "note")
    for r in rows:
        interval = f"{r['ci95'][0]:.4g} to {r['ci95'][1]:.4g}" if r["ci95"] else ""
        style = "yellow" if r["note"] not in ("", "held") else None
        table.add_row(r["parameter"], f"{r['value']:.4g}", interval, r["unit"], r["note"], style=style)
    console.print(table)
    e = found.error
    held = "nothing was held out" if e["heldout"] is None else (
        f"held-out {e['heldout']:.3g} {result['unit']} (before: {found.before:.3g})"
    )  # fmt: skip
    console.print(
        f"error: train {e['train']:.3g} {result['unit']}, {held}; {result['evaluations']} simulations in "
        f"{found.seconds:.1f} s; the twin at {result['twin']} is now version {result['version']}",
        highlight=False,
    )


def _report(rows: list[dict], found: BodyFit, result: dict) -> Report:
    import plotly.graph_objects as go

    bench, unit = found.bench, result["unit"]
    page = Report(f"Calibrated {found.twin.device}")
    held = found.error["heldout"]
    page.lead(
        f"After calibration the twin misses the measurements by {found.error['train']:.3g} {unit} where it "
        "was fitted" + ("." if held is None else f", and by {held:.3g} {unit} where it was not.")
    )
    page.table(
        [
            {
                "parameter": r["parameter"],
                "value": r["value"],
                "95 % interval": "" if r["ci95"] is None else f"{r['ci95'][0]:.4g} to {r['ci95'][1]:.4g}",
                "unit": r["unit"],
                "note": r["note"],
            }
            for r in rows
        ],
        "Intervals count neighbouring samples as the few independent ones that they are worth.",
    )
    t = bench.inputs.columns["session_time_s"][bench.inputs.rows]
    step = max(1, len(t) // 4000)
    for i, column in enumerate(bench.columns[: bench.counted]):
        figure = go.Figure()
        measured, residual = bench.measured[:, i], found.fits[-1].residual[:, i]
        for name, y, colour in (("measured", measured, "#9aa5b1"), ("twin", measured - residual, "#0b6e99")):
            figure.add_scattergl(x=t[::step], y=y[::step], name=name, mode="lines", line={"color": colour})
        y = np.where(found.train, np.nan, residual)
        figure.add_scattergl(x=t[::step], y=y[::step], name="held-out residual", line={"color": "#c2410c"})
        page.figure(figure.update_xaxes(title="time (s)").update_yaxes(title=column))
    return page
