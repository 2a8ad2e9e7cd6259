"""Light of a touch sensor in the image plane: image = rest + w s, with s from the gel's surface.

The paper's photometric model (Sec. III-B) is s = L grad u + c_d u with w = 1; u is the surface displacement
in mm into the gel, that is towards the camera. Optics effects bend it where they are on (`effects.optics`):

- `near_light`: the light of a channel comes from a point p at a finite distance, so the direction of L turns
  over the image: t = -|L| e . grad u with e = (p - x) / |p - x|; p lies against L from the window's centre.
- `photometric_nonlinearity`: Lambert's cosine. t -> phi (max(0, 1 + t / phi) / sqrt(1 + |grad u|^2) - 1):
  a side turned away from the light goes dark and no darker, phi being the direct light in levels. Quadratic
  terms in the slopes along and across the light and in the depth take up what Lambert's surface is not.
- `shadow`: what rises between a point and the light takes the level lambda from it. The shadow's height over
  the surface is the largest u(x + r e) - r tan(elevation) along the ray, less u(x).
- `rest_colour`: w = (rest / mean) ^ gamma: a gel lights up where light falls.

s is computed on the displacement's own grid and interpolated to pixels, where w acts.
"""

import math

import numpy as np
from numba import njit

# A row a channel: L x, L y, c_d, p x, p y (NaN: far away), phi (inf: linear), lambda, tan(elevation), edge;
# then the quadratic terms along the light, across it and in depth
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


def light(displacement_mm: np.ndarray, cell_mm: tuple[float, float], coefficients: np.ndarray) -> np.ndarray:
    """What the surface adds to each channel, before the weight w.

    Args:
        displacement_mm: (rows, columns), positive into the gel.
        cell_mm: grid spacing along x and y.
        coefficients: (3, 12), see the top of this module; lengths in mm from the window's centre.

    Returns:
        s in levels, float32 (3, rows, columns).
    """
    u = np.ascontiguousarray(displacement_mm, np.float32)
    if np.shape(coefficients) != (3, 12):
        raise ValueError(
            f"the light of three channels has coefficients (3, 12); got {np.shape(coefficients)}"
        )
    return np.stack([channel(u, cell_mm, c) for c in coefficients])


def channel(
    displacement_mm: np.ndarray, cell_mm: tuple[float, float], coefficients: np.ndarray
) -> np.ndarray:
    """One channel of `light`: (rows, columns) from a float32 displacement and coefficients (12,)."""
    u, c = displacement_mm, coefficients
    out = np.empty_like(u)
    shadow = _shadow(u, cell_mm[0], cell_mm[1], c) if c[6] > 0 else _NO_SHADOW
    _light(u, cell_mm[0], cell_mm[1], c, shadow, out)
    return out


class Renderer:
    """Renders displacement grids of one shape onto one rest image.

    Args:
        rest_image: uint8 (H, W, 3).
        weight: w, (H, W, 3).
        coefficients: of the light, (3, 12).
        cell_mm: grid spacing along x and y.
        shape: rows and columns of the displacement grid.
    """

    def __init__(self, rest_image, weight, coefficients, cell_mm, shape):
        self._rest = np.ascontiguousarray(rest_image)
        self._weight = np.ascontiguousarray(weight, np.float32)
        self._top_weight = self._weight.max((0, 1))
        self._coefficients, self._cell_mm = coefficients, cell_mm
        h, w = rest_image.shape[:2]
        self._cells = (*_cells(h, shape[0]), *_cells(w, shape[1]))

    def image(self, displacement_mm: np.ndarray) -> np.ndarray:
        """Tactile image, uint8 (H, W, 3), of a displacement (rows, columns)."""
        out = np.empty_like(self._rest)
        s = light(displacement_mm, self._cell_mm, self._coefficients)
        _render(s, self._rest, self._weight, *self._cells, out)
        return out

    def contact_pixels(self, displacement_mm: np.ndarray, sum_limit: int) -> int:
        """How many pixels of `image` differ from rest by more than `sum_limit` in R + G + B."""
        s = light(displacement_mm, self._cell_mm, self._coefficients)
        return _count(s, self._rest, self._weight, *self._cells, sum_limit, self._top_weight)


@njit(cache=True)
def _towards(c, x, y):
    """Unit vector from (x, y) to the light of a channel."""
    if math.isnan(c[3]):
        ex, ey = -c[0], -c[1]
    else:
        ex, ey = c[3] - x, c[4] - y
    r = max(math.hypot(ex, ey), 1e-9)
    return ex / r, ey / r


@njit(cache=True)
def _light(u, hx, hy, c, shadow, out):
    """One channel of `light`; one-sided differences at the rim."""
    n, m = u.shape
    strength = math.hypot(c[0], c[1])
    for i in range(n):
        up, down = max(i - 1, 0), min(i + 1, n - 1)
        y = (i + 0.5 - n / 2) * hy
        for j in range(m):
            left, right = max(j - 1, 0), min(j + 1, m - 1)
            gx = (u[i, right] - u[i, left]) / (hx * (right - left))
            gy = (u[down, j] - u[up, j]) / (hy * (down - up))
            ex, ey = _towards(c, (j + 0.5 - m / 2) * hx, y)
            along, across = ex * gx + ey * gy, ex * gy - ey * gx
            s = -strength * along
            if not math.isinf(c[5]):
                s = c[5] * (max(0.0, 1.0 + s / c[5]) / math.sqrt(1.0 + gx * gx + gy * gy) - 1.0)
            if c[6] > 0.0 and shadow[i, j] > 0.0:
                dark = min(shadow[i, j] / c[8], 1.0)
                dark *= dark * (3.0 - 2.0 * dark)
                s -= dark * (s + c[6])
            out[i, j] = s + c[2] * u[i, j] + c[9] * along**2 + c[10] * across**2 + c[11] * u[i, j] ** 2


@njit(cache=True)
def _shadow(u, hx, hy, c):
    """Height in mm of the shadow over the surface of one channel, zero where the light arrives.

    The shadow's height S(x) = max(u(x), S(x + e h) - h tan(elevation)) is passed on from cell to cell, in
    four sweeps, each for the cells whose light comes from that side.
    """
    n, m = u.shape
    S = u.copy()
    far = math.isnan(c[3])
    for side in range(4):
        di, dj = 1 - 2 * (side // 2), 1 - 2 * (side % 2)  # where the light comes from
        if far and ((-c[0] > 0) != (dj > 0) or (-c[1] > 0) != (di > 0)):
            continue
        for a in range(n):
            i = n - 1 - a if di > 0 else a
            y = (i + 0.5 - n / 2) * hy
            for b in range(m):
                j = m - 1 - b if dj > 0 else b
                ex = -c[0] if far else c[3] - (j + 0.5 - m / 2) * hx
                ey = -c[1] if far else c[4] - y
                if (ex > 0) != (dj > 0) or (ey > 0) != (di > 0):
                    continue
                px, py = abs(ex) / hx, abs(ey) / hy  # cells that the ray crosses on the way to the light
                if px >= py:  # it leaves through the column beside
                    if not 0 <= j + dj < m:
                        continue
                    near = S[i, j + dj]
                    other = S[i + di, j + dj] if 0 <= i + di < n else near
                    f = py / max(px, 1e-9)
                else:
                    if not 0 <= i + di < n:
                        continue
                    near = S[i + di, j]
                    other = S[i + di, j + dj] if 0 <= j + dj < m else near
                    f = px / py
                S_in = near + f * (other - near)
                if S_in > S[i, j]:
                    S_in -= c[7] * math.sqrt(ex * ex + ey * ey) / max(px, py, 1e-9)
                    S[i, j] = max(S[i, j], S_in)
    for i in range(n):
        for j in range(m):
            S[i, j] -= u[i, j]
    return S


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
