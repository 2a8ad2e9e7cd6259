"""The page of `pneutac design`: the program, and what each model in the running predicts of it."""

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from lerobot_pneutac.reports.compare import HELDOUT
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
    held = {"shape": "hv", "color": HELDOUT}
    figure.add_trace(go.Scatter(x=best.time_s, y=best.pressure_kpa, line=held, showlegend=False), 2, 1)
    figure.update_yaxes(title_text=f"predicted, {design.unit}", row=1, col=1)
    figure.update_yaxes(title_text="pressure, kPa", row=2, col=1)
    figure.update_xaxes(title_text="time, s", row=2, col=1)
    report.figure(
        figure, "What each model predicts, with its probability before the program, and the program.", 520
    )
    report.table(design.rows(), "The programs that tell most for their time.")
    return report
