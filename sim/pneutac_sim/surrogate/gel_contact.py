"""Contacts of the gel: an indenter, anywhere and tilted, for the probe grid and for MPM alike.

A contact is a `Press` turned about its tip. Both descriptions of it are made here side by side, the shapes of
the probe grid (which the environment's objects are made of) and the loads of the material points.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from pneutac_sim.gel.indenter import INDENTERS, Press
from pneutac_sim.gel.probe import probe_grid
from pneutac_sim.mpm.devices import press_loads
from pneutac_sim.mpm.loads import Loads

SIZE_MM = {
    "sphere": (1.5, 5.0),
    "cylinder": (1.0, 4.0),
    "cube": (2.0, 7.0),
    "edge": (3.0, 9.0),
    "cone": (2.5, 5.0),
}
DEPTH_MM = (1.1, 2.0)
SHALLOW_MM, SHALLOW_SHARE = (0.1, 0.8), 0.15  # the mean of all depths is 1.4 mm
TILT_RAD, TILT_SHARE = np.radians(12), 0.5
RIM_SHARE = 0.25  # of contacts whose centre lies within 1 mm of the window's rim, on either side


@dataclass(frozen=True)
class Contact:
    """One indenter pressed into the gel.

    Attributes:
        press: indenter, size, place, depth of its deepest point, and yaw.
        tilt_rad: turn of the indenter about its tip.
        tilt_towards_rad: direction of the axis of that turn, from x towards y.
    """

    press: Press
    tilt_rad: float = 0.0
    tilt_towards_rad: float = 0.0

    @property
    def _tilt(self) -> Rotation:
        a = self.tilt_towards_rad
        return Rotation.from_rotvec(self.tilt_rad * np.array([np.cos(a), np.sin(a), 0.0]))

    @cached_property
    def _raised_m(self) -> float:
        """How far a tilted indenter is drawn back, for its deepest point to lie as deep as before."""
        if self.tilt_rad == 0:
            return 0.0
        flat = replace(self.press, x_mm=0.0, y_mm=0.0)
        shapes = self._turned(flat.shapes(), flat)
        deepest = probe_grid(*shapes, window_mm=(24.0, 24.0), thickness_mm=50.0, shape=(240, 240)).max()
        return 1e-3 * max(float(deepest) - flat.depth_mm, 0.0)

    def _turned(self, shapes, press: Press):
        kinds, sizes, positions, rotations = shapes
        tip = 1e-3 * np.array([press.x_mm, press.y_mm, -press.depth_mm])
        turn = self._tilt
        return (
            kinds,
            sizes,
            [tip + turn.apply(np.asarray(p) - tip) for p in positions],
            [turn.as_matrix() @ r for r in rotations],
        )

    def shapes(self) -> tuple:
        """`kinds, sizes, positions, rotations` for `probe_grid`, in metres."""
        kinds, sizes, positions, rotations = self._turned(self.press.shapes(), self.press)
        return kinds, sizes, [p + [0, 0, self._raised_m] for p in positions], rotations

    def loads(self) -> Loads:
        """The same indenter for the material points."""
        loads = press_loads(self.press)
        return replace(
            loads,
            position_m=loads.position_m + [0, 0, self._raised_m],
            rotation=self._tilt.as_matrix() @ loads.rotation,
        )

    def at(self, depth_mm: float) -> "Contact":
        return replace(self, press=replace(self.press, depth_mm=depth_mm))


def random_contact(seed: int, number: int, window_mm: tuple[float, float]) -> Contact:
    """Contact `number` of the series `seed`, the same whatever others there are; the indenters take turns."""
    rng = np.random.default_rng([seed, number])
    indenter = INDENTERS[number % len(INDENTERS)]
    shallow, rim, tilted = rng.random(3) < (SHALLOW_SHARE, RIM_SHARE, TILT_SHARE)
    place = rng.uniform(-0.4, 0.4, 2) * window_mm
    if rim:
        side = rng.integers(2)
        place[side] = rng.choice([-1, 1]) * (window_mm[side] / 2 + rng.uniform(-1, 1))
    press = Press(
        indenter,
        float(rng.uniform(*SIZE_MM[indenter])),
        *(float(v) for v in place),
        float(rng.uniform(*(SHALLOW_MM if shallow else DEPTH_MM))),
        float(rng.uniform(-np.pi, np.pi)),
    )
    tilt, towards = rng.uniform(0, TILT_RAD), rng.uniform(-np.pi, np.pi)
    return Contact(press, float(tilt) if tilted else 0.0, float(towards))
