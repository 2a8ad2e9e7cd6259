"""The report of a diagnosis: the sentence first, then the evidence as pictures."""

import numpy as np
import plotly.graph_objects as go

from lerobot_pneutac.diagnosis.experiment import Separation
from lerobot_pneutac.diagnosis.result import Outcome
from lerobot_pneutac.reports.page import Report, span
from lerobot_pneutac.reports.sentences import State, alternatives, evidence, meaning, percent
from lerobot_pneutac.study.base import EffectStudy

BLUE, GREY, RED = "#0b6e99", "#9aa5b1", "#b8442f"
MOST_POINTS = 4000
PASSAGE_S = 3.0


def diagnosis_page(d, separation: Separation | None) -> Report:
    """The report of a `Diagnosis`, and of the experiment that tells two rivals apart, if any."""
    study, o = d.study, d.outcome
    page = Report("What is missing")
    page.lead(d.sentence)
    page.text(f"**Confidence: {d.confidence}.** {meaning(d.state)} {evidence(d.state)}")
    page.bullets("Warnings", d.warnings)
    page.next_here()
    if not d.next_command:
        page.text(f"**Do next.** {d.do_next}")
    page.figure(
        ladder(study, o),
        "The error as more is added, where nothing was fitted; whiskers: 95 % interval, dashed: noise.",
        270,
    )
    if o.selected:
        page.text(f"**In numbers.** {' '.join(study.describe(o.after, e) for e in o.selected)}")
    _candidates(page, study, o)
    if study.recording.device == "gel":
        page.heading("Where it fails")
    else:
        _over_time(page, study, o)
    for picture, caption in study.pictures(o):
        page.image(picture, caption)
    _rivals(page, o, d.state)
    _parameters(page, study, o)
    if separation is not None:
        page.figure(proposed(separation), f"Predictions of the two rivals: {separation.advice}")
    page.heading("The recording")
    size = "" if study.noise.value is None else f" {study.noise.value:.3g} {study.unit}:"
    page.text(f"Noise floor{size} {study.noise.how}.")
    for sentence in d.findings or ["The data check found nothing to complain about."]:
        page.text(sentence)
    return page


def _candidates(page: Report, study: EffectStudy, o: Outcome) -> None:
    page.heading("Each candidate alone")
    page.text(study.how_tested(o))
    page.figure(
        reductions(o), "Share of the avoidable error that each effect alone removes, with its interval."
    )
    rows = []
    for t in o.tested:
        row = {"effect": t.name, f"test error ({study.unit})": t.heldout}
        row |= {"in the contact": t.errors["heldout_contact"]} if "heldout_contact" in t.errors else {}
        removes = "-" if t.reduction is None else percent(t.reduction, t.ci95)
        rows.append(row | {"removes": removes, "tested by": t.tested_by})
    page.table(rows)
    page.table([{"not tested": u.name, "why": u.reason} for u in study.untested])


def _over_time(page: Report, study: EffectStudy, o: Outcome) -> None:
    page.heading("What is left over time")
    caption = "Distance between measured and modelled, before and after; red: the command."
    page.figure(over_time(study, o), caption)
    page.table(worst(study, o), "The worst passages after the change.")
    page.heading("Where the error is")
    for name, x in axes(study).items():
        page.figure(against(study, o, name, x), height=300)


def _rivals(page: Report, o: Outcome, state: State) -> None:
    page.heading("Alternatives")
    page.text(alternatives(state))
    page.table(
        [
            {
                "effect": r.effect,
                "rival": r.rival,
                "rival's mean square error": f"{100 * r.difference:+.1f} %",
            }
            for r in o.rivals
        ],
        "Effects that explain the test part as well, as far as can be told.",
    )


def _parameters(page: Report, study: EffectStudy, o: Outcome) -> None:
    if not o.selected:
        return
    page.heading("How well each parameter is known")
    fitted = {e: study.parameters(o.after, e) for e in o.selected}
    page.table(
        [
            {
                "effect": e,
                "parameter": k,
                "value": p["value"],
                "95 % interval": span(p["ci95"], "held"),
                "unit": p["unit"] or "(a ratio)",
            }
            for e, parameters in fitted.items()
            for k, p in parameters.items()
        ]
    )


def ladder(study: EffectStudy, o: Outcome) -> go.Figure:
    """Held-out error as effects are added."""
    rms = [study.errors(model)["heldout"] for _, model in o.ladder]
    labels = [f"{label}<br>{x:.3g} {study.unit}" for (label, _), x in zip(o.ladder, rms, strict=True)]
    band = [study.interval(model) for _, model in o.ladder]
    up = [max(0.0, float(b[1]) - v) for b, v in zip(band, rms, strict=True)]
    down = [max(0.0, v - float(b[0])) for b, v in zip(band, rms, strict=True)]
    figure = go.Figure(
        go.Bar(
            x=labels, y=rms, marker_color=[GREY] + [BLUE] * (len(rms) - 1), width=0.5,
            error_y={"type": "data", "array": up, "arrayminus": down, "color": "#333"},
        )
    )  # fmt: skip
    if study.noise.value is not None:
        figure.add_hline(y=study.noise.value, line_dash="dash", line_color=RED, annotation_text="noise")
    return figure.update_yaxes(title=f"error ({study.unit})", rangemode="tozero")


def reductions(o: Outcome) -> go.Figure:
    """Each candidate's share of the avoidable error."""
    shown = [t for t in o.tested if t.reduction is not None][::-1]
    value = [100 * t.reduction for t in shown]
    figure = go.Figure(
        go.Bar(
            y=[t.name for t in shown], x=value, orientation="h",
            marker_color=[BLUE if t.name in o.selected else GREY for t in shown],
            error_x={
                "type": "data", "array": [max(0, 100 * (t.ci95[1] - t.reduction)) for t in shown],
                "arrayminus": [max(0, 100 * (t.reduction - t.ci95[0])) for t in shown], "color": "#333",
            },
        )
    )  # fmt: skip
    return figure.update_xaxes(title="avoidable error removed (%)", range=[min(-10, *value, 0) - 5, 105])


def over_time(study: EffectStudy, o: Outcome) -> go.Figure:
    """Error before and after, over the commanded pressure on an axis of its own at the right."""
    t = _session_time(study)
    step = max(1, len(t) // MOST_POINTS)
    p = study.recording.samples[list(study.recording.pressure_columns)].to_numpy(float).mean(1)
    figure = go.Figure()
    figure.add_scatter(
        x=t[::step], y=np.round(p[::step], 3), name="command", yaxis="y2", opacity=0.35,
        line={"width": 1, "color": RED},
    )  # fmt: skip
    for name, r, colour in (("before", o.before, GREY), ("after", o.after, BLUE)):
        y = np.sqrt(r.squared)[::step]
        figure.add_scatter(x=t[::step], y=np.round(y, 4), name=name, line={"width": 1, "color": colour})
    red = {"color": RED}
    return figure.update_layout(
        xaxis={"title": "session (s)"},
        yaxis={
            "title": f"error ({study.unit})", "rangemode": "tozero", "overlaying": "y2", "tickmode": "auto",
        },
        yaxis2={
            "title": {"text": "command (kPa)", "font": red}, "tickfont": red, "side": "right",
            "rangemode": "tozero", "showgrid": False, "zeroline": False, "automargin": True,
        },
        legend={"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0},
    )  # fmt: skip


def axes(study: EffectStudy) -> dict[str, np.ndarray]:
    """Quantities against which the error is drawn."""
    s = study.recording.samples
    p = s[list(study.recording.pressure_columns)].to_numpy(float).mean(1)
    t = s["time_s"].to_numpy()
    first = np.r_[True, np.diff(s["trial"].to_numpy()) != 0]
    dt = np.where(first, np.inf, np.diff(t, prepend=t[0]))
    found = {"command (kPa)": p, "rate of the command (kPa/s)": np.diff(p, prepend=p[0]) / dt}
    largest = np.concatenate([np.maximum.accumulate(p[rows]) for rows in study.recording.trials().values()])
    found["below the largest command so far (kPa)"] = largest - p
    found["time in the trial (s)"] = t
    for name in ("temperature_c", "payload_g", "gravity_z"):
        if name in s and np.ptp(s[name]) > 0:
            found[name] = s[name].to_numpy(float)
    return found


def against(study: EffectStudy, o: Outcome, name: str, x: np.ndarray) -> go.Figure:
    """Root mean square error in bins of equal count."""
    figure = go.Figure()
    edges = np.unique(np.quantile(x, np.linspace(0, 1, 16)))
    index = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, max(len(edges) - 2, 0))
    count = np.maximum(np.bincount(index), 1)
    centre = np.bincount(index, x) / count
    for label, r, colour in (("before", o.before, GREY), ("after", o.after, BLUE)):
        rms = np.sqrt(np.bincount(index, r.squared) / count)
        figure.add_scatter(x=centre, y=rms, name=label, mode="lines+markers", line={"color": colour})
    if study.noise.value is not None:
        figure.add_hline(y=study.noise.value, line_dash="dash", line_color=RED)
    return figure.update_xaxes(title=name).update_yaxes(title=f"error ({study.unit})", rangemode="tozero")


def worst(study: EffectStudy, o: Outcome) -> list[dict]:
    """The five passages of three seconds with the largest error."""
    trial, t = study.recording.column("trial"), study.recording.column("time_s")
    passage = np.floor(t / PASSAGE_S).astype(int)
    key, index = np.unique(np.stack([trial, passage], 1), axis=0, return_inverse=True)
    index = index.reshape(-1)
    count = np.bincount(index)
    after = np.sqrt(np.bincount(index, o.after.squared) / count)
    before = np.sqrt(np.bincount(index, o.before.squared) / count)
    return [
        {
            "trial": int(key[i, 0]), "from_s": PASSAGE_S * key[i, 1], "to_s": PASSAGE_S * (key[i, 1] + 1),
            "before": float(before[i]), "after": float(after[i]),
        }
        for i in np.argsort(-after)[:5]
    ]  # fmt: skip


def proposed(s: Separation) -> go.Figure:
    """What the two rivals predict in the proposed experiment."""
    figure = go.Figure()
    spread = [float(np.abs(a - b).max()) for a, b in zip(s.predictions[0].T, s.predictions[1].T, strict=True)]
    k = int(np.argmax(spread))
    for name, y, colour in zip(("chosen", "rival"), s.predictions, (BLUE, RED), strict=True):
        figure.add_scatter(x=s.time_s, y=np.round(y[:, k], 4), name=name, line={"color": colour})
    apart = np.round((s.predictions[0] - s.predictions[1])[:, k], 4)
    figure.add_scatter(x=s.time_s, y=apart, name="difference", line={"color": GREY, "dash": "dot"})
    return figure.update_xaxes(title="time (s)").update_yaxes(title=s.columns[min(k, len(s.columns) - 1)])


def _session_time(study: EffectStudy) -> np.ndarray:
    t = study.recording.column("time_s").astype(float).copy()
    shift = 0.0
    for rows in study.recording.trials().values():
        t[rows] += shift - t[rows.start]
        shift = t[rows.stop - 1] + 1.0
    return t
