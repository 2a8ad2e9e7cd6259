"""A picture of one cause: measured, model without it and with it, as a step response, a loop or by level."""

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from lerobot_pneutac.diagnosis.experiment import read
from lerobot_pneutac.diagnosis.result import Outcome
from lerobot_pneutac.reports.colours import AFTER, BEFORE, MEASURED
from lerobot_pneutac.study.base import EffectStudy
from pneutac_datasets.recording.axes import axes, unit_of
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.laws import family
from pneutac_sim.effects.registry import get_effect

SLOW = ("creep", "valve_lag", "ringing", "leak", "tracker")  # families that a step response shows
LEVELS = {"payload": "payload_g", "gravity": "gravity", "thermal": "temperature_c"}
STEP = 0.15  # of the range of pressures: a smaller change is no step
HOLD_S, LONGEST_S = 1.0, 60.0  # of a hold after a step: the shortest that counts, the longest shown
FEWEST = 3  # steps
BINS = 24
MEANT = {"measured": MEASURED, "without": BEFORE, "with": AFTER}


def physics(study: EffectStudy, o: Outcome) -> tuple[go.Figure, str] | None:
    """The largest cause that is no known one, else the largest: figure and caption; None where none shows."""
    order = [c.name for c in sorted(o.contributions, key=lambda c: -c.drop[0])] or list(o.selected)
    order = [e for e in order if e in o.after.effects]
    if not order or not isinstance(study.recording, Recording) or study.recording.device == "gel":
        return None
    effect = next((e for e in order if e not in o.known), order[0])
    data = read(study.recording, o.after.twin)
    without, left = study.residual(o.after.twin.without(effect)), o.after.residual
    k = int(np.argmax(np.var(without - left, axis=0)))  # where the cause shows most
    measured = data.measured[:, k]
    lines = {"measured": measured, "without": measured - without[:, k], "with": measured - left[:, k]}
    slow = family(effect) in SLOW or get_effect(effect).stage == "pneumatics"
    column, name = data.columns[k], study.cause(o.after, effect)
    ways = [_by_level, _loop] if family(effect) in LEVELS else [_steps, _loop] if slow else [_loop]
    for way in ways:
        found = way(study.recording, lines, column, effect)
        if found is not None:
            figure, caption = found
            return figure, f"The largest {'cause' if effect in o.known else 'new cause'}, {name}. {caption}"
    return None


def _panels(x: np.ndarray, lines: dict[str, np.ndarray], x_title: str, y_title: str) -> go.Figure:
    """Left the three lines, right measured and model with the cause, both minus the model without it."""
    figure = make_subplots(
        1, 2, horizontal_spacing=0.1, subplot_titles=("response", "minus the model without it")
    )
    for name, y in lines.items():
        label = name if name == "measured" else f"model {name} it"
        style = {"color": MEANT[name], "width": 2, "dash": "solid" if name != "without" else "dash"}
        for col, shown in ((1, y), (2, y - lines["without"])):
            figure.add_scatter(
                x=np.round(x, 3), y=np.round(shown, 5), name=label, legendgroup=name, showlegend=col == 1,
                mode="lines", line=style, row=1, col=col,
            )  # fmt: skip
    figure.update_xaxes(title_text=x_title)
    figure.update_yaxes(title_text=y_title, row=1, col=1)
    return figure


def _steps(recording: Recording, lines, column: str, effect: str) -> tuple[go.Figure, str] | None:
    """Mean response to the steps of one direction, per kPa."""
    p = recording.samples[list(recording.pressure_columns)].to_numpy(float).mean(1)
    span, found = float(np.ptp(p)), []
    for rows in recording.trials().values():
        t, q = recording.column("time_s")[rows], p[rows]
        at = np.flatnonzero(np.abs(np.diff(q)) > STEP * span) + 1
        for i in at:
            moved = np.flatnonzero(np.abs(q[i:] - q[i]) > 0.01 * span)
            end = i + (moved[0] if len(moved) else len(q) - i)
            if i >= 2 and t[end - 1] - t[i] >= HOLD_S:
                found.append((rows.start + i, rows.start + end, q[i] - q[i - 1], t[end - 1] - t[i]))
    held = {way: [f for f in found if np.sign(f[2]) == way] for way in (1, -1)}
    steps = max(held.values(), key=lambda fs: sum(f[3] for f in fs))
    if len(steps) < FEWEST:
        return None
    holds = sorted(f[3] for f in steps)
    longest = min(holds[-FEWEST] if family(effect) == "creep" else float(np.median(holds)), LONGEST_S)
    steps = [f for f in steps if f[3] >= longest]
    x = np.linspace(0.0, longest, 160)
    time = recording.column("time_s")

    def response(y: np.ndarray) -> np.ndarray:
        each = [(time[a:b] - time[a], (y[a:b] - y[a - 2 : a].mean()) / dp) for a, b, dp, _ in steps]
        return np.mean([np.interp(x, t, r) for t, r in each], axis=0)

    mean = {name: response(y) for name, y in lines.items()}
    way = "up" if steps[0][2] > 0 else "down"
    unit = unit_of(column)
    figure = _panels(x, mean, "time after the step (s)", f"{_title(column)} ({unit}/kPa)")
    return figure, f"Mean response to {len(steps)} steps {way}, per kPa of the step."


def _loop(recording: Recording, lines, column: str, effect: str) -> tuple[go.Figure, str] | None:
    """Mean over the pressure, on the way up and on the way down."""
    p = recording.samples[list(recording.pressure_columns)].to_numpy(float).mean(1)
    way = next((a for a in axes(recording) if a.name == "direction"), None)
    if way is None or "loading" not in way.labels or "unloading" not in way.labels:
        return None
    edges = np.linspace(p.min(), p.max() + 1e-9, BINS + 1)
    place, x, parts = np.digitize(p, edges) - 1, [], {name: [] for name in lines}
    for label, order in (("loading", range(BINS)), ("unloading", range(BINS - 1, -1, -1))):
        for b in order:
            at = (place == b) & (way.bin == way.labels.index(label))
            if at.sum() >= FEWEST:
                x.append(p[at].mean())
                for name, y in lines.items():
                    parts[name].append(y[at].mean())
    if len(x) < BINS // 2:
        return None
    mean = {name: np.array(v) for name, v in parts.items()}
    figure = _panels(np.array(x), mean, "commanded pressure (kPa)", f"{_title(column)} ({unit_of(column)})")
    return figure, "Mean over the pressure, while it rises and while it falls."


def _by_level(recording: Recording, lines, column: str, effect: str) -> tuple[go.Figure, str] | None:
    """What the model without the cause misses at each level of its condition."""
    axis = next((a for a in axes(recording) if a.name == LEVELS[family(effect)]), None)
    if axis is None or len(axis.labels) < 2:
        return None
    figure, levels = go.Figure(), range(len(axis.labels))
    for name, colour, label in (("measured", MEASURED, "measured"), ("with", AFTER, "model with it")):
        apart = lines[name] - lines["without"]
        y = [float(np.sqrt((apart[axis.bin == i] ** 2).mean())) for i in levels]
        figure.add_bar(x=axis.labels, y=np.round(y, 4), name=label, marker_color=colour)
    figure.update_xaxes(type="category", title_text=_title(axis.name))
    figure.update_yaxes(title_text=f"{_title(column)} ({unit_of(column)})")
    return figure, "Root mean square difference from the model without it, at each level that was recorded."


def _title(name: str) -> str:
    return name.rpartition("_")[0].replace("_", " ") if unit_of(name) else name.replace("_", " ")
