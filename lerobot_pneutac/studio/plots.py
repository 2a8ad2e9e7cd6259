"""Small line charts of the studio, redrawn many times a second.

Colours of the studio: those of the reports, distinct for the colour-blind, on light and on dark.
"""

import math
import threading
import time
from collections.abc import Callable

import numpy as np
import viser
from viser import uplot

from lerobot_pneutac.reports.page import FLOOR, MODEL, cell  # noqa: F401  the colours of the studio too

FRAMES_A_S = 20
SPEEDS = {"1 x": 1.0, "0.2 x": 0.2, "5 x": 5.0, "20 x": 20.0}


class Background:
    """What goes on in a thread of its own until it is closed, and may then start again."""

    _thread: threading.Thread | None = None

    def start(self, run: Callable[[], None], name: str) -> None:
        self._stop = threading.Event()
        self._thread = threading.Thread(target=run, daemon=True, name=name)
        self._thread.start()

    def close(self) -> None:
        if self._thread is not None:
            self._stop.set()
            self._thread.join(timeout=5.0)


class Player(Background):
    """A moment that moves on by itself, or by hand."""

    def __init__(self, gui: viser.GuiApi, show: Callable[[], None]):
        self._time = gui.add_slider("time, s", 0.0, 1.0, 0.01, 0.0)
        self._playing = gui.add_checkbox("Play", False)
        self._speed = gui.add_dropdown("speed", tuple(SPEEDS))
        self._show, self._ready = show, False
        self._time.on_update(lambda _: show())
        self.start(self._run, "player")

    @property
    def now_s(self) -> float:
        return self._time.value

    @now_s.setter
    def now_s(self, value: float) -> None:
        value, before = float(min(max(value, 0.0), self._time.max)), self._time.value
        self._time.value = value  # which shows it, where it is another
        if value == before:
            self._show()

    def reaches(self, end_s: float) -> None:
        """There is something to show, from 0 on."""
        end_s = math.floor(100 * end_s) / 100  # as the slider steps
        self._time.max, self._ready = end_s, True
        self._time.value = min(self._time.value, end_s)

    def _run(self) -> None:
        last = time.monotonic()
        while not self._stop.wait(1 / FRAMES_A_S):
            now = time.monotonic()
            dt, last = now - last, now
            if self._playing.value and self._ready:
                t = self._time.value + dt * SPEEDS[self._speed.value]
                self.now_s = t if t <= self._time.max else 0.0


def show_text(markdown, text: str) -> None:
    """Shows a text, or hides its place where it is empty."""
    markdown.content, markdown.visible = text, bool(text)


def table(rows: list[dict]) -> str:
    """Rows of one kind as Markdown; empty where there are none."""
    if not rows:
        return ""
    head = "| " + " | ".join(map(str, rows[0])) + " |\n|" + "---|" * len(rows[0])
    return "\n".join([head, *("| " + " | ".join(cell(v) for v in row.values()) + " |" for row in rows)])


GRID, INK = "rgba(122, 135, 148, 0.25)", "#7a8794"


class Lines:
    """Lines over a common axis, each a name with unit and a colour, with a scale of its own or `one_scale`.

    `now` is the colour of a cursor at the present moment; empty for none.
    """

    def __init__(
        self, gui: viser.GuiApi, x: str, lines: tuple, height: int = 160, one_scale: str = "", now: str = ""
    ):
        names = [one_scale or name for name, _ in lines]
        series = [uplot.Series(label=x)]
        drawn = [(*line, scale) for line, scale in zip(lines, names, strict=True)]
        for name, colour, scale in (*drawn, *([("now", now, names[0])] if now else [])):
            style = {"width": 1.5, "points": {"show": False}}
            series.append(uplot.Series(label=name, stroke=colour, scale=scale, **style))
        axes = [uplot.Axis(stroke=INK, grid={"stroke": GRID}, size=30)]
        for k, scale in enumerate(dict.fromkeys(names)):
            axes.append(uplot.Axis(
                scale=scale, label=scale, stroke=INK, side=3 if k == 0 else 1, size=48, labelSize=18,
                grid={"stroke": GRID, "show": k == 0},
            ))  # fmt: skip
        data = (np.array([0.0, 1.0]), *(np.full(2, np.nan) for _ in series[1:]))
        scales = {"x": {"time": False}} | {s: {"auto": True} for s in names}
        looks = {"height": height, "legend": {"show": True}, "padding": (10, 24, 0, 0)}
        self._plot = gui.add_uplot(data, tuple(series), scales=scales, axes=tuple(axes), **looks)

    def show(self, x: np.ndarray, *lines: np.ndarray, now: float | None = None) -> None:
        """Draws lines (n,) over x (n,), and a cursor at x = `now`."""
        if now is not None:  # a line with one peak, for a gap would take the axis its range
            cursor = np.full(len(x), min(v.min() for v in lines))
            cursor[np.argmin(np.abs(x - now))] = max(v.max() for v in lines)
            lines = (*lines, cursor)
        self._plot.data = tuple(np.asarray(v, np.float64) for v in (x, *lines))


MEASURED = "#7a8794"  # the reports' is near black, which a dark page swallows
PRESSURE = "#2389bd"  # as that of the reports, lighter, for lines on dark
BRAND = (12, 116, 162)  # the viewer makes it lighter on light, so that both are seen at about 3 : 1
SKIN, BASE = (120, 170, 200), (90, 100, 112)
SPINE, JOINTS, TRAIL = (27, 36, 48), (255, 214, 102), (209, 73, 91)


def rgb(colour: str) -> tuple[int, int, int]:
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)
