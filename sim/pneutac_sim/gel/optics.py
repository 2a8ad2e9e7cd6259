"""Light of a touch sensor in the image plane: image = rest + w s, with s from the gel's surface.

The paper's photometric model (Sec. III-B) is s = L grad u + c_d u with w = 1; u is the surface displacement
in mm into the gel, that is towards the camera. Effects of the stage `light` bend it where they are on. Those
of the library are compiled into one kernel, which reads them from a row of coefficients a channel; those of
other packages change s after it.

s is computed on the displacement's own grid and interpolated to pixels, where w acts.

Numba's cache of this file does not see changes in the effects' files: delete `__pycache__` after one.
"""

import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numba import njit

from pneutac_sim.effects.near_light import LX, LY, PX, PY, towards
from pneutac_sim.effects.photometric_nonlinearity import lambert
from pneutac_sim.effects.shadow import LEVEL, cast, darkened
from pneutac_sim.gel.contact import differing

# A channel's row: L x, L y, c_d, p x, p y (NaN: far away), phi (inf: linear), lambda, tan(elevation), edge;
# then the quadratic terms along the light, across it and in depth.
NEUTRAL = (0.0, 0.0, 0.0, np.nan, np.nan, np.inf, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
SIZE = len(NEUTRAL)

# Changes the light s of channel k under a displacement u: (k, s, u, cell_mm) -> s.
Further = Callable[[int, np.ndarray, np.ndarray, tuple[float, float]], np.ndarray]
# What is added to the light of all channels: (u, cell_mm, height of each one's shadow) -> (3, rows, columns).
ResidualLight = Callable[[np.ndarray, tuple[float, float], list[np.ndarray]], np.ndarray]

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
    residual_light: ResidualLight | None = None,
) -> np.ndarray:
    """What the surface adds to each channel before the weight w: s in levels, float32 (3, rows, columns).

    Of a displacement (rows, columns), positive into the gel, with the grid spacing along x and y and
    coefficients (3, 12), see the top of this module. What effects outside the compiled light make of it comes
    after it, and the residual light last.
    """
    u = np.ascontiguousarray(displacement_mm, np.float32)
    if np.shape(coefficients) != (3, SIZE):
        raise ValueError(
            f"the light of three channels has coefficients (3, {SIZE}); got {np.shape(coefficients)}"
        )
    shadows = [cast(u, *cell_mm, c) if c[LEVEL] > 0 or residual_light else _NO_SHADOW for c in coefficients]
    each = zip(coefficients, shadows, strict=True)
    out = np.stack([_channel(u, cell_mm, c, shadow, k, further) for k, (c, shadow) in enumerate(each)])
    return out if residual_light is None else out + residual_light(u, cell_mm, shadows)


def row(light: np.ndarray, depth_light: float, direction: np.ndarray, acting: Iterable[tuple]) -> np.ndarray:
    """Coefficients (12,) of one channel, see the top of this module.

    Of L (2,) in levels per unit slope, c_d in levels/mm, the unit vector (2,) to the light, and the effects
    of the sensor with the channel's values.
    """
    out = np.array(NEUTRAL)
    out[:2], out[2] = light, depth_light
    for effect, values in acting:
        if effect.coefficients is not None:
            effect.coefficients(out, direction, values)
    return out


def towards_light(coefficients: np.ndarray, shape: tuple[int, int], cell_mm) -> np.ndarray:
    """From each cell of a grid to the light of each channel, (2, channels, rows, columns): x and y, mm.

    Where a light is far away only the direction counts.
    """
    y, x = np.meshgrid(
        *((np.arange(n) + 0.5 - n / 2) * h for n, h in zip(shape, cell_mm[::-1], strict=True)), indexing="ij"
    )
    out = np.empty((2, len(coefficients), *shape))
    for k, c in enumerate(coefficients):
        out[0, k], out[1, k] = (-c[LX], -c[LY]) if math.isnan(c[PX]) else (c[PX] - x, c[PY] - y)
    return out


def channel(
    displacement_mm: np.ndarray,
    cell_mm: tuple[float, float],
    coefficients: np.ndarray,
    k: int = 0,
    further: Sequence[Further] = (),
) -> np.ndarray:
    """Channel k of `light`: (rows, columns) from a float32 displacement and coefficients (12,)."""
    u, c = displacement_mm, coefficients
    return _channel(u, cell_mm, c, cast(u, *cell_mm, c) if c[LEVEL] > 0 else _NO_SHADOW, k, further)


def _channel(u, cell_mm, coefficients, shadow, k, further) -> np.ndarray:
    out = np.empty_like(u)
    _light(u, *cell_mm, coefficients, shadow, out)
    for change in further:
        out = np.asarray(change(k, out, u, cell_mm), np.float32)
    return out


class Renderer:
    """Renders displacement grids of one shape and spacing onto one rest image, uint8 (H, W, 3).

    `weight` is w, (H, W, 3); `lighting` the coefficients and what follows them of `light`.
    """

    def __init__(self, rest_image, weight, cell_mm, shape, *lighting):
        self._rest = np.ascontiguousarray(rest_image)
        self._weight = np.ascontiguousarray(weight, np.float32)
        self._light = cell_mm, *lighting
        h, w = rest_image.shape[:2]
        self._cells = (*_cells(h, shape[0]), *_cells(w, shape[1]))

    def image(self, displacement_mm: np.ndarray) -> np.ndarray:
        """Tactile image, uint8 (H, W, 3), of a displacement (rows, columns)."""
        out = np.empty_like(self._rest)
        s = light(displacement_mm, *self._light)
        lines = (len(out), -1)
        _render(s, self._rest.reshape(lines), self._weight.reshape(lines), *self._cells, out.reshape(lines))
        return out

    def contact_pixels(self, displacement_mm: np.ndarray, sum_limit: int) -> int:
        """How many pixels of `image` differ from rest by more than `sum_limit` in R + G + B."""
        return differing(self.image(displacement_mm), self._rest, sum_limit)


@njit(cache=True, error_model="numpy")
def _light(u, hx, hy, c, shadow, out):
    """One channel of `light`; one-sided differences at the rim. Its last loop vectorises."""
    n, m = u.shape
    strength, shadowed = math.hypot(c[0], c[1]), c[6] > 0.0
    gx, gy, ex, ey = np.empty(m), np.empty(m), np.empty(m), np.empty(m)
    for i in range(n):
        up, down = max(i - 1, 0), min(i + 1, n - 1)
        for j in range(m):
            left, right = max(j - 1, 0), min(j + 1, m - 1)
            gx[j] = (u[i, right] - u[i, left]) / (hx * (right - left))
            gy[j] = (u[down, j] - u[up, j]) / (hy * (down - up))
        for j in range(m):
            ex[j], ey[j] = towards(c, (j + 0.5 - m / 2) * hx, (i + 0.5 - n / 2) * hy)
        for j in range(m):
            along, across = ex[j] * gx[j] + ey[j] * gy[j], ex[j] * gy[j] - ey[j] * gx[j]
            s = lambert(-strength * along, c[5], gx[j], gy[j])
            if shadowed:
                s = darkened(s, shadow[i, j], c[6], c[8])
            out[i, j] = s + c[2] * u[i, j] + c[9] * along**2 + c[10] * across**2 + c[11] * u[i, j] ** 2


@njit(inline="always")
def _lerp(before, after, f):
    return before + f * (after - before)


@njit(cache=True, fastmath={"nnan", "nsz"})
def _render(light, rest, weight, i0, fy, j0, fx, out):
    """Fills `out` (H, 3 W); rest image and weight are (H, 3 W) too: a pixel's channels follow one another."""
    rows, ends = rest.shape
    lines, cells = light.shape[1], light.shape[2]
    across, still = np.empty((lines, ends), np.float32), np.empty(lines, np.bool_)
    for i in range(lines):
        for q in range(ends // 3):
            for k in range(3):
                across[i, 3 * q + k] = _lerp(light[k, i, j0[q]], light[k, i, j0[q] + 1], fx[q])
        still[i] = True
        for k in range(3):
            for j in range(cells):
                still[i] &= light[k, i, j] == 0
    for p in range(rows):
        i, f = i0[p], fy[p]
        before, after, c, w, to = across[i], across[i + 1], rest[p], weight[p], out[p]
        if still[i] and still[i + 1]:
            for q in range(ends):
                to[q] = c[q]
            continue
        for q in range(ends):  # vectorises
            level = np.float32(c[q]) + w[q] * _lerp(before[q], after[q], f) + np.float32(0.5)
            to[q] = np.int32(min(max(level, np.float32(0)), np.float32(255)))
