"""Light of a touch sensor in the image plane: image = rest + w s, with s from the gel's surface.

The paper's photometric model (Sec. III-B) is s = L grad u + c_d u with w = 1; u is the surface displacement
in mm into the gel, that is towards the camera. Effects of the stage `light` bend it where they are on. Those
of the library are compiled into one kernel, which reads them from a row of coefficients a channel; those of
other packages change s after it.

s is computed on the displacement's own grid and interpolated to pixels, where w acts.

Numba's cache of this file does not see changes in the effects' files: delete `__pycache__` after one.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np
from numba import njit

from pneutac_sim.effects.near_light import PX, towards
from pneutac_sim.effects.photometric_nonlinearity import lambert
from pneutac_sim.effects.shadow import cast, darkened

# A channel's row: L x, L y, c_d, p x, p y (NaN: far away), phi (inf: linear), lambda, tan(elevation), edge;
# then the quadratic terms along the light, across it and in depth.
NEUTRAL = (0.0, 0.0, 0.0, np.nan, np.nan, np.inf, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
SIZE = len(NEUTRAL)

# Changes the light s of channel k under a displacement u: (k, s, u, cell_mm) -> s.
Further = Callable[[int, np.ndarray, np.ndarray, tuple[float, float]], np.ndarray]

_NO_SHADOW = np.zeros((1, 1), np.float32)


def gradient(displacement_mm: np.ndarray, cell_mm: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Slopes du/dx and du/dy (dimensionless), central differences, same shape as the displacement."""
    dy, dx = np.gradient(displacement_mm, cell_mm[1], cell_mm[0])
    return dx, dy


def upsample(grid: np.ndarray, height: int, width: int) -> np.ndarray:
    """Bilinear interpolation of cell values (rows, columns, ...) to pixels (height, width, ...), float32."""
    i, fy = _cells(height, grid.shape[0])
    j, fx = _cells(width, grid.shape[1])
    fy, fx = (f.reshape(-1, *(1,) * (grid.ndim - 1 - axis)) for axis, f in enumerate((fy, fx)))
    rows = grid[i] + fy * (grid[i + 1] - grid[i])
    return (rows[:, j] + fx * (rows[:, j + 1] - rows[:, j])).astype(np.float32)


def _cells(pixels: int, cells: int) -> tuple[np.ndarray, np.ndarray]:
    """For each pixel centre, the cell before it and the fraction on the way to the next."""
    t = np.clip((np.arange(pixels) + 0.5) * cells / pixels - 0.5, 0, cells - 1)
    i = np.minimum(t.astype(np.int64), cells - 2)
    return i, (t - i).astype(np.float32)


def light(
    displacement_mm: np.ndarray,
    cell_mm: tuple[float, float],
    coefficients: np.ndarray,
    further: Sequence[Further] = (),
) -> np.ndarray:
    """What the surface adds to each channel, before the weight w.

    Args:
        displacement_mm: (rows, columns), positive into the gel.
        cell_mm: grid spacing along x and y.
        coefficients: (3, 12), see the top of this module; lengths in mm from the window's centre.
        further: what effects outside the compiled light make of it, in this order.

    Returns:
        s in levels, float32 (3, rows, columns).
    """
    u = np.ascontiguousarray(displacement_mm, np.float32)
    if np.shape(coefficients) != (3, SIZE):
        raise ValueError(
            f"the light of three channels has coefficients (3, {SIZE}); got {np.shape(coefficients)}"
        )
    return np.stack([channel(u, cell_mm, c, k, further) for k, c in enumerate(coefficients)])


def channel(
    displacement_mm: np.ndarray,
    cell_mm: tuple[float, float],
    coefficients: np.ndarray,
    k: int = 0,
    further: Sequence[Further] = (),
) -> np.ndarray:
    """Channel k of `light`: (rows, columns) from a float32 displacement and coefficients (12,)."""
    u, c = displacement_mm, coefficients
    out = np.empty_like(u)
    shadow = cast(u, cell_mm[0], cell_mm[1], c) if c[6] > 0 else _NO_SHADOW
    _light(u, cell_mm[0], cell_mm[1], c, shadow, out)
    for change in further:
        out = np.asarray(change(k, out, u, cell_mm), np.float32)
    return out


class Renderer:
    """Renders displacement grids of one shape onto one rest image.

    Args:
        rest_image: uint8 (H, W, 3).
        weight: w, (H, W, 3).
        coefficients: of the light, (3, 12).
        cell_mm: grid spacing along x and y.
        shape: rows and columns of the displacement grid.
        further: see `light`.
    """

    def __init__(self, rest_image, weight, coefficients, cell_mm, shape, further: Sequence[Further] = ()):
        self._rest = np.ascontiguousarray(rest_image)
        self._weight = np.ascontiguousarray(weight, np.float32)
        self._top_weight = self._weight.max((0, 1))
        self._light = cell_mm, coefficients, further
        h, w = rest_image.shape[:2]
        self._cells = (*_cells(h, shape[0]), *_cells(w, shape[1]))

    def image(self, displacement_mm: np.ndarray) -> np.ndarray:
        """Tactile image, uint8 (H, W, 3), of a displacement (rows, columns)."""
        out = np.empty_like(self._rest)
        s = light(displacement_mm, *self._light)
        _render(s, self._rest, self._weight, *self._cells, out)
        return out

    def contact_pixels(self, displacement_mm: np.ndarray, sum_limit: int) -> int:
        """How many pixels of `image` differ from rest by more than `sum_limit` in R + G + B."""
        s = light(displacement_mm, *self._light)
        return _count(s, self._rest, self._weight, *self._cells, sum_limit, self._top_weight)


@njit(cache=True)
def _light(u, hx, hy, c, shadow, out):
    """One channel of `light`; one-sided differences at the rim."""
    n, m = u.shape
    strength = math.hypot(c[0], c[1])
    far = math.isnan(c[PX])
    ex, ey = towards(c, 0.0, 0.0)
    for i in range(n):
        up, down = max(i - 1, 0), min(i + 1, n - 1)
        y = (i + 0.5 - n / 2) * hy
        for j in range(m):
            left, right = max(j - 1, 0), min(j + 1, m - 1)
            gx = (u[i, right] - u[i, left]) / (hx * (right - left))
            gy = (u[down, j] - u[up, j]) / (hy * (down - up))
            if not far:
                ex, ey = towards(c, (j + 0.5 - m / 2) * hx, y)
            along, across = ex * gx + ey * gy, ex * gy - ey * gx
            s = lambert(-strength * along, c[5], gx, gy)
            if c[6] > 0.0:
                s = darkened(s, shadow[i, j], c[6], c[8])
            out[i, j] = s + c[2] * u[i, j] + c[9] * along**2 + c[10] * across**2 + c[11] * u[i, j] ** 2


@njit(inline="always")
def _pixel(rest, weight, light):
    """One channel of one pixel, rounded to a level."""
    value = np.float32(rest) + weight * light + np.float32(0.5)
    return np.int32(min(max(value, np.float32(0.0)), np.float32(255.0)))


@njit(inline="always")
def _blend_rows(light, i, f, row):
    """Row of light (3, columns) between grid rows i and i + 1; returns its largest magnitude."""
    top = np.float32(0.0)
    for k in range(3):
        for j in range(row.shape[1]):
            row[k, j] = light[k, i, j] + f * (light[k, i + 1, j] - light[k, i, j])
            top = max(top, abs(row[k, j]))
    return top


@njit(cache=True)
def _render(light, rest, weight, i0, fy, j0, fx, out):
    row = np.empty((3, light.shape[2]), np.float32)
    for p in range(rest.shape[0]):
        if _blend_rows(light, i0[p], fy[p], row) == 0.0:
            out[p] = rest[p]
            continue
        for q in range(rest.shape[1]):
            j, f = j0[q], fx[q]
            for k in range(3):
                value = row[k, j] + f * (row[k, j + 1] - row[k, j])
                out[p, q, k] = _pixel(rest[p, q, k], weight[p, q, k], value)


@njit(cache=True)
def _count(light, rest, weight, i0, fy, j0, fx, sum_limit, top_weight):
    """Counts pixels whose channels differ by more than `sum_limit` together.

    Only pixels between grid columns whose light could reach the limit are rendered.
    """
    cols = light.shape[2]
    row = np.empty((3, cols), np.float32)
    n = 0
    for p in range(rest.shape[0]):
        _blend_rows(light, i0[p], fy[p], row)
        first, last = cols, -1
        for j in range(cols):
            bound = np.float32(1.5)  # three roundings
            for k in range(3):
                bound += top_weight[k] * abs(row[k, j])
            if bound > sum_limit:
                first, last = min(first, j), j
        if last < 0:
            continue
        for q in range(rest.shape[1]):
            j, f = j0[q], fx[q]
            if j + 1 < first or j > last:
                continue
            s = 0
            for k in range(3):
                value = row[k, j] + f * (row[k, j + 1] - row[k, j])
                s += abs(_pixel(rest[p, q, k], weight[p, q, k], value) - np.int32(rest[p, q, k]))
            n += s > sum_limit
    return n
