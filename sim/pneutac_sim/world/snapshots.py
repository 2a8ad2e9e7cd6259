"""What the gel has before it in many states, so that they are felt together after the physics of all."""

import mujoco
import numpy as np

from pneutac_sim.gel.probe import COLS, ROWS, probe_grids
from pneutac_sim.world.touch import Touch


class Snapshots:
    """Poses of flange, gel and objects, one row a state; rows are kept and used again.

    Args:
        touch: of the world; in mode `area`.
        flange: id of the flange's site.

    Attributes:
        flange_m: (B, 3) flange positions, metres.
    """

    def __init__(self, touch: Touch, flange: int):
        self._touch, self._flange = touch, flange
        self.make_room(0)

    def make_room(self, count: int) -> None:
        """Rows for at least `count` states; what is in them is lost where they are too few."""
        n = len(self._touch.felt)
        self.flange_m, self._gel_m, self._gel = (
            np.empty((count, 3)),
            np.empty((count, 3)),
            np.empty((count, 9)),
        )
        self._objects_m, self._objects = np.empty((count, n, 3)), np.empty((count, n, 9))
        self._grids = np.empty((count, ROWS, COLS), np.float32)

    def take(self, row: int, data: mujoco.MjData) -> None:
        """Keeps the present state, whose kinematics must be up to date, in a row."""
        if row >= len(self.flange_m):
            raise ValueError(f"there is room for {len(self.flange_m)} states, and this is number {row + 1}")
        _, _, self._objects_m[row], self._objects[row], self._gel_m[row], self._gel[row] = (
            self._touch.objects(data)
        )
        self.flange_m[row] = data.site_xpos[self._flange]

    def feel(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Contact areas (count,) and probe grids (count, 80, 59) of the first rows, until the next call."""
        touch, gel = self._touch, self._touch.sensor.model
        depth = probe_grids(
            touch.kinds,
            touch.sizes,
            self._objects_m[:count],
            self._objects[:count],
            self._gel_m[:count],
            self._gel[:count],
            gel.window_mm,
            gel.thickness_mm,
            self._grids,
            touch.sensor.triangles,
        )
        return touch.sensor.areas(depth), depth
