"""The body by its material points at the pressure of the sliders, drawn as points or as splats."""

from collections.abc import Callable, Mapping

import numpy as np

from lerobot_pneutac.studio.body_scene import BodyScene
from lerobot_pneutac.studio.solid import Solid, solve
from pneutac_sim.errors import InputError
from pneutac_sim.progress import Progress
from pneutac_sim.twin import Twin

DRAWN = POINTS, SPLATS = "points, coloured by stretch", "splats, in its own looks where it has any"


class SolidPanel:
    """A button that solves, and what came of it until something moves.

    Args:
        studio: that it is a part of.
        scene: picture of the body.
        begin: called before: makes the picture the page's own.
        now: twin, pressures (chambers,) in kPa and conditions at present.
    """

    def __init__(
        self,
        studio,
        scene: BodyScene,
        begin: Callable[[], None],
        now: Callable[[], tuple[Twin, np.ndarray, Mapping[str, float]]],
    ):
        self._studio, self._scene, self._begin, self._now = studio, scene, begin, now
        self._solid: Solid | None = None
        gui = studio.server.gui
        button = gui.add_button("Solve by material points", icon="grid-dots")
        button.on_click(studio.safely(self.solve))
        self._drawn = gui.add_dropdown("drawn as", DRAWN)
        self._drawn.on_update(lambda _: self._draw())
        self.told = gui.add_markdown("", visible=False)

    def solve(self) -> None:
        """The free body at rest at this pressure, without the poke."""

        def show(text: str, done: int, total: int) -> None:
            self.told.content = f"Solving by material points: {done} of {total} ({text})"

        def work(progress: Progress) -> None:
            try:
                self._solid = found = solve(*self._now(), progress)
            except InputError as e:
                self.told.visible = False
                self._studio.say(str(e))
                return
            self._draw()
            x, y, z = found.tip_mm
            self.told.content = (
                f"{len(found.points_mm)} material points: tip at x {x:.1f}, y {y:.1f}, z {z:.1f} mm, "
                f"stretched by {100 * found.most_strain:.1f} % at most"
            )

        self._begin()
        self._studio.session.begin("solving by material points", work, show)
        self.told.content, self.told.visible = "Solving by material points ...", True

    def _draw(self) -> None:
        if self._solid is not None:
            self._scene.show_solid(self._solid, splats=self._drawn.value == SPLATS)

    def hide(self) -> None:
        self._solid, self.told.visible = None, False
        self._scene.hide_solid()
