"""Indenters of any form: a flat punch with a polygon for its outline, or triangles from a file.

Of either only the lower side matters: its height h(x, y) over its lowest point, infinite outside it. Frame: x
and y as the gel's, z away from the sensor, the origin at the contact's centre in x and y.
"""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import trimesh
from numba import njit
from scipy.spatial import cKDTree

from pneutac_sim.errors import InputError
from pneutac_sim.mesh_file import load_mesh

FINE = 96  # points along either side of a mesh's box, at which its reach is found
NARROWEST_MM = 0.2
SPOTS = 40_000  # on a mesh, from which distances are measured


@dataclass(frozen=True)
class Outline:
    """A flat punch.

    Attributes:
        corners_mm: (n, 2), in order; the polygon is closed by itself.

    Raises:
        InputError: fewer than three corners, one that is no number, a side that crosses another, no area, or
            the contact's centre outside.
    """

    corners_mm: tuple[tuple[float, float], ...]

    def __post_init__(self):
        corners = np.asarray(self.corners_mm, float)
        if corners.ndim != 2 or corners.shape[1] != 2 or len(corners) < 3 or not np.isfinite(corners).all():
            raise InputError("outline_mm must be three corners or more, x and y in mm each.")
        object.__setattr__(self, "corners_mm", tuple(map(tuple, corners.tolist())))
        crossing = _crossing(corners)
        if crossing:
            raise InputError(f"outline_mm crosses itself: side {crossing[0]} meets side {crossing[1]}.")
        x, y = corners.T
        if abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) < 1e-6:
            raise InputError("outline_mm encloses no area.")
        _check_centred(corners, "outline_mm")

    @classmethod
    def of_text(cls, text: str) -> "Outline":
        """From `x y; x y; ...` in mm.

        Raises InputError where it is no such text, or no outline.
        """
        try:
            corners = [tuple(float(v) for v in corner.split()) for corner in text.strip(" ;").split(";")]
        except ValueError:
            corners = []
        if not corners or {len(c) for c in corners} != {2}:
            raise InputError(
                f"outline_mm is '{text[:40]}'; give corners in mm, x y; x y; x y, as in 0 2; 2 -1; -2 -1."
            )
        return cls(tuple(corners))

    @property
    def reach_mm(self) -> float:
        """Distance from the centre to the farthest corner."""
        return float(np.linalg.norm(self.corners_mm, axis=1).max())

    def radius_mm(self, depth_mm: float) -> float:
        """Largest distance from the centre at which it touches."""
        return self.reach_mm

    def height_mm(self, x_mm: np.ndarray, y_mm: np.ndarray) -> np.ndarray:
        """0 inside the outline, infinite outside it; same shape as the places."""
        corners = np.asarray(self.corners_mm)
        inside = np.zeros(np.shape(x_mm), bool)
        for (ax, ay), (bx, by) in zip(corners, np.roll(corners, -1, 0), strict=True):
            if ay != by:
                across = ax + (y_mm - ay) * (bx - ax) / (by - ay)
                inside ^= ((ay > y_mm) != (by > y_mm)) & (x_mm < across)
        return np.where(inside, 0.0, np.inf)

    def distance_mm(self, points_mm: np.ndarray) -> np.ndarray:
        """(n,) signed distance to points (n, 3), negative inside; it goes up without an end."""
        x, y, z = points_mm.T
        corners = np.asarray(self.corners_mm)
        aside = np.full(len(points_mm), np.inf)
        for a, side in zip(corners, np.roll(corners, -1, 0) - corners, strict=True):
            p = points_mm[:, :2] - a
            along = np.clip(p @ side / (side @ side), 0, 1)
            aside = np.minimum(aside, np.linalg.norm(p - along[:, None] * side, axis=1))
        aside = np.where(self.height_mm(x, y) == 0, -aside, aside)
        both = np.stack([aside, -z], 1)
        return np.linalg.norm(both.clip(0), axis=1) + both.max(1).clip(None, 0)


@dataclass(frozen=True, eq=False)
class Figure:
    """Triangles, whose lowest point goes deepest.

    Attributes:
        triangles_mm: (n, 3, 3) corners.
        name: for messages.

    Raises:
        InputError: the contact's centre lies outside its box in x and y, or it is as flat as a line.
    """

    triangles_mm: np.ndarray
    name: str = "the mesh"
    _radii: tuple = field(init=False, repr=False)

    def __post_init__(self):
        triangles = np.array(self.triangles_mm, float)
        triangles[..., 2] -= triangles[..., 2].min()
        object.__setattr__(self, "triangles_mm", triangles)
        corners = triangles.reshape(-1, 3)
        low, high = corners[:, :2].min(0), corners[:, :2].max(0)
        if (high - low < NARROWEST_MM).any():
            raise InputError(
                f"{self.name} is {high[0] - low[0]:.3g} x {high[1] - low[1]:.3g} mm wide; give it in mm."
            )
        _check_centred(corners[:, :2], self.name)
        axes = [np.linspace(a, b, FINE) for a, b in zip(low, high, strict=True)]
        x, y = np.meshgrid(*axes)
        height, r = self.height_mm(x, y).ravel(), np.hypot(x, y).ravel()
        order = np.argsort(height)
        object.__setattr__(self, "_radii", (height[order], np.maximum.accumulate(r[order])))

    @classmethod
    def read(cls, file: Path) -> "Figure":
        """From an STL, OBJ or PLY file in mm; see `mesh_file.load_mesh`."""
        return cls(load_mesh(file).triangles, str(file))

    @property
    def reach_mm(self) -> float:
        """Of its farthest point from the centre, seen along z."""
        return float(np.linalg.norm(self.triangles_mm[..., :2], axis=-1).max())

    def radius_mm(self, depth_mm: float) -> float:
        """How far from the centre it touches a plane so deep."""
        heights, radii = self._radii
        return float(radii[max(int(np.searchsorted(heights, depth_mm)) - 1, 0)])

    def height_mm(self, x_mm: np.ndarray, y_mm: np.ndarray) -> np.ndarray:
        """Of its lower side, infinite outside it; same shape as the places."""
        x, y = np.ascontiguousarray(x_mm, float).ravel(), np.ascontiguousarray(y_mm, float).ravel()
        out = np.full(len(x), np.inf)
        _lowest(self.triangles_mm, x, y, out)
        return out.reshape(np.shape(x_mm))

    def distance_mm(self, points_mm: np.ndarray) -> np.ndarray:
        """(n,) signed distance to points (n, 3), negative above the lower side."""
        far = surface_distance(self.triangles_mm, points_mm)
        inside = points_mm[:, 2] > self.height_mm(points_mm[:, 0], points_mm[:, 1])
        return np.where(inside, -far, far)


AnyFigure = Outline | Figure


def surface_distance(triangles: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(n,) mm from triangles (m, 3, 3) to points (n, 3), to that of the nearest of many spots on them."""
    corners = np.arange(3 * len(triangles)).reshape(-1, 3)
    mesh = trimesh.Trimesh(triangles.reshape(-1, 3), corners, process=False)
    spots, faces = trimesh.sample.sample_surface(mesh, SPOTS, seed=0)
    nearest = faces[cKDTree(spots).query(points)[1]]
    return np.linalg.norm(points - trimesh.triangles.closest_point(triangles[nearest], points), axis=1)


def _check_centred(corners: np.ndarray, what: str) -> None:
    low, high = corners.min(0), corners.max(0)
    if (low > 0).any() or (high < 0).any():
        raise InputError(
            f"{what} lies wholly beside its origin (x {low[0]:.3g} to {high[0]:.3g}, y {low[1]:.3g} to "
            f"{high[1]:.3g} mm), which is the contact's centre; shift it."
        )


def _crossing(corners: np.ndarray) -> tuple[int, int] | None:
    """Numbers, from 1, of two sides that meet without being neighbours; None where there are none."""
    n, ends = len(corners), np.roll(corners, -1, 0)

    def side(a, b, p):
        return np.sign((b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]))

    for i in range(n):
        for j in range(i + 2, n - (i == 0)):
            a, b, c, d = corners[i], ends[i], corners[j], ends[j]
            if side(a, b, c) * side(a, b, d) <= 0 and side(c, d, a) * side(c, d, b) <= 0:
                low = np.maximum(np.minimum(a, b), np.minimum(c, d))
                if (low <= np.minimum(np.maximum(a, b), np.maximum(c, d))).all():
                    return i + 1, j + 1
    return None


@njit(cache=True)
def _lowest(triangles, x, y, out):
    """Lowest z of the triangles over each place (n,), into `out`."""
    for t in triangles:
        ax, ay, az = t[0]
        ux, uy, uz = t[1, 0] - ax, t[1, 1] - ay, t[1, 2] - az
        vx, vy, vz = t[2, 0] - ax, t[2, 1] - ay, t[2, 2] - az
        det = ux * vy - uy * vx
        if abs(det) < 1e-12:
            continue
        x0, x1 = min(ax, t[1, 0], t[2, 0]), max(ax, t[1, 0], t[2, 0])
        y0, y1 = min(ay, t[1, 1], t[2, 1]), max(ay, t[1, 1], t[2, 1])
        for i in range(len(x)):
            if x[i] < x0 or x[i] > x1 or y[i] < y0 or y[i] > y1:
                continue
            px, py = x[i] - ax, y[i] - ay
            p, q = (px * vy - py * vx) / det, (ux * py - uy * px) / det
            if p >= -1e-9 and q >= -1e-9 and p + q <= 1 + 1e-9:
                out[i] = min(out[i], az + p * uz + q * vz)
