"""The page of `pneutac compare`: measured against model, loops, residuals by condition, maps, history.

`c` is a `BodyComparison` throughout.
"""

import numpy as np
import plotly.graph_objects as go

from lerobot_pneutac.reports import page as C
from lerobot_pneutac.reports.figures import bar_panels, curves, name_runs, session_clock, shade, stacked
from lerobot_pneutac.reports.page import Report
from pneutac_datasets.recording.axes import unit_of

POINTS = 1500  # a line: more cannot be seen on a screen
GAP = np.array([np.nan])  # between the parts of a line
EACH, ALL = 60, 30_000  # of a trial at least, but where the least of all trials together is more than that


def comparison_page(c) -> Report:
    report = c.lead_page()
    unit = c.unit
    fitted = c.train_samples.any()
    parts = (("test", "heldout"), ("training", "train")) if fitted else ()
    rows = [{"part": part, f"error, {unit}": c.error[key]} for part, key in (*parts, ("all rows", "all"))]
    rows.append({"part": "noise", f"error, {unit}": c.noise.value if c.noise.value else "unknown"})
    caption = f"Root mean square distance, simulated {c.simulated}. Noise: {c.noise.how}."
    caption += " The test part is made of whole blocks of time." if fitted else ""
    caption += f" Inside the 95 % band: {c.inside_band}." if c.coverage is not None else ""
    report.table(rows, caption)
    if c.out_of_range is not None:
        share = f"{100 * c.out_of_range:.2g}%"
        report.table([{"range of the action network": "samples outside it", "share": share}])
    report.found(c.findings)
    report.heading("Over time")
    caption = "Measured and modelled; the worst passages are shaded."
    if c.coverage is not None:
        caption += f" In green the 95 % band{' of the test part' if fitted else ''}."
    report.figure(over_time(c), caption, 130 + 150 * c.counted)
    report.heading("Loops")
    report.figure(loops(c), "The same against the commanded pressure: a loop shows history.", 420)
    if len(c.history) > 1:
        report.heading("The twin's history")
        known = [e for e in c.history if e["unit"] == unit]
        entries = [e for e in known if e["heldout"] is not None or e["train"] is not None]
        figure = history_figure(entries, unit)
        if c.noise_floor:
            dashed = {"color": C.FLOOR, "dash": "dash"}
            figure.add_hline(y=c.noise_floor, line=dashed, annotation_text="noise")
        report.figure(figure, "Errors as each version recorded them, on its own recording.", 340)
    report.heading("Where it fails")
    shown = {n: r for n, r in c.by.items() if len(r) > 1}
    caption = "Error under each condition; the line is the noise floor."
    report.figure(by_condition(shown, c), caption, 60 + 260 * ((len(shown) + 1) // 2))
    report.figure(residuals(c), "Residual of each sample (a sample of them), measured minus model.", 420)
    report.heading("Worst passages")
    report.table(c.worst)
    return report


def _thin(index: np.ndarray, value: np.ndarray, count: int = POINTS) -> np.ndarray:
    """About `count` of the indices (n,): first, lowest and highest of each stretch, so that peaks stay."""
    if len(index) <= count:
        return index
    keep = []
    for part in np.array_split(np.arange(len(index)), count // 3):
        keep += [part[0], part[np.argmin(value[part])], part[np.argmax(value[part])]]
    return index[np.unique(keep)]


def _thinned(parts: list[np.ndarray], value: np.ndarray) -> list[np.ndarray]:
    """Parts (n,) of the rows of `value`, each thinned to its share of the points."""
    least = max(3, min(EACH, ALL // max(len(parts), 1)))
    return [_thin(p, value[p], max(least, POINTS * len(p) // len(value))) for p in parts]


def _line(parts: list[np.ndarray], digits: int) -> np.ndarray:
    """Parts of a line with gaps between them."""
    pieces = [piece for part in parts for piece in (part, GAP)] or [GAP]
    return np.concatenate(pieces).round(digits)


def _heldout(c) -> list[np.ndarray]:
    out = []
    for rows in c.recording.trials().values():
        index = np.arange(rows.start, rows.stop)
        parts = np.split(index, np.flatnonzero(np.diff(c.train_samples[rows])) + 1)
        out += [part for part in parts if not c.train_samples[part[0]]]
    return out


def _both(c) -> tuple:
    return (c.measured, C.MEASURED, "measured"), (c.model, C.MODEL, "model")


def over_time(c) -> go.Figure:
    titles = [*map(_title, c.columns[: c.counted]), "kPa"]
    figure = stacked(titles, [1.0] * c.counted + [0.6], 0.03)
    t, shift = session_clock(c.recording)
    trials = [np.arange(rows.start, rows.stop) for rows in c.recording.trials().values()]
    for i in range(c.counted if c.band is not None else 0):  # a closed shape for each stretch of test rows
        centre, place = c.model[:, i], {"legendgroup": "band", "showlegend": i == 0, "row": i + 1, "col": 1}
        low, high = centre - c.band.half[:, i], centre + c.band.half[:, i]
        parts, name = _thinned(_heldout(c), centre), "95 % band" + ", test" * bool(c.train_samples.any())
        x = _line([np.append(t[p], t[p[::-1]]) for p in parts], 3)
        y = _line([np.append(high[p], low[p[::-1]]) for p in parts], 4)
        look = {"mode": "lines", "fill": "toself", "fillcolor": C.BAND, "line": {"width": 0}}
        figure.add_scatter(x=x, y=y, name=name, hoverinfo="skip", **look, **place)
    for i in range(c.counted):
        for values, colour, name in _both(c):
            parts = _thinned(trials, values[:, i])
            x, y = _line([t[p] for p in parts], 3), _line([values[p, i] for p in parts], 4)
            look = {"mode": "lines", "line": {"color": colour, "width": 1.2}, "legendgroup": name}
            figure.add_scatter(x=x, y=y, name=name, showlegend=i == 0, **look, row=i + 1, col=1)
    command = c.recording.commands
    for k, name in enumerate(c.recording.pressure_columns):
        index = _thin(np.arange(len(t)), command[:, k])
        figure.add_scatter(
            x=t[index].round(3), y=command[index, k].round(3), name=name, mode="lines",
            line={"width": 1, "color": ((C.COMMAND, *C.CHAMBERS) * 3)[k]}, row=c.counted + 1, col=1,
        )  # fmt: skip
    shade(figure, c.worst, shift)
    return name_runs(figure, c.recording, row=c.counted + 1)


def _main_column(c) -> int:
    return int(np.argmax(np.var(c.measured[:, : c.counted], axis=0)))


def loops(c) -> go.Figure:
    """The main column against the first chamber's command (or the one that varies most)."""
    i = _main_column(c)
    columns = c.recording.pressure_columns
    k = int(np.argmax([np.var(c.recording.column(n)) for n in columns]))
    p = c.recording.column(columns[k])
    figure = go.Figure()
    for trial, rows in list(c.recording.trials().items())[:12]:
        index = np.arange(rows.start, rows.stop)
        index = index[:: max(1, len(index) // 1200)]
        for values, colour, label in _both(c):
            figure.add_scatter(
                x=p[index].round(3), y=values[index, i].round(4), name=label, legendgroup=label,
                showlegend=rows.start == 0, mode="lines", line={"color": colour, "width": 1}, opacity=0.7,
                hovertemplate=f"trial {trial}: %{{y}} at %{{x}} kPa",
            )  # fmt: skip
    figure.update_layout(xaxis_title=_title(columns[k]), yaxis_title=_title(c.columns[i]))
    return figure


def by_condition(by: dict[str, list[dict]], c) -> go.Figure:
    kinds = (("error", C.TRAIN, "all"), ("heldout", C.HELDOUT, "test"))[: 1 + c.train_samples.any()]
    panels = {
        _title(axis): [([b["value"] for b in bins], [b[k] for b in bins], *kind) for k, *kind in kinds]
        for axis, bins in by.items()
    }
    return bar_panels(panels, c.noise.value)


def residuals(c) -> go.Figure:
    i = _main_column(c)
    rng = np.random.default_rng(0)
    some = np.sort(rng.choice(len(c.measured), min(3000, len(c.measured)), replace=False))
    y = (c.measured - c.model)[some, i]
    choices = [(a.name, a.value) for a in c.axes if a.value is not None and np.ptp(a.value) > 0]
    choices.append(("session time, s", session_clock(c.recording)[0]))
    colours = np.where(c.train_samples[some], C.TRAIN, C.HELDOUT).tolist()
    figure, buttons = go.Figure(), []
    dots = {"mode": "markers", "marker": {"size": 3, "color": colours, "opacity": 0.6}, "showlegend": False}
    for k, (name, value) in enumerate(choices):
        figure.add_scattergl(x=value[some].round(4), y=y.round(4), visible=k == 0, **dots)
        shown = {"visible": [k == j for j in range(len(choices))]}, {"xaxis.title.text": _title(name)}
        buttons.append({"label": name, "method": "update", "args": list(shown)})
    menu = {"buttons": buttons, "x": 0, "xanchor": "left", "y": 1.15, "yanchor": "top"}
    titles = {"xaxis_title": _title(choices[0][0]), "yaxis_title": f"residual of {_title(c.columns[i])}"}
    return figure.update_layout(**titles, updatemenus=[menu])


def history_figure(entries: list[dict], unit: str) -> go.Figure:
    x = [f"{e['version']}: {e['change']}" for e in entries]
    style = {"width": 2.5, "shape": "hv"}
    kinds = (("training", "train", C.TRAIN), ("test", "heldout", C.HELDOUT))
    lines = [(n, x, [e[k] for e in entries], style | {"color": colour}) for n, k, colour in kinds]
    figure = curves(lines, "", unit, mode="lines+markers", marker={"size": 9})
    return figure.update_yaxes(rangemode="tozero")


def _title(name: str) -> str:
    unit = unit_of(name)
    return f"{name.rpartition('_')[0].replace('_', ' ')}, {unit}" if unit else name.replace("_", " ")
