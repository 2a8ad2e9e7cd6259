"""The page of a twin against demonstrations: recorded touch and the twin's, curves, a film, errors."""

import numpy as np

from lerobot_pneutac.reports.page import COMMAND, MEASURED, MODEL, OTHER, Report, side_by_side
from pneutac_sim.features import AREA, CONTROL_HZ, PRESSURE

WIDTH = 180  # of a picture of the gel, px
GAIN = 3  # by which a change is shown larger
SHOWN = 3  # episodes with curves
EVERY = 2  # frames of an episode that are shown in the film


def demonstrations_page(c) -> Report:
    page = c.lead_page()
    for remark in c.remarks():
        page.text(remark.replace("[yellow]", "").replace("[/]", ""))
    worst = c.worst[0]["trial"]
    e = c.demonstrations.episodes[worst]
    frames = film_frames(c, worst)
    caption = (
        f"Episode {worst}: the gel as recorded, as replayed, and their difference, {GAIN} times as large."
    )
    page.image(frames[int(np.argmax(e.state[:, AREA]))], caption, 3 * WIDTH)
    page.film(
        frames[::EVERY], EVERY / CONTROL_HZ, f"The same as a film, {len(e) / CONTROL_HZ:.0f} s.", 3 * WIDTH
    )
    page.heading("Pressure, contact area and path")
    for row in c.worst[:SHOWN]:
        page.figure(
            _curves(c, row["trial"]), f"Episode {row['trial']}: recorded, and replayed by the twin.", 520
        )
    page.heading("Errors")
    for axis, rows in c.by.items():
        page.table([{axis: r.pop("bin"), **r} for r in map(dict, rows)])
    page.text(
        f"Error in {c.unit}: root mean square over frames; errors of gauge and touch are converted to the "
        "bend that would cause them. Area is the share of the image that is in contact."
    )
    return page


def film_frames(c, number: int) -> list[np.ndarray]:
    """Of an episode: the gel as recorded and as replayed side by side, uint8 (H, W, 3) each."""
    recorded, replayed = c.demonstrations.episodes[number].images, c.replayed[number].images
    assert replayed is not None
    return [beside(a, b) for a, b in zip(recorded, replayed, strict=True)]


def beside(recorded: np.ndarray, replayed: np.ndarray) -> np.ndarray:
    """Two images of the gel and their difference, `GAIN` times as large, side by side: uint8 (H, W, 3)."""
    apart = np.clip(128 + GAIN * (recorded.astype(int) - replayed), 0, 255).astype(np.uint8)
    return side_by_side((recorded, replayed, apart), width=WIDTH, gap=0)


def _curves(c, number: int):
    from plotly.subplots import make_subplots

    e, r = c.demonstrations.episodes[number], c.replayed[number]
    t = np.arange(len(e)) / CONTROL_HZ
    figure = make_subplots(rows=3, cols=1, shared_xaxes=True, vertical_spacing=0.05)
    ends = c.study.fitter.ends
    off = np.linalg.norm(c.residual[ends[number] : ends[number + 1], :3], axis=1)
    lines = (
        (1, "commanded", t, e.action[:, 3], COMMAND),
        (1, "recorded", t, e.state[:, PRESSURE], MEASURED),
        (1, "replayed", t, r.pressure_kpa, MODEL),
        (2, "recorded", t, 100 * e.state[:, AREA], MEASURED),
        (2, "replayed", t, 100 * r.area, MODEL),
        (3, "arm off its commands", t, off, OTHER),
    )
    for row, name, x, y, colour in lines:
        figure.add_scatter(x=x, y=y, name=name, line_color=colour, showlegend=row != 2, row=row, col=1)
    for row, title in ((1, "pressure (kPa)"), (2, "contact area (%)"), (3, "arm (mm)")):
        figure.update_yaxes(title=title, row=row, col=1)
    return figure.update_xaxes(title="s", row=3, col=1)
