"""Figures of all pages, and what they show: one session clock, names of runs, the worst passages."""

from collections.abc import Iterable, Sequence

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from lerobot_pneutac.reports.page import CHAMBERS, FLOOR, SHADE, WHISKER

PASSAGE_S = 2.0
PASSAGES = 5
SEPARATION_S = 10.0  # between the starts of two: the next-worst place says more than the same one again
GAP_S = 1.0  # shown between two runs
MOST_NAMES = 16  # more would overlap


def session_clock(recording) -> tuple[np.ndarray, dict]:
    """Time with the runs laid end to end (n,), s, and by how much each run's own time is shifted."""
    t, at, shift = np.zeros(len(recording)), 0.0, {}
    for trial, rows in recording.trials().items():
        own = recording.column("time_s")[rows]
        t[rows] = own - own[0] + at
        shift[trial] = at - own[0]
        at = t[rows][-1] + GAP_S
    return t, shift


def name_runs(figure: go.Figure, recording, row: int | None = None) -> go.Figure:
    """Marks where each run starts on the axis of time, with its program's name, else its number."""
    t, _ = session_clock(recording)
    runs, named = list(recording.trials().items()), "program" in recording.samples
    at, texts = [], []
    for trial, rows in runs[:: -(-len(runs) // MOST_NAMES)]:
        at.append(float(t[rows.start]))
        name = str(recording.column("program")[rows.start]) if named else f"run {trial}"
        texts.append(f"{name}, {at[-1]:.0f} s")
    place = {} if row is None else {"row": row, "col": 1}
    ticks = {"tickmode": "array", "tickvals": at, "ticktext": texts, "tickangle": -35, "showgrid": True}
    return figure.update_xaxes(**ticks, title_text="run and time of the session", **place)


def curves(lines: Iterable[tuple], x_title: str, y_title: str, **each) -> go.Figure:
    """A figure of lines, each a name, x, y and a colour or a whole style; `each` is said of every line."""
    figure = go.Figure()
    for name, x, y, style in lines:
        line = style if isinstance(style, dict) else {"color": style}
        figure.add_scatter(x=x, y=y, name=name, line=line, **{"mode": "lines"} | each)
    return figure.update_layout(xaxis_title=x_title, yaxis_title=y_title)


def stacked(
    titles: Sequence[str], heights: Sequence[float], spacing: float = 0.06, lines: Iterable[tuple] = ()
) -> go.Figure:
    """Panels over one time, one below the other, with titles of their y axes and heights.

    Lines are each the number of a panel, a name, x, y and a whole style.
    """
    figure = make_subplots(
        len(titles), 1, shared_xaxes=True, row_heights=list(heights), vertical_spacing=spacing
    )
    for row, title in enumerate(titles, 1):
        figure.update_yaxes(title_text=title, row=row, col=1)
    for row, name, x, y, style in lines:
        figure.add_scatter(x=x, y=y, name=name, line=style, row=row, col=1)
    return figure.update_xaxes(title_text="time, s", row=len(titles), col=1)


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


def whiskers(values: Sequence[float], low: Sequence[float], high: Sequence[float]) -> dict:
    """Bars of the intervals from `low` to `high` about values."""
    above = [max(0.0, b - x) for x, b in zip(values, high, strict=True)]
    below = [max(0.0, x - a) for x, a in zip(values, low, strict=True)]
    return {"type": "data", "color": WHISKER, "array": above, "arrayminus": below}


def shade(figure: go.Figure, passages: list[dict], shift: dict) -> None:
    """Shades passages of trials, which `session_clock` has shifted."""
    for p in passages:
        a, b = (p[end] + shift[p["trial"]] for end in ("from_s", "to_s"))
        figure.add_vrect(x0=a, x1=b, fillcolor=SHADE, line_width=0, layer="below")


def bar_panels(panels: dict[str, list[tuple]], noise: float | None) -> go.Figure:
    """Groups of bars, two panels a row: of each panel its title, and x, y, colour and name of each group."""
    rows = max(1, (len(panels) + 1) // 2)
    spaces = {"vertical_spacing": 0.34 / rows, "horizontal_spacing": 0.09}
    figure = make_subplots(rows, 2, subplot_titles=list(panels), **spaces)
    for k, groups in enumerate(panels.values()):
        at = {"row": k // 2 + 1, "col": k % 2 + 1}
        for x, y, colour, name in groups:
            look = {"marker_color": colour, "legendgroup": name, "showlegend": k == 0}
            figure.add_bar(x=x, y=y, name=name, **look, **at)
        if noise:
            figure.add_hline(y=noise, line={"color": FLOOR, "dash": "dash", "width": 1.5}, **at)
        figure.update_xaxes(type="category", tickfont={"size": 10}, **at)
    return figure


def worst_passages(recording, squared: np.ndarray) -> list[dict]:
    """The passages of about `PASSAGE_S` with the largest error, at least two samples each, separated in time.

    Each has `trial`, `from_s`, `to_s`, `error` and, if known, `program`; `squared` are the errors (n,).
    """
    found = []
    for trial, rows in recording.trials().items():
        t, e = recording.column("time_s")[rows], squared[rows]
        begin, sums = np.arange(len(t)), np.r_[0.0, np.cumsum(e)]
        end = np.maximum(np.searchsorted(t, t + PASSAGE_S, side="right"), np.minimum(begin + 2, len(t)))
        mean = (sums[end] - sums[:-1]) / (end - begin)
        free = t <= max(t[0], t[-1] - PASSAGE_S)  # a passage is whole, or the whole of a short run
        for _ in range(PASSAGES):
            if not free.any():
                break
            a = int(np.argmax(np.where(free, mean, -1.0)))
            free[np.abs(t - t[a]) < SEPARATION_S] = False
            passage = {"trial": trial, "from_s": float(t[a]), "to_s": float(t[end[a] - 1])}
            passage["error"] = float(np.sqrt(mean[a]))
            if "program" in recording.samples:
                passage["program"] = str(recording.column("program")[rows][a])
            found.append(passage)
    return sorted(found, key=lambda p: -p["error"])[:PASSAGES]
