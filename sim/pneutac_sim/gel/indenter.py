"""Indenters of bench recordings: the shapes that the environment's objects are made of, and any other.

Indenters of any form: a flat punch with a polygon for its outline, or triangles from a file.

Of either only the lower side matters: its height h(x, y) over its lowest point, infinite outside it. Frame: x
and y as the gel's, z away from the sensor, the origin at the contact's centre in x and y.
"""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import trimesh
from numba import njit
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from pneutac_sim.errors import InputError, check_choice, shown
from pneutac_sim.files import inside, refuse_pointer
from pneutac_sim.gel.probe import BOX, COLS, CONE, CYLINDER, ROWS, SPHERE, THICKNESS_MM, WINDOW_MM, probe_grid

FORMATS = (".stl", ".obj", ".ply")
MOST_BYTES = 200 * 2**20
MOST_FACES = 200_000  # finer than particles resolve, and a twin should stay small
FINE = 96  # points along either side of a mesh's box, at which its reach is found
NARROWEST_MM = 0.2
SPOTS = 40_000  # on a mesh, from which distances are measured


@dataclass(frozen=True)
class Outline:
    """A flat punch.

    Raises InputError: fewer than three corners, one that is no number, a side that crosses another, no area,
    or the contact's centre outside.
    """

    corners_mm: tuple[tuple[float, float], ...]  # (n, 2), in order; the polygon is closed by itself

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

    Raises InputError: the contact's centre lies outside its box in x and y, or it is as flat as a line.
    """

    triangles_mm: np.ndarray  # (n, 3, 3) corners
    name: str = "the mesh"  # for messages
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
    def read(cls, file: Path, within: Path | None = None) -> "Figure":
        """From an STL, OBJ or PLY file in mm; see `load_mesh`."""
        return cls(load_mesh(file, within).triangles, str(file))

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


def load_mesh(file: Path, within: Path | None = None) -> trimesh.Trimesh:
    """The triangles of an STL, OBJ or PLY file, as they are.

    Raises InputError where there is none, it is no mesh, too large, or outside the recording `within`.
    """
    if within is not None and not inside(within, file):
        raise InputError(f"{shown(str(file))} lies outside the recording's folder; copy it there.")
    if not file.is_file():
        raise InputError(f"There is no mesh '{file}'; give an STL, OBJ or PLY file.")
    if file.suffix.lower() not in FORMATS:
        raise InputError(f"{file} is no mesh that can be read here; export it as STL, OBJ or PLY.")
    if file.stat().st_size > MOST_BYTES:
        raise InputError(f"{file} is larger than {MOST_BYTES // 2**20} MB; simplify it.")
    refuse_pointer(file)
    try:
        mesh = trimesh.load_mesh(file, process=False, skip_materials=True)  # no other file is opened
    except Exception as e:
        raise InputError(f"{file} cannot be read as a mesh ({e}); export it again as STL, OBJ or PLY.") from e
    if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
        raise InputError(f"{file} holds no triangles: it is empty, cut short or no mesh; export it again.")
    if not np.isfinite(mesh.vertices).all():
        raise InputError(f"{file} has vertices that are not finite numbers; export it again.")
    if len(mesh.faces) > MOST_FACES:
        raise InputError(f"{file} has {len(mesh.faces)} triangles; simplify it to at most {MOST_FACES}.")
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


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
            f"{what} does not contain its origin (x {low[0]:.3g} to {high[0]:.3g}, y {low[1]:.3g} to "
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


INDENTERS = ("sphere", "cylinder", "cube", "edge", "cone")
FIGURES = ("outline", "mesh")


@dataclass
class Press:
    """One indenter pressed into the gel, gel frame."""

    # `sphere`; `cylinder` standing on its flat end; `cube` on a face; `edge`, a cube on one of its edges,
    # which lies along x; `cone` on its apex, with a right angle of opening; `outline` and `mesh` as their
    # figure says
    indenter: str
    # radius of sphere, cylinder or the cone's base; side of cube and edge; of a figure how far it reaches
    # from its centre, which is filled in
    size_mm: float
    x_mm: float  # position of the contact centre along image columns, from the window's centre
    y_mm: float  # along image rows
    depth_mm: float  # how deep the lowest point lies below the resting surface, before it leans
    yaw_rad: float = 0.0  # turn about z, from x towards y
    figure: AnyFigure | None = None  # of `outline` and `mesh`, none of the others
    tilt_x_rad: float = 0.0  # how far it leans about the contact's centre, deeper at larger x; small
    tilt_y_rad: float = 0.0  # the same, deeper at larger y

    def __post_init__(self):
        check_choice("indenter", self.indenter, INDENTERS + FIGURES)
        if (self.indenter in FIGURES) != (self.figure is not None):
            raise InputError(
                f"An indenter '{self.indenter}' {'needs a' if self.figure is None else 'has no'} figure."
            )
        if self.figure is not None:
            self.size_mm = self.figure.reach_mm
        for name in ("size_mm", "depth_mm"):
            if not 0 < getattr(self, name) <= 1000:
                raise InputError(
                    f"{name} of the {self.indenter} is {getattr(self, name)}; give millimetres above zero, at"
                    " most 1000."
                )

    @property
    def contact_radius_mm(self) -> float:
        """Nominal contact radius: Hertz' sqrt(R d) for a sphere, else that of the touching figure."""
        s, d = self.size_mm, self.depth_mm
        if self.figure is not None:
            return self.figure.radius_mm(d)
        radii = {"sphere": np.sqrt(s * d), "cylinder": s, "cube": s / np.sqrt(2), "edge": s / 2}
        return (radii | {"cone": min(d, s)})[self.indenter]

    @property
    def turn(self) -> Rotation:
        """From the upright indenter's frame to the gel's, about the contact's centre."""
        lean = Rotation.from_rotvec([-self.tilt_y_rad, self.tilt_x_rad, 0.0])
        return lean * Rotation.from_euler("z", self.yaw_rad)

    def depths(
        self,
        window_mm: tuple[float, float] = WINDOW_MM,
        thickness_mm: float = THICKNESS_MM,
        shape: tuple[int, int] = (ROWS, COLS),
    ) -> np.ndarray:
        """Probe grid of this indenter, float32 `shape` in mm; arguments as of `probe_grid`."""
        if self.figure is None:
            return probe_grid(*self.shapes(), window_mm=window_mm, thickness_mm=thickness_mm, shape=shape)
        x, y = (
            (np.arange(n) + 0.5) * size / n - size / 2 - at
            for n, size, at in zip(shape[::-1], window_mm, (self.x_mm, self.y_mm), strict=True)
        )
        c, s = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        x, y = np.meshgrid(x, y)
        lean = np.tan(self.tilt_x_rad) * x + np.tan(self.tilt_y_rad) * y
        below = self.depth_mm + lean - self.figure.height_mm(c * x + s * y, c * y - s * x)
        return below.clip(0, thickness_mm).astype(np.float32)

    def shapes(self) -> tuple:
        """`kinds, sizes, positions, rotations` for `probe_grid`, in metres.

        Raises InputError: a figure is made of no such shapes; `depths` knows it.
        """
        if self.figure is not None:
            raise InputError(f"An indenter '{self.indenter}' is made of none of the shapes {INDENTERS}.")
        s, tilt = self.size_mm, Rotation.identity()
        if self.indenter == "sphere":
            kind, size, low = SPHERE, (s, 0, 0), s
        elif self.indenter == "cylinder":
            kind, size, low = CYLINDER, (s, 5.0, 0), 5.0
        elif self.indenter == "cone":
            kind, size, low = CONE, (s, s / 2, 0), s / 2
        else:
            kind, size, low = BOX, (s / 2, s / 2, s / 2), s / 2
            if self.indenter == "edge":
                tilt, low = Rotation.from_euler("x", np.pi / 4), s / np.sqrt(2)
        position = np.array([self.x_mm, self.y_mm, -self.depth_mm]) + self.turn.apply([0.0, 0.0, low])
        return [kind], [np.array(size) * 1e-3], [position * 1e-3], [(self.turn * tilt).as_matrix()]
