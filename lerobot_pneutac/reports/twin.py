"""The page of `pneutac report`: a twin, its history and its numbers."""

import plotly.graph_objects as go

from lerobot_pneutac.reports.compare import HELDOUT, TRAIN
from lerobot_pneutac.reports.page import Report


def twin_page(r) -> Report:
    """The report of a `TwinReport`."""
    page = Report(r.title)
    page.lead(r.sentence)
    if r.twin.history:
        page.heading("How it became so")
        for unit in dict.fromkeys(e["unit"] for e in r.rows() if e["unit"]):
            entries = [e for e in r.rows() if e["unit"] == unit]
            if len(entries) > 1:
                page.figure(history(entries, unit), "Errors as each version recorded them.", 340)
        page.table(r.rows())
    if r.twin.effects:
        page.heading("What its effects do")
        page.text("\n\n".join(r.described()))
    page.heading("Its numbers")
    page.table(r.parameters(), "Units are in the names; where no interval stands, none was fitted.")
    if "rest_image" in r.twin.arrays:
        page.heading("Its touch sensor without contact")
        page.image(r.twin.arrays["rest_image"], width=240)
    return page


def history(entries: list[dict], unit: str) -> go.Figure:
    """Train and held-out error of the versions judged in one unit."""
    x = [f"{e['version']}: {e['change']}" for e in entries]
    figure = go.Figure()
    for key, colour, name in (("train", TRAIN, "train"), ("heldout", HELDOUT, "held out")):
        figure.add_scatter(
            x=x, y=[e[key] for e in entries], name=name, mode="lines+markers",
            line={"color": colour, "width": 2.5, "shape": "hv"}, marker={"size": 9},
        )  # fmt: skip
    return figure.update_yaxes(rangemode="tozero", title_text=unit)
