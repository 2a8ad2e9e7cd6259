"""What the camera tracker is shown and what it makes of it."""

from dataclasses import dataclass

import numpy as np

from pneutac_truths.world import Body, World

TIP = ["tip_x_mm", "tip_y_mm", "tip_z_mm"]
CURVATURES = ["curvature_x_1_per_m", "curvature_y_1_per_m"]
UNSEEN = {"stretch", "camera_warm_up"}  # no curvature shows them, so such a device is logged by its marker


def logged(body: Body, names) -> tuple[list[str], float]:
    """Columns of the pose in this device's log, and the standard deviation of their noise."""
    if body.curvatures and not UNSEEN & set(names):
        return CURVATURES, 2e3 * body.noise_mm / body.length_mm**2
    return TIP, body.noise_mm


def in_columns(body: Body, columns: list[str], tips: np.ndarray) -> np.ndarray:
    """Marker (rows, 3) in mm as the values of these columns (rows, columns)."""
    return curvatures(tips, body.length_mm) if columns == CURVATURES else tips


def curvatures(tips: np.ndarray, length_mm: float) -> np.ndarray:
    """Constant-curvature reading (rows, 2) in 1/m of marker positions: bend towards z and towards y.

    Source: Webster and Jones, IJRR 29 (2010) 1661: the chord lies at half the bend angle.
    """
    aside = np.hypot(tips[:, 1], tips[:, 2])
    bend = 2 * np.arctan2(aside, tips[:, 0])
    return (bend / np.maximum(aside, 1e-12) / length_mm * 1e3)[:, None] * tips[:, [2, 1]]


@dataclass
class Seen:
    """The marker on its way into the log.

    Attributes:
        world: whose marker it is.
        path: (m, 3) mm on the fine grid of all trials without pauses, or on the recorded rows alone.
        fine: whether `path` is on the fine grid.
        late_s: (rows,) by how much each sample is taken after its stamp.
        tips: (rows, 3) mm as logged, before noise; None until `sample`.
        frozen: (rows,) that repeat the row before, noise and all.
    """

    world: World
    path: np.ndarray
    fine: bool
    late_s: np.ndarray
    frozen: np.ndarray
    tips: np.ndarray | None = None

    def trials(self, x: np.ndarray) -> list[np.ndarray]:
        """The pieces of x (m, ...) that belong to each trial on the fine grid."""
        p = self.world.plan
        lengths = [b - a for a, b in zip(p.starts, p.ends, strict=True)]
        return np.split(x, np.cumsum(lengths)[:-1])

    def sample(self) -> None:
        """Takes `tips` from `path` at the stamps plus `late_s`."""
        if not self.fine:
            self.tips = self.path.copy()
            return
        p = self.world.plan
        late = np.split(self.late_s, np.flatnonzero(np.diff(p.trial[p.rows])) + 1)
        out = []
        for piece, a, b, by in zip(self.trials(self.path), p.starts, p.ends, late, strict=True):
            t = p.time_s[a:b]
            at = p.time_s[p.rows[(p.rows >= a) & (p.rows < b)]] + by
            out.append(np.stack([np.interp(at, t, piece[:, k]) for k in range(3)], 1))
        self.tips = np.concatenate(out)
