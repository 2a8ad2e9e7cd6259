"""The gel's force as a spring for a world, quickly: `gel.force` on some eighty cells that follow the contact.

A point load on the layer moves its face at a distance r as on a half-space, (1 - nu) / (2 pi G r), less what
the backing holds back, which is smooth and tabulated. The contact is solved on a matrix of cells along the
contact's principal axes, at the present depth and at one a little deeper; force and slope give

    F = k1 x + k3 x^3

for a face pressed by x: a flat end has k1 alone, a ball and an edge both.
"""

import functools
import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.special import j0

from pneutac_sim.gel.force import RIM, RIM_SHARE, STICKS, GelForce, compliance
from pneutac_sim.gel.probe import NO_TRIANGLES, probe_grid

CELLS = 80  # that carry pressure, about
FINE = 3  # depths a cell along each edge
ASPECTS = 4, 2, 1  # of a cell
MOST = 96  # cells along an edge: a few distant points would need finer ones
LOOK = (40, 30)  # rows and columns of the first look, which finds where and how large the contact is
REACH_MM = 8.0  # how far before the face an object is seen
LEAST_MM, DEEPEST_MM, FURTHER = 0.3, 2.0, 1.25  # depths at which a spring is fitted, and the second's ratio
ITERATIONS, TOLERANCE = 30, 2e-3  # of conjugate gradients; largest gap or overlap, relative to the depth
FAR_MM, STEP_MM = 30.0, 0.05  # of the table of a point load's reach


@dataclass(frozen=True)
class Spring:
    """Force F = k1 x + k3 x^3 of a gel whose face is pressed in by x."""

    k1: float  # N/m, 0 or more
    k3: float  # N/m^3, 0 or more
    depth_m: float  # at which it was fitted, m

    def force(self, x_m: float) -> float:
        """F in N."""
        return self.k1 * x_m + self.k3 * x_m**3

    def slope(self, x_m: float) -> float:
        """dF/dx in N/m."""
        return self.k1 + 3 * self.k3 * x_m**2


class GelSpring:
    """Springs of a gel with this law; `triangles` are those of objects that are meshes, see `probe_grid`."""

    def __init__(self, law: GelForce, triangles: np.ndarray = NO_TRIANGLES):
        self._triangles = triangles
        G, nu, self._thickness = law.shear_modulus_mpa, law.poissons_ratio, law.thickness_mm
        self._window = law.window_mm
        self._near = {a: (1 - nu) / (2 * np.pi * G) * _near(a) for a in ASPECTS}
        self._hidden = _hidden(self._thickness, nu) / G

    def of(self, kinds, sizes, positions, rotations, gel_position, gel_rotation) -> Spring | None:
        """The spring with the law's force and slope for the objects under or before the face.

        They are taken at their present depth, at `LEAST_MM` of it where they are less deep; arguments as of
        `probe_grid`. None where nothing is near.
        """
        shapes, R = (kinds, sizes, positions, rotations), np.asarray(gel_rotation).reshape(3, 3)
        first = self._look(shapes, gel_position, R, np.zeros(2), self._window, LOOK)
        deepest = float(first.max())
        if deepest <= -REACH_MM:
            return None
        x = min(max(deepest, LEAST_MM), DEEPEST_MM)
        turn, middle, extent, size, aspect = _place(first > deepest - FURTHER * x, self._window)
        nx, ny = (max(1, math.ceil(e / h - 1e-6)) for e, h in zip(extent, (aspect * size, size), strict=True))
        window, shape = (nx * aspect * size, ny * size), (FINE * ny, FINE * nx)
        box = self._look(shapes, gel_position, R @ turn, middle, window, shape)
        deepest, near = float(box.max()), self._near[aspect]
        held = _held(ny, nx, size, aspect, turn[0, 0], turn[1, 0], middle, *self._window, self._thickness)
        layer, load = (self._hidden, self._thickness, held), np.zeros(ny * nx)
        here = _force(box, x - deepest, size, aspect, near, *layer, load)
        there = _force(box, FURTHER * x - deepest, size, aspect, near, *layer, load)
        power = min(max(math.log(there / here) / math.log(FURTHER), 1.0), 3.0)  # F ~ x^power
        x, secant = 1e-3 * x, here / (1e-3 * x)
        return Spring(secant * (3 - power) / 2, secant * (power - 1) / 2 / x**2, x)

    def _look(self, shapes, gel_position, R, middle_mm, window_mm, shape) -> np.ndarray:
        """Depth (mm) round a point of the face; negative in front of it, -REACH_MM where nothing is."""
        at = gel_position + 1e-3 * (R @ (*middle_mm, REACH_MM))
        reach = self._thickness + REACH_MM
        return probe_grid(*shapes, at, R, window_mm, reach, shape, self._triangles) - REACH_MM


def _place(touched: np.ndarray, window_mm) -> tuple[np.ndarray, np.ndarray, np.ndarray, float, int]:
    """Where the touched cells (rows, columns) of a window lie: a box along their principal axes.

    Returns:
        its axes (3, 3), the longer one first; its middle (2,) and extent (2,) along them, mm; and of the
        cells that make `CELLS` of the touched area the shorter edge in mm, and how many times longer the
        other one is.
    """
    cell_x, cell_y = window_mm[0] / touched.shape[1], window_mm[1] / touched.shape[0]
    n, c, s, low_u, high_u, low_v, high_v = _box(touched, cell_x, cell_y)
    extent = np.array([high_u - low_u, high_v - low_v])
    aspect = next(a for a in ASPECTS if extent[0] > a * a * extent[1] / 2 or a == 1)
    size = max(math.sqrt(n * cell_x * cell_y / (CELLS * aspect)), *(extent / (aspect, 1) / MOST))
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return turn, 0.5 * np.array([low_u + high_u, low_v + high_v]), extent, size, aspect


@njit(cache=True)
def _box(touched, cell_x, cell_y):
    """Number of touched cells, cosine and sine of their longer axis, and their ends along both axes, mm."""
    rows, cols = touched.shape
    n, x, y, xx, yy, xy = 0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(rows):
        for j in range(cols):
            if touched[i, j]:
                u, v = (j + 0.5 - cols / 2) * cell_x, (i + 0.5 - rows / 2) * cell_y
                n, x, y, xx, yy, xy = n + 1, x + u, y + v, xx + u * u, yy + v * v, xy + u * v
    turn = 0.5 * math.atan2(2 * (xy - x * y / n), xx - x * x / n - yy + y * y / n)
    c, s = math.cos(turn), math.sin(turn)
    low_u, high_u, low_v, high_v = 1e9, -1e9, 1e9, -1e9
    for i in range(rows):
        for j in range(cols):
            if touched[i, j]:
                u, v = (j + 0.5 - cols / 2) * cell_x, (i + 0.5 - rows / 2) * cell_y
                a, b = c * u + s * v, c * v - s * u
                low_u, high_u, low_v, high_v = min(low_u, a), max(high_u, a), min(low_v, b), max(high_v, b)
    # Half of a cell's shadow on the axes.
    wide, high = 0.5 * (abs(c) * cell_x + abs(s) * cell_y), 0.5 * (abs(s) * cell_x + abs(c) * cell_y)
    return n, c, s, low_u - wide, high_u + wide, low_v - high, high_v + high


@functools.cache
def _near(aspect: int, count: int = MOST + 1) -> np.ndarray:
    """Mean of 1 / r over a cell `aspect` long and 1 wide, from the middles of its neighbours (Love 1929)."""
    x, y = np.indices((count, count)) * np.array([aspect, 1.0])[:, None, None]
    w, h = aspect / 2, 0.5

    def corner(u, v, less):  # u ln(v + |(u, v)|) less the same at `less`
        return u * np.log((v + np.hypot(u, v)) / (less + np.hypot(u, less)))

    whole = corner(x + w, y + h, y - h) + corner(y + h, x + w, x - w)
    return (whole + corner(x - w, y - h, y + h) + corner(y - h, x - w, x + w)).T / aspect


@functools.lru_cache(maxsize=8)
def _hidden(thickness_mm: float, poissons_ratio: float) -> np.ndarray:
    """What the backing takes off a half-space's sag at `STEP_MM` steps from a point load, G = 1, 1/mm."""
    z = np.linspace(1e-4, 15.0, 3000)  # k t; the difference falls like z^2 exp(-2 z)
    k = z / thickness_mm
    less = compliance(k, thickness_mm, poissons_ratio, 1.0) - (1 - poissons_ratio) / k
    r = np.arange(0.0, FAR_MM + STEP_MM, STEP_MM)
    return np.trapezoid(less * k * j0(np.outer(r, k)), k, axis=1) / (2 * np.pi)


@njit(cache=True, fastmath=True)
def _force(depth, shift, h, aspect, near, hidden, thickness, held, load):
    """N under `depth` + `shift` (mm), FINE^2 samples a cell; `load` (cells,) N begins and ends it."""
    rows, cols = depth.shape[0] // FINE, depth.shape[1] // FINE
    at_row, at_col = np.empty(rows * cols, np.int64), np.empty(rows * cols, np.int64)
    d, part, n = np.empty(rows * cols), np.empty(rows * cols), 0
    for i in range(rows):
        for j in range(cols):
            s, k = 0.0, 0
            for a in range(FINE):
                for b in range(FINE):
                    z = depth[FINE * i + a, FINE * j + b] + shift
                    s += max(z, 0.0)
                    k += z > 0.0
            if k > 0:
                at_row[n], at_col[n], d[n], part[n] = i, j, s / k, k / FINE**2
                n += 1
    # Per force, not per pressure: what is touched of a cell is a smaller square in its middle.
    table = np.empty((rows, cols))
    for i in range(rows):
        for j in range(cols):
            r = h * math.sqrt(i * i + (aspect * j) ** 2) / STEP_MM
            m = int(r)
            table[i, j] = near[i, j] / h + hidden[m] + (r - m) * (hidden[m + 1] - hidden[m])
    C, f = np.empty((n, n)), np.empty(n)
    for i in range(n):
        for j in range(n):
            C[i, j] = table[abs(at_row[i] - at_row[j]), abs(at_col[i] - at_col[j])]
        C[i, i] = near[0, 0] / (h * math.sqrt(part[i])) + hidden[0]
        f[i] = load[at_row[i] * cols + at_col[i]]
    if f.sum() == 0.0:
        for i in range(n):
            f[i] = d[i] * part[i]
    _contact(C, d[:n], f)
    total, squares, weighted, whole = 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        load[at_row[i] * cols + at_col[i]] = f[i]
        total += f[i]
        whole += f[i] * held[at_row[i] * cols + at_col[i]]
        squares += f[i] * f[i] / (part[i] * aspect * h * h)
        weighted += f[i] * d[i]
    radius = math.sqrt(total * total / squares / math.pi)
    return whole * (1.0 + STICKS * weighted / total * radius / thickness**2)


@njit(cache=True)
def _held(rows, cols, h, aspect, c, s, middle, width, height, thickness):
    """Share of each cell's force that the gel's free sides leave, (rows * cols,), see `gel.force.rim`."""
    out, fades = np.empty(rows * cols), RIM_SHARE * thickness
    for i in range(rows):
        for j in range(cols):
            u, v = middle[0] + (j + 0.5 - cols / 2) * aspect * h, middle[1] + (i + 0.5 - rows / 2) * h
            x, y = abs(c * u - s * v), abs(s * u + c * v)
            w = 1.0
            for at, half in ((x, width / 2), (y, height / 2)):
                w *= (1.0 - RIM * math.exp(min(at - half, 0.0) / fades)) * (
                    1.0 - RIM * math.exp(-(half + at) / fades)
                )
            out[i * cols + j] = w
    return out


@njit(cache=True, fastmath=True)
def _contact(C, d, p):
    """Pressure p >= 0 with gap C p - d >= 0 and one of them zero, by the steps of `GelForce`."""
    u = C @ p
    p *= np.dot(p, d) / np.dot(p, u)
    n, tolerance = len(d), TOLERANCE * d.max()
    g, t, before = np.empty(n), np.zeros(n), 0.0
    for _ in range(ITERATIONS):
        g = C @ p - d
        norm, worst = 0.0, 0.0
        for i in range(n):
            if p[i] > 0.0:
                norm += g[i] * g[i]
                worst = max(worst, abs(g[i]))
            else:
                worst = max(worst, -g[i])
        if worst < tolerance:
            break
        share = norm / before if before > 0.0 else 0.0
        for i in range(n):
            t[i] = g[i] + share * t[i] if p[i] > 0.0 else 0.0
        before = norm
        step = np.dot(t, C @ t)
        along = 0.0
        for i in range(n):
            along += t[i] * g[i]
        length = along / max(step, 1e-30)
        for i in range(n):
            p[i] = max(p[i] - length * t[i], 0.0)
        for i in range(n):
            if p[i] == 0.0 and g[i] < 0.0:  # joins, and the directions of search start afresh
                p[i], before = -length * g[i], 0.0
