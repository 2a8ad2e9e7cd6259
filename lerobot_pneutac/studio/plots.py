"""Parts of several pages: line charts, redrawn many times a second, and switches of effects.

Their colours are those of the reports, distinct for the colour-blind, on light and on dark.
"""

import math
import threading
import time
from collections.abc import Callable, Iterable, Mapping

import numpy as np
import viser
from viser import uplot

from lerobot_pneutac.reports.page import FLOOR, MODEL, cell  # noqa: F401  the colours of the studio too
from pneutac_sim.effects.effect import Effect, Parameter
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.twin import Value

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


STEPS = 400  # of a slider
DECADES = 10.0  # a positive parameter may be so many times larger or smaller than it is


class EffectsPanel:
    """A folder with switches of some effects."""

    def __init__(self, gui: viser.GuiApi, title: str):
        self._gui, self._place, self._folder = gui, gui.add_folder(title, expand_by_default=False), None
        self._rows: list[_Switch] = []

    def fill(
        self,
        names: Iterable[str],
        present: Mapping[str, Mapping[str, Value]],
        range_kpa: float,
        changed: Callable[[], None],
    ) -> None:
        """Switches of effects, with the values `present` in the twin; `range_kpa` scales their bounds."""
        if self._folder is not None:
            self._folder.remove()
        with self._place:
            self._folder = self._gui.add_folder("switched on here alone; nothing is written")
        with self._folder:
            self._rows = [
                _Switch(self._gui, get_effect(n), present.get(n), range_kpa, changed) for n in names
            ]

    def values(self) -> dict[str, dict[str, Value]]:
        return {row.effect.name: row.values() for row in self._rows if row.on}


class _Switch:
    def __init__(self, gui, effect: Effect, values: Mapping[str, Value] | None, range_kpa: float, changed):
        self.effect = effect
        start = effect.start(range_kpa) | dict(values or {})
        defaults = {k: v.value for k, v in effect.start().items()}
        about = effect.describe(defaults, "device").partition(". ")[0]
        self._box = gui.add_checkbox(effect.name.replace("_", " "), values is not None, hint=about)
        self._fixed = {k: v for k, v in start.items() if k not in {p.name for p in effect.parameters}}
        self._sliders = {
            p.name: _slider(gui, p, start[p.name], range_kpa, values is not None) for p in effect.parameters
        }

        def switched(_) -> None:
            for slider in self._sliders.values():
                slider.visible = self._box.value
            changed()

        self._box.on_update(switched)
        for slider in self._sliders.values():
            slider.on_update(lambda _: changed())

    @property
    def on(self) -> bool:
        return self._box.value

    def values(self) -> dict[str, Value]:
        return self._fixed | {name: Value(float(s.value)) for name, s in self._sliders.items()}


def interval(parameter: Parameter, value: float, range_kpa: float) -> tuple[float, float]:
    """Between which values a parameter may be moved by hand: its bounds, or a decade about it."""
    _, low, high = parameter.limits(range_kpa)
    if parameter.log:
        low, high = max(low, value / DECADES), min(high, value * DECADES)
    return min(low, value), max(high, value)


def _slider(gui, parameter: Parameter, value: Value, range_kpa: float, visible: bool):
    low, high = interval(parameter, value.value, range_kpa)
    known = "" if value.ci95 is None else " Fitted: 95 % interval {:.4g} to {:.4g}.".format(*value.ci95)
    step = float(10.0 ** np.floor(np.log10((high - low) / STEPS)))
    name = parameter.name.removesuffix("_" + parameter.name.rpartition("_")[2]) if parameter.unit else ""
    unit = f"{name or parameter.name}, {parameter.unit or 'ratio'}".replace("_", " ")
    hint = f"From {low:.4g} to {high:.4g} {parameter.unit}.{known}"
    return gui.add_slider(unit, low, high, step, float(value.value), hint=hint, visible=visible)
