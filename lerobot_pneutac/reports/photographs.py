"""The report of a calibration by images: photographs beside renderings, and how the objective fell."""

from collections.abc import Iterator

import numpy as np
import plotly.graph_objects as go

from lerobot_pneutac.rendering.silhouettes import strip
from lerobot_pneutac.reports.colours import AFTER, OTHER
from lerobot_pneutac.reports.page import Report


def photo_page(c) -> Report:
    """The report of a `PhotoCalibration`."""
    page = Report(c.title)
    page.lead(c.sentence)
    page.table(
        c.rows(),
        "Intervals tell how sharply the silhouettes fix each parameter. A body whose shape or neutral "
        "axis is not the twin's shifts all of them together, by more than that.",
    )
    page.heading("Photographs and renderings")
    page.text(
        "Above the photograph, below the twin; then red where only the photograph, blue where only the twin."
    )
    for pictures, caption in _strips(c):
        page.image(pictures, caption)
    page.heading("How the objective fell")
    tried, best = c.search.objectives, {"color": AFTER}
    figure = go.Figure()
    figure.add_scatter(y=tried, mode="markers", name="candidates", marker={"color": OTHER})
    figure.add_scatter(y=np.minimum.accumulate(tried), mode="lines", name="best", line=best)
    page.figure(figure.update_xaxes(title="evaluation").update_yaxes(title="L1 + 2 (1 - IoU)", type="log"))
    return page


def _strips(c) -> Iterator[tuple[np.ndarray, str]]:
    """Pictures of six photographs each, with what they show."""
    study = c.study
    shown = sorted(study.photographs, key=lambda p: p.state)
    for i in range(0, len(shown), 6):
        some = shown[i : i + 6]
        if len({p.mask.shape for p in some}) > 1:
            continue
        labels = [
            f"{'/'.join(f'{v:g}' for v in study.pressures[p.state])} kPa"
            f"{'' if study.train[p.state] else ' (held out)'}"
            for p in some
        ]
        yield strip(c.objective, c.bodies.positions[0], some), ", ".join(labels)
