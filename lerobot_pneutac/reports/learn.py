"""The page of `pneutac learn`: how well each next program was foreseen, and what was found."""

from pathlib import Path

import numpy as np
import pandas as pd
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from lerobot_pneutac.reports.compare import HELDOUT, MEASURED, MODEL, TRAIN
from lerobot_pneutac.reports.design import pressure_traces
from lerobot_pneutac.reports.learn_film import FASTER, FORESEEN, FRAMES_HZ, film_frames
from lerobot_pneutac.reports.page import Report


def learn_page(learning) -> Report:
    """The report of a `Learning`."""
    report = Report(learning.title)
    report.lead(learning.sentence)
    report.figure(
        _foreseen(learning),
        "Error on each program before it was used for anything, by the best model until then and by the "
        "twin as it was given, re-fitted, and the error of what was found after it, where no fit saw.",
    )
    seen = [r for r in learning.rounds if _kept(learning, r).is_file()]
    if seen:
        frames = list(film_frames(seen, [_kept(learning, r) for r in seen]))
        report.film(
            frames,
            1 / FRAMES_HZ,
            f"What was foreseen of each program, and what came, {FASTER:.0f} times as fast.",
            720,
        )
    report.table(learning.rows(), "* confirmed by a program of another kind that was predicted with it.")
    report.figure(_programs(learning), "What was commanded.", 120 + 90 * len(learning.rounds))
    report.figure(_likely(learning), "How likely each model was after each round, by its last effects.")
    report.heading("What was found, round by round")
    for r in learning.rounds:
        report.text(f"**Round {r.number}, {r.program}.** {r.sentence}")
    return report


def _kept(learning, r) -> Path:
    return learning.folder / f"round_{r.number}" / FORESEEN


def _foreseen(learning) -> go.Figure:
    rounds = learning.rounds
    figure = go.Figure()
    seen = [r for r in rounds if r.predicted_error is not None]
    for name, colour, values in (
        ("foreseen", MODEL, [r.predicted_error for r in seen]),
        ("as given", HELDOUT, [r.bare_error for r in seen]),
    ):
        x = [r.number for r in seen]
        figure.add_trace(go.Scatter(x=x, y=values, name=name, mode="lines+markers", line={"color": colour}))
    x = [r.number for r in rounds]
    after = {"color": TRAIN, "dash": "dot"}
    figure.add_trace(go.Scatter(x=x, y=[r.error for r in rounds], name="after", line=after))
    noise = {"color": MEASURED, "dash": "dash"}
    figure.add_trace(go.Scatter(x=x, y=[r.noise for r in rounds], name="noise", line=noise))
    figure.update_xaxes(title_text="round", dtick=1)
    figure.update_yaxes(title_text=f"error, {rounds[-1].unit}", rangemode="tozero")
    return figure


def _programs(learning) -> go.Figure:
    rounds = learning.rounds
    figure = make_subplots(len(rounds), 1, vertical_spacing=0.25 / max(len(rounds), 2))
    for i, r in enumerate(rounds):
        table = pd.read_csv(learning.folder / f"round_{r.number}" / "program.csv")
        commands = table[[c for c in table if c.startswith("pressure_cmd_")]].to_numpy(float)
        for trace in pressure_traces(table["time_s"], commands):
            figure.add_trace(
                trace.update(legendgroup=trace.name, showlegend=trace.showlegend and not i), i + 1, 1
            )
        figure.update_yaxes(title_text=f"{r.number}, kPa", row=i + 1, col=1)
    figure.update_xaxes(title_text="time, s", row=len(rounds), col=1)
    return figure


def _likely(learning) -> go.Figure:
    figure = go.Figure()
    for r in learning.rounds:
        names = list(r.probabilities)
        order = np.argsort([-r.probabilities[n] for n in names])
        for i in order:
            label = names[i] or "no effect"
            figure.add_trace(
                go.Bar(
                    x=[r.number], y=[r.probabilities[names[i]]], name=label, showlegend=False,
                    hovertext=label, text=label.split(" + ")[-1],
                )
            )  # fmt: skip
    figure.update_layout(barmode="stack")
    figure.update_xaxes(title_text="round", dtick=1)
    figure.update_yaxes(title_text="probability")
    return figure
