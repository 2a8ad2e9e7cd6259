"""The report of a diagnosis: the headline first, then the evidence as pictures."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from lerobot_pneutac.diagnosis.design import Separation, read
from lerobot_pneutac.diagnosis.result import Outcome
from lerobot_pneutac.diagnosis.verdict import called, family_in
from lerobot_pneutac.reports import figures as F
from lerobot_pneutac.reports import page as C
from lerobot_pneutac.reports.page import Report, parameter_rows, rows_of
from lerobot_pneutac.reports.sentences import State, alternatives, evidence, hedged, meaning, percent
from lerobot_pneutac.study.base import EffectStudy
from pneutac_datasets.recording.axes import Axis, axes, numbers, unit_of
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.laws import family
from pneutac_sim.effects.registry import get_effect

SLOW = ("creep", "valve_lag", "ringing", "leak", "tracker")  # families that a step response shows
LEVELS = {"payload": "payload_g", "gravity": "gravity", "thermal": "temperature_c"}
STEP = 0.15  # of the range of pressures: a smaller change is no step
HOLD_S, LONGEST_S = 1.0, 60.0  # of a hold after a step: the shortest that counts, the longest shown
FEWEST = 3  # steps
BINS = 24
MEANT = {"measured": C.MEASURED, "without": C.BEFORE, "with": C.AFTER}
MOST_POINTS = 4000
Step = tuple[str, float, Sequence[float] | None, str]  # what changed, test error, its interval, colour
CONDITIONS = ("gravity", "payload_g", "temperature_c")  # shown first


def diagnosis_page(d, separation: Separation | None) -> Report:
    """The report of a `Diagnosis`, and of the experiment that separates two rivals, if any."""
    study, o = d.study, d.outcome
    page = Report("What is missing")
    page.lead(d.sentence)
    page.text(f"{meaning(d.state)} {evidence(d.state)}")
    page.bullets("Warnings", d.warnings)
    page.next_here()
    if seen := physics(study, o):
        page.heading("The physics")
        page.figure(*seen, 380)
    page.heading("The error")
    start = "; with known causes: with what the recording shows by itself, such as its weight" * bool(o.known)
    added = "Test error as terms are added; whiskers: 95 % interval, dashed: noise"
    page.figure(ladder(study, o), f"{added}. Before: the twin as it is, re-fitted{start}.", 300)
    if len(o.contributions) > 1:
        worth = "What each cause is worth: by how much the test error rises without it, all else re-fitted"
        shown, height = contributions(study, o), 110 + 42 * len(o.contributions)
        page.figure(shown, f"{worth}; whiskers: 98 % interval.", height)
    for e in o.selected:
        text = hedged(study.describe(o.after, e), family_in(o.twin, e), o.mechanisms)
        page.text(f"**{study.cause(o.after, e)}**: {text} {study.size(o.after, e)}")
    if o.selected:
        page.heading("How well each parameter is known")
        known = [parameter_rows(study.parameters(o.after, e), effect=called(e, o.twin)) for e in o.selected]
        page.table(sum(known, []))
    _candidates(page, study, o, d.state)
    page.heading("Where it fails" if study.recording.device == "gel" else "Where the error is")
    if study.recording.device != "gel":
        worst = F.worst_passages(study.recording, o.after.squared)
        what = "Distance between measured and modelled, before and after"
        shaded = "shaded: the worst passages after. Below: the command."
        page.figure(over_time(study, o, worst), f"{what}; {shaded}", 460)
        page.table(worst, "The worst passages after the change.")
        height = 60 + 260 * ((len(found := shown_axes(study)) + 1) // 2)
        levels = "Error at each level that was recorded; dashed: the noise."
        page.figure(by_level(study, o, found), levels, height)
    for picture, caption in study.pictures(o):
        page.image(picture, caption)
    if d.next_experiment != d.do_next:
        page.heading("If you record more")
        page.text(d.next_experiment)
    if separation is not None:
        first, second = separation.predictions
        k = int(np.argmax(np.abs(first - second).max(0)))  # where they differ most
        pair = [np.round(y[:, k], 4) for y in (first, second)]
        lines = (
            ("chosen", separation.time_s, pair[0], C.AFTER),
            ("rival", separation.time_s, pair[1], C.BEFORE),
            ("difference", separation.time_s, pair[0] - pair[1], {"color": C.OTHER, "dash": "dot"}),
        )
        figure = F.curves(lines, "time (s)", separation.columns[min(k, len(separation.columns) - 1)])
        page.figure(figure, f"Predictions of the two alternatives: {separation.advice}")
    page.heading("The recording")
    noise = study.noise.value
    size = "Noise" if noise is None else f"Noise {noise:.3g} {study.unit}:"
    page.text(f"{size} {study.noise.how}.")
    return page


def contributions(study: EffectStudy, o: Outcome) -> go.Figure:
    shown = sorted(o.contributions, key=lambda c: c.drop[0])
    figure = go.Figure()
    for known, colour, name in ((True, C.KNOWN, "known cause"), (False, C.AFTER, "new")):
        some = [c for c in shown if c.known == known]
        rise = [c.error_without - c.error_with for c in some]
        ends = (  # rises of the error at the ends of the interval of the mean square's
            [max(c.error_with**2 + c.drop[i], 0.0) ** 0.5 - c.error_with for c in some] for i in (1, 2)
        )
        bars = {
            "y": [called(c.name, o.twin) for c in some],
            "x": rise,
            "error_x": F.whiskers(rise, *ends),
        }
        figure.add_bar(**bars, orientation="h", name=name, marker_color=colour)
    figure.update_yaxes(categoryorder="array", categoryarray=[called(c.name, o.twin) for c in shown])
    return figure.update_xaxes(title=f"rise of the test error without it ({study.unit})")


def _candidates(page: Report, study: EffectStudy, o: Outcome, state: State) -> None:
    page.heading("Alternatives")
    page.text(" ".join(filter(None, (alternatives(state), study.how_tested(o)))))
    alone = "Share of the error above the noise that each effect removes alone, with its interval."
    page.figure(reductions(o), alone)
    without = {c.name: c.error_without for c in o.contributions}
    rows = []
    names = [t.name for t in o.tested]
    for name in [*(e for e in o.selected if e not in names), *names]:
        t = next((t for t in o.tested if t.name == name), None)
        row = {
            "effect": called(name, o.twin),
            "name": name,
            "in the headline": "yes" * (name in o.selected),
        }
        row |= {f"test error alone ({study.unit})": t and t.heldout, "removes alone": "not tried alone"}
        row |= {"in the contact": t.errors["heldout_contact"]} if t and "heldout_contact" in t.errors else {}
        if t is not None:
            known = t.reduction is not None and t.ci95 is not None
            row["removes alone"] = percent(t.reduction, t.ci95) if known else "-"
        row |= {f"test error without it ({study.unit})": without.get(name)} if without else {}
        rows.append(row | {"tested by": t.tested_by if t else "with the others"})
    alone = "Alone: with this effect and no other. Without it: with all others, re-fitted."
    page.table(rows, alone * bool(without))
    page.table(rival_rows(o), "Effects that fit the data about as well.")
    page.table([{"not tested": called(u.name), "why": u.reason} for u in study.untested])


def rival_rows(o: Outcome) -> list[dict]:
    pairs = ((called(r.effect, r.winner.twin), called(r.rival, r.fit.twin), r.difference) for r in o.rivals)
    return rows_of(pairs, {"cause": "{0[0]}", "instead": "{0[1]}", "its mean square error": "{0[2]:+.1%}"})


def ladder(study: EffectStudy, o: Outcome) -> go.Figure:
    """Test error before, with the known causes, and as further terms are added."""
    steps = [("before", o.before, C.BEFORE)]
    if o.known and o.baseline is not None:
        steps.append(("with known causes", o.baseline, C.KNOWN))
    for label, model in o.ladder[1:-1]:
        text = label.removeprefix("how it bends").strip().removeprefix("+").strip()
        text = " + ".join(map(called, text.split(" + ")))
        steps += [(f"+ {text}", model, C.OTHER)] if text else []
    if o.selected or o.known:
        steps.append(("with all", o.after, C.AFTER))
    shown = [(name, study.errors(m)["heldout"], study.interval(m), colour) for name, m, colour in steps]
    return error_bars(shown, study.unit, study.noise.value)


def error_bars(steps: list[Step], unit: str, noise: float | None) -> go.Figure:
    """Test errors with their 95 % intervals, one bar a step, and the noise as a dashed line."""
    errors = [error for _, error, *_ in steps]
    bands = [(error, error) if band is None else band for _, error, band, _ in steps]
    names, looks = [f"{name}<br>{error:.3g} {unit}" for name, error, *_ in steps], [s[3] for s in steps]
    figure = go.Figure()
    whisker = F.whiskers(errors, *zip(*bands, strict=True))
    figure.add_bar(x=names, y=errors, marker_color=looks, width=0.5, error_y=whisker)
    if noise:
        figure.add_hline(y=noise, line={"dash": "dash", "color": C.FLOOR}, annotation_text="noise")
    return figure.update_yaxes(title=f"test error ({unit})", rangemode="tozero")


def reductions(o: Outcome) -> go.Figure:
    tested = reversed(o.tested)
    shown = [(t, t.reduction, t.ci95) for t in tested if t.reduction is not None and t.ci95 is not None]
    value = [100 * share for _, share, _ in shown]
    colours = [C.AFTER if t.name in o.selected else C.OTHER for t, *_ in shown]
    ends = ([100 * ci[k] for *_, ci in shown] for k in (0, 1))
    bar = go.Bar(y=[called(t.name) for t, *_ in shown], x=value, orientation="h", marker_color=colours)
    figure = go.Figure(bar.update(error_x=F.whiskers(value, *ends)))
    return figure.update_xaxes(
        title="error above the noise removed (%)", range=[min(-10, *value, 0) - 5, 105]
    )


def over_time(study: EffectStudy, o: Outcome, worst: list[dict]) -> go.Figure:
    """Error before and after, and the command below, over the runs laid end to end."""
    t, shift = F.session_clock(study.recording)
    step = max(1, len(t) // MOST_POINTS)
    p = study.recording.samples[list(study.recording.pressure_columns)].to_numpy(float).mean(1)
    shown = (
        (1, "before", np.sqrt(o.before.squared)[::step].round(4), C.BEFORE),
        (1, "after", np.sqrt(o.after.squared)[::step].round(4), C.AFTER),
        (2, "command", p[::step].round(3), C.COMMAND),
    )
    lines = ((row, name, t[::step].round(3), y, {"width": 1, "color": c}) for row, name, y, c in shown)
    figure = F.stacked((f"error ({study.unit})", "kPa"), (1.0, 0.4), 0.04, lines)
    F.shade(figure, worst, shift)
    figure.update_yaxes(rangemode="tozero", row=1, col=1)
    return F.name_runs(figure, study.recording, row=2)


def shown_axes(study: EffectStudy) -> list[Axis]:
    """Conditions first, then pressure, direction, hold time and program; those that vary."""
    recording = study.recording
    if not isinstance(recording, Recording):
        p = recording.samples[list(recording.pressure_columns)].to_numpy(float).mean(1)
        return [numbers("pressure_cmd_kpa", p, 8)]
    known = {a.name: a for a in axes(recording) if len(a.labels) > 1}
    wanted = (*CONDITIONS, *recording.pressure_columns, "direction", "hold_time_s", "program")
    return [known[n] for n in wanted if n in known]


def by_level(study: EffectStudy, o: Outcome, found: list[Axis]) -> go.Figure:
    def errors(squared: np.ndarray, axis: Axis) -> np.ndarray:
        return np.round([np.sqrt(squared[axis.bin == i].mean()) for i in range(len(axis.labels))], 4)

    kinds = ((o.before, C.BEFORE, "before"), (o.after, C.AFTER, "after"))
    panels = {
        a.name.replace("_", " "): [(a.labels, errors(r.squared, a), colour, n) for r, colour, n in kinds]
        for a in found
    }
    return F.bar_panels(panels, study.noise.value).update_yaxes(title_text=study.unit, col=1)


def physics(study: EffectStudy, o: Outcome) -> tuple[go.Figure, str] | None:
    """The largest cause that is no known one, else the largest: figure and caption; None where none shows."""
    order = [c.name for c in sorted(o.contributions, key=lambda c: -c.drop[0])] or list(o.selected)
    order = [e for e in order if e in o.after.effects]
    if not order or not isinstance(study.recording, Recording) or study.recording.device == "gel":
        return None
    effect = next((e for e in order if e not in o.known), order[0])
    data = read(study.recording, o.twin)
    without, left = study.residual(o.twin.without(effect)), o.after.residual
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
    titles = ("response", "minus the model without it")
    figure = make_subplots(1, 2, horizontal_spacing=0.1, subplot_titles=titles)
    for name, y in lines.items():
        label = name if name == "measured" else f"model {name} it"
        style = {"color": MEANT[name], "width": 2, "dash": "solid" if name != "without" else "dash"}
        line = {"x": np.round(x, 3), "name": label, "legendgroup": name, "mode": "lines", "line": style}
        for col, shown in ((1, y), (2, y - lines["without"])):
            figure.add_scatter(**line, y=np.round(shown, 5), showlegend=col == 1, row=1, col=col)
    figure.update_xaxes(title_text=x_title)
    figure.update_yaxes(title_text=y_title, row=1, col=1)
    return figure


def _steps(recording: Recording, lines, column: str, effect: str) -> tuple[go.Figure, str] | None:
    p = recording.commands.mean(1)
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
    figure = _panels(x, mean, "time after the step (s)", f"{_title(column)} ({unit_of(column)}/kPa)")
    return figure, f"Mean response to {len(steps)} steps {way}, per kPa of the step."


def _loop(recording: Recording, lines, column: str, effect: str) -> tuple[go.Figure, str] | None:
    p = recording.commands.mean(1)
    way = next((a for a in axes(recording) if a.name == "direction"), None)
    if way is None or "loading" not in way.labels or "unloading" not in way.labels:
        return None
    edges = np.linspace(p.min(), p.max() + 1e-9, BINS + 1)
    cells = pd.DataFrame({"p": p, **lines}).groupby([way.bin, np.digitize(p, edges) - 1])
    mean = cells.mean()[cells.size() >= FEWEST]
    there, back = (
        mean[mean.index.get_level_values(0) == way.labels.index(w)] for w in ("loading", "unloading")
    )
    loop = pd.concat([there, back[::-1]])
    if len(loop) < BINS // 2:
        return None
    means = {name: loop[name].to_numpy() for name in lines}
    figure = _panels(loop["p"].to_numpy(), means, "commanded pressure (kPa)", _axis(column))
    return figure, "Mean over the pressure, while it rises and while it falls."


def _by_level(recording: Recording, lines, column: str, effect: str) -> tuple[go.Figure, str] | None:
    """What the model without the cause misses at each level of its condition."""
    axis = next((a for a in axes(recording) if a.name == LEVELS[family(effect)]), None)
    if axis is None or len(axis.labels) < 2:
        return None
    figure, levels = go.Figure(), range(len(axis.labels))
    for name, colour, label in (
        ("measured", C.MEASURED, "measured"),
        ("with", C.AFTER, "model with it"),
    ):
        difference = lines[name] - lines["without"]
        y = [float(np.sqrt((difference[axis.bin == i] ** 2).mean())) for i in levels]
        figure.add_bar(x=axis.labels, y=np.round(y, 4), name=label, marker_color=colour)
    figure.update_xaxes(type="category", title_text=_title(axis.name))
    figure.update_yaxes(title_text=_axis(column))
    return figure, "Root mean square difference from the model without it, at each level that was recorded."


def _axis(column: str) -> str:
    return f"{_title(column)} ({unit_of(column)})"


def _title(name: str) -> str:
    return name.rpartition("_")[0].replace("_", " ") if unit_of(name) else name.replace("_", " ")
