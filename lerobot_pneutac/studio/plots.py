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
        one_scale: whether all lines share the first one's scale, named `one_scale`.
    """

    def __init__(self, gui: viser.GuiApi, x: str, lines: tuple, height: int = 160, one_scale: str = ""):
        names = [one_scale or name for name, _ in lines]
        series = [uplot.Series(label=x)]
        for (name, colour), scale in zip(lines, names, strict=True):
            series.append(
                uplot.Series(label=name, stroke=colour, width=1.5, scale=scale, points={"show": False})
            )
        axes = [uplot.Axis(stroke=INK, grid={"stroke": GRID}, size=30)]
        for k, scale in enumerate(dict.fromkeys(names)):
            axes.append(uplot.Axis(
                scale=scale, label=scale, stroke=INK, side=3 if k == 0 else 1, size=48, labelSize=18,
                grid={"stroke": GRID, "show": k == 0},
            ))  # fmt: skip
        data = tuple(np.array([0.0, 1.0]) for _ in series)
        scales = {"x": {"time": False}} | {s: {"auto": True} for s in names}
        self._plot = gui.add_uplot(
            data, tuple(series), scales=scales, axes=tuple(axes), height=height, legend={"show": True}
        )

    def show(self, x: np.ndarray, *lines: np.ndarray) -> None:
        """Draws lines (n,) over x (n,); NaN is a gap."""
        self._plot.data = tuple(np.asarray(v, np.float64) for v in (x, *lines))
