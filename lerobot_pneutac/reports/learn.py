"""The pages of `pneutac learn`, how well each next program was predicted, and of `pneutac design`."""

import numpy as np
import pandas as pd
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from lerobot_pneutac.reports.figures import curves, stacked
from lerobot_pneutac.reports.page import CHAMBERS, HELDOUT, MEASURED, MODEL, TRAIN, Report
from lerobot_pneutac.reports.sentences import called
from pneutac_sim.effects.laws import plain_name


def design_page(design) -> Report:
    report, best = design.lead_page(), design.best
    figure = stacked((f"predicted, {design.unit}", "pressure, kPa"), (0.7, 0.3))
    # Of the predicted columns the one in which the models differ most.
    spread = np.std(np.stack(best.predictions), axis=0).max(axis=0)
    for c, seen in zip(design.contenders, best.predictions, strict=True):
        name = f"{100 * c.probability:.0f} %: {' + '.join(map(called, c.terms)) or 'no effect'}"
        figure.add_scatter(x=best.time_s, y=seen[:, spread.argmax()], name=name[:60], row=1, col=1)
    for trace in pressure_traces(best.time_s, best.pressure_kpa):
        figure.add_trace(trace, 2, 1)
    what = "What each model predicts, with its probability before the program, and the program."
    report.figure(figure, what, 520)
    report.table(design.rows(), "The programs with the most information for their time.")
    return report


def add_motions(report: Report, design) -> Report:
    """Responses to the chosen motions of a `MotionDesign`."""
    for c in dict.fromkeys(design.chosen.values()):
        titles, x, y = ("time, s", "force on the gel, N"), "time_s", "force_n"
        if c.motion.drag_mm > 0:
            titles = ("sideways path of the arm, mm", "turn of the imprint, degrees")
            x, y = "sideways_mm", "turn_deg"
        lines = (
            (name, getattr(response, x), getattr(response, y), None) for name, response in c.responses.items()
        )
        figure = curves(lines, *titles)
        report.figure(figure, f"{c.motion.name}: the twin as it is, and with one thing changed.".capitalize())
    return report


def pressure_traces(time_s: np.ndarray, pressure_kpa: np.ndarray) -> list[go.Scatter]:
    """What is commanded (n, chambers), one line a chamber, each narrower, so that equal ones are seen."""
    several = pressure_kpa.shape[1] > 1
    widths = 2.0 + 2.5 * np.arange(pressure_kpa.shape[1])[::-1]
    return [
        go.Scatter(
            x=time_s, y=kpa, name=f"chamber {i + 1}", showlegend=several,
            line={"shape": "hv", "color": colour, "width": width},
        )
        for i, (kpa, colour, width) in enumerate(zip(pressure_kpa.T, CHAMBERS, widths, strict=False))
    ]  # fmt: skip


PREDICTED = "predicted.csv"  # in a round's folder: its program as predicted and as measured


def learn_page(learning) -> Report:
    report = learning.lead_page()
    report.figure(
        _predicted_ahead(learning),
        "Error on each program before it was used for anything, by the best model until then and by the "
        "twin as it was given, re-fitted, and the error of what was found after it, where no fit saw.",
    )
    report.table(learning.rows(), "* confirmed by a program of another kind that was predicted with it.")
    report.figure(_programs(learning), "What was commanded.", 120 + 90 * len(learning.rounds))
    report.figure(_likely(learning), "How likely each model was after each round, by its last effects.")
    report.heading("What was found, round by round")
    for r in learning.rounds:
        report.text(f"**Round {r.number}, {r.program}.** {r.sentence}")
        file = learning.folder / f"round_{r.number}" / PREDICTED
        if file.is_file():
            report.figure(_as_measured(pd.read_csv(file)), "As predicted before it was measured.", 260)
    return report


def _as_measured(table: pd.DataFrame) -> go.Figure:
    """Prediction and measurement of the column that moves most."""
    names = [c.removesuffix(" measured") for c in table if c.endswith(" measured")]
    name = max(names, key=lambda n: np.ptp(table[f"{n} measured"]))
    kinds = (("predicted", MODEL), ("measured", MEASURED))
    lines = ((kind, table["time_s"], table[f"{name} {kind}"], colour) for kind, colour in kinds)
    return curves(lines, "time, s", name)


def _predicted_ahead(learning) -> go.Figure:
    rounds = learning.rounds
    at = [r.number for r in rounds]
    lines = (
        ("predicted", at, [r.predicted_error for r in rounds], {"color": MODEL}),
        ("as given", at, [r.bare_error for r in rounds], {"color": HELDOUT}),
        ("after", at, [r.error for r in rounds], {"color": TRAIN, "dash": "dot"}),
        ("noise", at, [r.noise for r in rounds], {"color": MEASURED, "dash": "dash"}),
    )
    figure = curves(lines, "round", f"error, {rounds[-1].unit}", mode="lines+markers")
    figure.update_xaxes(dtick=1).update_yaxes(rangemode="tozero")
    return figure


def _programs(learning) -> go.Figure:
    rounds = learning.rounds
    figure = make_subplots(len(rounds), 1, vertical_spacing=0.25 / max(len(rounds), 2))
    for i, r in enumerate(rounds):
        table = pd.read_csv(learning.folder / f"round_{r.number}" / "program.csv")
        commands = table[[c for c in table if c.startswith("pressure_cmd_")]].to_numpy(float)
        for trace in pressure_traces(table["time_s"], commands):
            trace.update(legendgroup=trace.name, showlegend=trace.showlegend and not i)
            figure.add_trace(trace, i + 1, 1)
        figure.update_yaxes(title_text=f"{r.number}, kPa", row=i + 1, col=1)
    figure.update_xaxes(title_text="time, s", row=len(rounds), col=1)
    return figure


def _likely(learning) -> go.Figure:
    figure = go.Figure()
    for r in learning.rounds:
        for name, p in sorted(r.probabilities.items(), key=lambda item: -item[1]):
            label = " + ".join(map(plain_name, name.split(" + "))) or "no effect"
            text = {"name": label, "hovertext": label, "text": label.split(" + ")[-1]}
            figure.add_bar(x=[r.number], y=[p], showlegend=False, **text)
    figure.update_layout(barmode="stack")
    figure.update_xaxes(title_text="round", dtick=1)
    figure.update_yaxes(title_text="probability")
    return figure
