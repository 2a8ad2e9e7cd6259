"""The page of `pneutac control`: the bend that was asked for, and what became of it."""

import plotly.graph_objects as go
from plotly.subplots import make_subplots

from lerobot_pneutac.reports.compare import HELDOUT, MEASURED, MODEL, TRAIN
from lerobot_pneutac.reports.page import Report


def control_page(c) -> Report:
    """The report of a `Control`."""
    report = Report(c.title)
    report.lead(c.sentence)
    report.table(c.rows(), "Root mean square of the bend against what was asked for.")
    figure = make_subplots(2, 1, shared_xaxes=True, row_heights=[0.7, 0.3], vertical_spacing=0.06)
    for name, y, colour in (("asked for", c.target_rad, MEASURED), ("by the twin", c.predicted_rad, MODEL)):
        figure.add_trace(go.Scatter(x=c.time_s, y=y, name=name, line={"color": colour}), 1, 1)
    if c.measured_rad is not None:
        dots = {"size": 4, "color": TRAIN}
        figure.add_trace(
            go.Scatter(x=c.measured_s, y=c.measured_rad, name="measured", mode="markers", marker=dots), 1, 1
        )
    held = {"shape": "hv", "color": HELDOUT}
    figure.add_trace(go.Scatter(x=c.time_s, y=c.pressure_kpa, name="command", line=held), 2, 1)
    figure.update_yaxes(title_text="bend, rad", row=1, col=1)
    figure.update_yaxes(title_text="pressure, kPa", row=2, col=1)
    figure.update_xaxes(title_text="time, s", row=2, col=1)
    report.figure(figure, "Above the bend, below the pressure that was commanded for it.", 520)
    return report
