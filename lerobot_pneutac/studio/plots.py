"""Small line charts of the studio, redrawn many times a second."""

import numpy as np
import viser
from viser import uplot

GRID, INK = "rgba(122, 135, 148, 0.25)", "#7a8794"


class Lines:
    """Lines over a common axis, each with a scale of its own where their units differ.

    Args:
        gui: of the viewer.
        x: name of the axis, with its unit.
        lines: name with unit, and colour, of each.
        height: in px.
        one_scale: name of the scale that all lines share; empty where each has its own.
        now: colour of a cursor at the present moment; empty for none.
    """

    def __init__(
        self, gui: viser.GuiApi, x: str, lines: tuple, height: int = 160, one_scale: str = "", now: str = ""
    ):
        names = [one_scale or name for name, _ in lines]
        series = [uplot.Series(label=x)]
        for (name, colour), scale in zip(lines, names, strict=True):
            series.append(
                uplot.Series(label=name, stroke=colour, width=1.5, scale=scale, points={"show": False})
            )
        if now:
            quiet = {"show": False}
            series.append(uplot.Series(label="now", stroke=now, width=1.5, scale=names[0], points=quiet))
        axes = [uplot.Axis(stroke=INK, grid={"stroke": GRID}, size=30)]
        for k, scale in enumerate(dict.fromkeys(names)):
            axes.append(uplot.Axis(
                scale=scale, label=scale, stroke=INK, side=3 if k == 0 else 1, size=48, labelSize=18,
                grid={"stroke": GRID, "show": k == 0},
            ))  # fmt: skip
        data = (np.array([0.0, 1.0]), *(np.full(2, np.nan) for _ in series[1:]))
        scales = {"x": {"time": False}} | {s: {"auto": True} for s in names}
        self._plot = gui.add_uplot(
            data,
            tuple(series),
            scales=scales,
            axes=tuple(axes),
            height=height,
            legend={"show": True},
            padding=(10, 24, 0, 0),
        )

    def show(self, x: np.ndarray, *lines: np.ndarray, now: float | None = None) -> None:
        """Draws lines (n,) over x (n,), and a cursor at x = `now`."""
        if now is not None:  # a line with one peak, for a gap would take the axis its range
            cursor = np.full(len(x), min(v.min() for v in lines))
            cursor[np.argmin(np.abs(x - now))] = max(v.max() for v in lines)
            lines = (*lines, cursor)
        self._plot.data = tuple(np.asarray(v, np.float64) for v in (x, *lines))
