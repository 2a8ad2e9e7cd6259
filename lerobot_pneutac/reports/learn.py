"""The page of `pneutac learn`: how well each next program was predicted, and what was found.

The pages of `pneutac design`: a program, and what each candidate model predicts of it; motions.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import plotly.graph_objects as go
from PIL import Image, ImageDraw, ImageFont
from plotly.subplots import make_subplots

from lerobot_pneutac.reports.figures import curves, stacked
from lerobot_pneutac.reports.page import CHAMBERS, HELDOUT, INK, MEASURED, MODEL, PALE, PAPER, TRAIN, Report
from lerobot_pneutac.reports.sentences import called
from pneutac_sim.effects.laws import plain_name


def design_page(design) -> Report:
    report, best = design.lead_page(), design.best
    figure = stacked((f"predicted, {design.unit}", "pressure, kPa"), (0.7, 0.3))
    # Of the predicted columns the one in which the models differ most.
    spread = np.std(np.stack(best.predictions), axis=0).max(axis=0)
    for c, seen in zip(design.contenders, best.predictions, strict=True):
        name = f"{100 * c.probability:.0f} %: {' + '.join(map(called, c.terms)) or 'no effect'}"
        figure.add_scatter(x=best.time_s, y=seen[:, spread.argmax()], name=name[:60], row=1, col=1)
    for trace in pressure_traces(best.time_s, best.pressure_kpa):
        figure.add_trace(trace, 2, 1)
    what = "What each model predicts, with its probability before the program, and the program."
    report.figure(figure, what, 520)
    report.table(design.rows(), "The programs with the most information for their time.")
    return report


def motion_page(design) -> Report:
    report = design.lead_page()
    for c in dict.fromkeys(design.chosen.values()):
        titles, x, y = ("time, s", "force on the gel, N"), "time_s", "force_n"
        if c.motion.drag_mm > 0:
            titles = ("sideways path of the arm, mm", "turn of the imprint, degrees")
            x, y = "sideways_mm", "turn_deg"
        lines = (
            (name, getattr(response, x), getattr(response, y), None) for name, response in c.responses.items()
        )
        figure = curves(lines, *titles)
        report.figure(figure, f"{c.motion.name}: the twin as it is, and with one thing changed.".capitalize())
    report.table(design.rows(), "Standard deviations with which each motion would show a change.")
    for remark in design.remarks():
        report.text(remark)
    return report


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


PREDICTED = "foreseen.csv"  # in a round's folder: its program as predicted and as measured
FASTER, FRAMES_HZ = 10.0, 10.0
SIZE = (720, 400)  # width, height
# left, top, right, bottom
CURVE, COMMAND, BARS = (60, 60, 470, 270), (60, 300, 470, 370), (530, 60, 700, 370)


def learn_page(learning) -> Report:
    report = learning.lead_page()
    report.figure(
        _predicted_ahead(learning),
        "Error on each program before it was used for anything, by the best model until then and by the "
        "twin as it was given, re-fitted, and the error of what was found after it, where no fit saw.",
    )
    files = {r.number: learning.folder / f"round_{r.number}" / PREDICTED for r in learning.rounds}
    seen = [r for r in learning.rounds if files[r.number].is_file()]
    if seen:
        frames = list(film_frames(seen, [files[r.number] for r in seen]))
        what = "Each program as predicted before it was measured, and as measured"
        report.film(frames, 1 / FRAMES_HZ, f"{what}, {FASTER:.0f} times as fast.", 720)
    report.table(learning.rows(), "* confirmed by a program of another kind that was predicted with it.")
    report.figure(_programs(learning), "What was commanded.", 120 + 90 * len(learning.rounds))
    report.figure(_likely(learning), "How likely each model was after each round, by its last effects.")
    report.heading("What was found, round by round")
    for r in learning.rounds:
        report.text(f"**Round {r.number}, {r.program}.** {r.sentence}")
    return report


def _predicted_ahead(learning) -> go.Figure:
    rounds = learning.rounds
    at = [r.number for r in rounds]
    lines = (
        ("predicted", at, [r.predicted_error for r in rounds], {"color": MODEL}),
        ("as given", at, [r.bare_error for r in rounds], {"color": HELDOUT}),
        ("after", at, [r.error for r in rounds], {"color": TRAIN, "dash": "dot"}),
        ("noise", at, [r.noise for r in rounds], {"color": MEASURED, "dash": "dash"}),
    )
    figure = curves(lines, "round", f"error, {rounds[-1].unit}", mode="lines+markers")
    figure.update_xaxes(dtick=1).update_yaxes(rangemode="tozero")
    return figure


def _programs(learning) -> go.Figure:
    rounds = learning.rounds
    figure = make_subplots(len(rounds), 1, vertical_spacing=0.25 / max(len(rounds), 2))
    for i, r in enumerate(rounds):
        table = pd.read_csv(learning.folder / f"round_{r.number}" / "program.csv")
        commands = table[[c for c in table if c.startswith("pressure_cmd_")]].to_numpy(float)
        for trace in pressure_traces(table["time_s"], commands):
            trace.update(legendgroup=trace.name, showlegend=trace.showlegend and not i)
            figure.add_trace(trace, i + 1, 1)
        figure.update_yaxes(title_text=f"{r.number}, kPa", row=i + 1, col=1)
    figure.update_xaxes(title_text="time, s", row=len(rounds), col=1)
    return figure


def _likely(learning) -> go.Figure:
    figure = go.Figure()
    for r in learning.rounds:
        for name, p in sorted(r.probabilities.items(), key=lambda item: -item[1]):
            label = " + ".join(map(plain_name, name.split(" + "))) or "no effect"
            text = {"name": label, "hovertext": label, "text": label.split(" + ")[-1]}
            figure.add_bar(x=[r.number], y=[p], showlegend=False, **text)
    figure.update_layout(barmode="stack")
    figure.update_xaxes(title_text="round", dtick=1)
    figure.update_yaxes(title_text="probability")
    return figure


def film_frames(rounds, files: list[Path]) -> Iterator[np.ndarray]:
    """Pictures, uint8 (H, W, 3), `FRAMES_HZ` of them a second."""
    for k, (r, file) in enumerate(zip(rounds, files, strict=True)):
        table = pd.read_csv(file)
        t = table["time_s"].to_numpy(float) - table["time_s"].iloc[0]
        names = [c.removesuffix(" measured") for c in table if c.endswith(" measured")]
        name = max(names, key=lambda n: np.ptp(table[f"{n} measured"]))
        for now_s in np.arange(0.0, t[-1] + FASTER / FRAMES_HZ, FASTER / FRAMES_HZ):
            yield _frame(rounds[: k + 1], r, t, table, name, min(now_s, t[-1]))


def _frame(rounds, r, t: np.ndarray, table: pd.DataFrame, name: str, now_s: float) -> np.ndarray:
    picture = Image.new("RGB", SIZE, PAPER)
    draw = ImageDraw.Draw(picture)
    small, large = ImageFont.load_default(13), ImageFont.load_default(16)
    draw.text((60, 12), f"program {r.number}: {r.program}", INK, large)
    seen, measured = table[f"{name} foreseen"].to_numpy(float), table[f"{name} measured"].to_numpy(float)
    reach = (min(seen.min(), measured.min()), max(seen.max(), measured.max()))
    past = t <= now_s
    _line(draw, CURVE, t[past], measured[past], reach, MEASURED, t[-1], 3)
    _line(draw, CURVE, t, seen, reach, MODEL, t[-1])
    draw.text((CURVE[0], CURVE[1] - 20), f"{name}: predicted", MODEL, small)
    draw.text((CURVE[0] + 190, CURVE[1] - 20), "measured", MEASURED, small)
    commands = table[[c for c in table if c.startswith("pressure_cmd_")]].to_numpy(float).T
    reach, colours = (commands.min(), commands.max()), CHAMBERS if len(commands) > 1 else (INK,)
    for command, colour in zip(commands, colours, strict=False):
        _line(draw, COMMAND, t[past], command[past], reach, colour, t[-1])
    draw.text((COMMAND[0], COMMAND[1] - 18), f"command, up to {reach[1]:.3g} kPa", INK, small)
    draw.text((COMMAND[2] - 60, COMMAND[3] + 6), f"{now_s:.0f} of {t[-1]:.0f} s", INK, small)
    _bars(draw, rounds if now_s >= t[-1] else rounds[:-1], small)
    return np.asarray(picture)


def _line(draw, box, t, y, reach, colour, end_s, width=1) -> None:
    left, top, right, bottom = box
    draw.rectangle(box, outline=PALE)
    if len(t) > 1:
        x = left + (right - left) * t / end_s
        down = bottom - (bottom - top) * (y - reach[0]) / max(reach[1] - reach[0], 1e-9)
        draw.line(list(zip(x, down, strict=True)), colour, width)


def _bars(draw, rounds, font) -> None:
    """Error over noise of each program before it was used, by the model and by the twin as given."""
    left, top, right, bottom = BARS
    draw.text((left, top - 40), "error / noise, before use", INK, font)
    draw.text((left, top - 22), "predicted", MODEL, font)
    draw.text((left + 70, top - 22), "as given", HELDOUT, font)
    most = 30.0

    def place(ratio: float) -> float:
        return bottom - (bottom - top) * np.log(max(ratio, 1.0)) / np.log(most)

    for ratio in (1, 3, 10, 30):
        draw.line([(left, place(ratio)), (right, place(ratio))], PALE)
        draw.text((left - 24, place(ratio) - 8), f"{ratio}", INK, font)
    step = (right - left) / max(len(rounds), 8)
    for i, r in enumerate(rounds):
        for j, (error, colour) in enumerate(((r.predicted_error, MODEL), (r.bare_error, HELDOUT))):
            x = left + step * (i + 0.15 + 0.38 * j)
            height = place(min(max(error / r.noise, 1.05), most))
            draw.rectangle([x, height, x + 0.33 * step, bottom], fill=colour)
