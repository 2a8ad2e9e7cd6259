"""The pages of `pneutac design`: a program, and what each candidate model predicts of it; motions."""

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from lerobot_pneutac.reports.colours import CHAMBERS
from lerobot_pneutac.reports.page import Report
from lerobot_pneutac.reports.sentences import called


def design_page(design) -> Report:
    """The report of a `Design`."""
    report, best = Report(design.title), design.best
    report.lead(design.sentence)
    figure = make_subplots(2, 1, shared_xaxes=True, row_heights=[0.7, 0.3], vertical_spacing=0.06)
    # Of the predicted columns the one in which the models differ most.
    spread = np.std(np.stack(best.predictions), axis=0).max(axis=0)
    for c, seen in zip(design.contenders, best.predictions, strict=True):
        name = f"{100 * c.probability:.0f} %: {' + '.join(map(called, c.terms)) or 'no effect'}"
        figure.add_trace(go.Scatter(x=best.time_s, y=seen[:, spread.argmax()], name=name[:60]), 1, 1)
    for trace in pressure_traces(best.time_s, best.pressure_kpa):
        figure.add_trace(trace, 2, 1)
    figure.update_yaxes(title_text=f"predicted, {design.unit}", row=1, col=1)
    figure.update_yaxes(title_text="pressure, kPa", row=2, col=1)
    figure.update_xaxes(title_text="time, s", row=2, col=1)
    report.figure(
        figure, "What each model predicts, with its probability before the program, and the program.", 520
    )
    report.table(design.rows(), "The programs with the most information for their time.")
    return report


def motion_page(design) -> Report:
    """The report of a `MotionDesign`."""
    report = Report(design.title)
    report.lead(design.sentence)
    for c in dict.fromkeys(design.chosen.values()):
        drags = c.motion.drag_mm > 0
        figure = go.Figure()
        for name, felt in c.felt.items():
            x, y = (felt.way_mm, felt.turn_deg) if drags else (felt.time_s, felt.force_n)
            figure.add_trace(go.Scatter(x=x, y=y, name=name))
        figure.update_xaxes(title_text="sideways path of the arm, mm" if drags else "time, s")
        figure.update_yaxes(title_text="turn of the imprint, degrees" if drags else "force on the gel, N")
        report.figure(figure, f"{c.motion.name}: the twin as it is, and with one thing changed.".capitalize())
    report.table(design.rows(), "Standard deviations with which each motion would show a change.")
    for remark in design.remarks():
        report.text(remark)
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
