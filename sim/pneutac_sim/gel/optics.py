"""Photometric contact model in the image plane: c = c0 + w (L grad u + c_d u) (paper, Sec. III-B).

u is the surface displacement in mm, into the gel; the paper's normalised depth is u over 1 mm. Everything but
w is linear in u, so the light is computed on the displacement's own grid and interpolated to pixels.
"""

import numpy as np
from numba import njit


def gradient(displacement_mm: np.ndarray, cell_mm: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Slopes du/dx and du/dy (dimensionless), central differences, same shape as the displacement."""
    dy, dx = np.gradient(displacement_mm, cell_mm[1], cell_mm[0])
    return dx, dy


def upsample(grid: np.ndarray, height: int, width: int) -> np.ndarray:
    """Bilinear interpolation of cell values (rows, columns) to pixels (height, width), float32."""
    i, fy = _cells(height, grid.shape[0])
    j, fx = _cells(width, grid.shape[1])
    rows = grid[i] + fy[:, None] * (grid[i + 1] - grid[i])
    return (rows[:, j] + fx * (rows[:, j + 1] - rows[:, j])).astype(np.float32)


def _cells(pixels: int, cells: int) -> tuple[np.ndarray, np.ndarray]:
    """For each pixel centre, the cell before it and the fraction on the way to the next."""
    t = np.clip((np.arange(pixels) + 0.5) * cells / pixels - 0.5, 0, cells - 1)
    i = np.minimum(t.astype(np.int64), cells - 2)
    return i, (t - i).astype(np.float32)


class Renderer:
    """Renders displacement grids of one shape onto one rest image.

    Args:
        rest_image: uint8 (H, W, 3).
        weight: w, (H, W, 3).
        light: L, (3, 2).
        depth_light: c_d, (3,).
        cell_mm: grid spacing along x and y.
        shape: rows and columns of the displacement grid.
    """

    def __init__(self, rest_image, weight, light, depth_light, cell_mm, shape):
        self._rest = np.ascontiguousarray(rest_image)
        self._weight = np.ascontiguousarray(weight, np.float32)
        self._top_weight = self._weight.max((0, 1))
        self._coefficients = np.column_stack([light, depth_light]).astype(np.float32)
        self._slope = np.float32(0.5 / cell_mm[0]), np.float32(0.5 / cell_mm[1])
        h, w = rest_image.shape[:2]
        self._cells = (*_cells(h, shape[0]), *_cells(w, shape[1]))

    def image(self, displacement_mm: np.ndarray) -> np.ndarray:
        """Tactile image, uint8 (H, W, 3), of a displacement (rows, columns)."""
        out = np.empty_like(self._rest)
        light = _light(displacement_mm, *self._slope, self._coefficients)
        _render(light, self._rest, self._weight, *self._cells, out)
        return out

    def contact_pixels(self, displacement_mm: np.ndarray, sum_limit: int) -> int:
        """How many pixels of `image` differ from rest by more than `sum_limit` in R + G + B."""
        light = _light(displacement_mm, *self._slope, self._coefficients)
        return _count(light, self._rest, self._weight, *self._cells, sum_limit, self._top_weight)


@njit(cache=True, fastmath=True)
def _light(u, sx, sy, c):
    """L grad u + c_d u on the grid, (3, rows, columns) levels; one-sided differences at the rim."""
    n, m = u.shape
    out = np.empty((3, n, m), np.float32)
    for i in range(n):
        up, down = max(i - 1, 0), min(i + 1, n - 1)
        ky = sy * np.float32(2.0 / (down - up))
        for j in range(m):
            left, right = max(j - 1, 0), min(j + 1, m - 1)
            gx = (u[i, right] - u[i, left]) * sx * np.float32(2.0 / (right - left))
            gy = (u[down, j] - u[up, j]) * ky
            for k in range(3):
                out[k, i, j] = c[k, 0] * gx + c[k, 1] * gy + c[k, 2] * u[i, j]
    return out


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
