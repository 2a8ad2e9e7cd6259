"""Gel surface displacement under a given indentation depth.

The gel is a thin soft layer bonded to its window. Its surface u [mm, into the gel] follows what presses it
and sags around the contact like a Pasternak foundation (springs joined by a shear layer): its pressure
k (u - l^2 lap u) is zero off the contact, so that

    u >= d,   u - l^2 lap u >= 0,   one of them an equality at every point,

with d the indentation depth of the probe grid and l the decay length. Inside the contact u = d; around a
round contact u falls like K0(r / l); the slope is continuous at the contact's edge. Against Hertz' half-space
the one length l also lets a thin layer hide its far field, which real DIGIT images ask for (see `calibrate`).
"""

import numpy as np
from numba import njit

DECAY_MM = 1.2  # found on two real DIGITs: 1.17 and 1.31


def surface(
    depth_mm: np.ndarray, cell_mm: tuple[float, float] = (12 / 59, 16 / 80), decay_mm: float = DECAY_MM
) -> np.ndarray:
    """Displacement of the gel surface in mm, float32 (rows, columns), nowhere less than `depth_mm`.

    `depth_mm` (rows, columns) is how deep objects lie below the resting surface, zero off them; `cell_mm` the
    grid spacing along columns (x) and rows (y); `decay_mm` the length l.
    """
    return _solve(np.ascontiguousarray(depth_mm, np.float32), cell_mm[0], cell_mm[1], decay_mm)


@njit(cache=True)
def resolutions(shape, cell_mm, decay_mm):
    """How many grids, each of half the resolution, are solved one after another."""
    levels = 1
    while min(shape[0], shape[1]) >> levels >= 8 and min(cell_mm[0], cell_mm[1]) * 2.0**levels < decay_mm:
        levels += 1
    return levels


@njit(cache=True)
def over_relaxation(cell_mm, decay_mm):
    """(decay / cell)^2 along x and y, and the factor by which a sweep goes too far, float32."""
    kx, ky = np.float32((decay_mm / cell_mm[0]) ** 2), np.float32((decay_mm / cell_mm[1]) ** 2)
    jacobi = 2 * (kx + ky) / (1 + 2 * (kx + ky))
    return kx, ky, np.float32(2.0 / (1.0 + np.sqrt(1.0 - jacobi**2)))


@njit(cache=True)
def _solve(d, hx, hy, decay):
    """Nested iteration: the half-resolution solution, interpolated, starts the sweeps."""
    rows, cols = d.shape
    levels = resolutions(d.shape, (hx, hy), decay)
    u = np.zeros((1, 1), np.float32)
    for level in range(levels - 1, -1, -1):
        f = 1 << level
        n, m = (rows + f - 1) // f, (cols + f - 1) // f
        # obstacle with a frame of ghost cells
        o = np.zeros((n + 2, m + 2), np.float32)
        for i in range(n):
            for j in range(m):
                if f == 1:
                    o[i + 1, j + 1] = d[i, j]
                else:  # cell mean
                    s, c = np.float32(0.0), 0
                    for p in range(i * f, min(i * f + f, rows)):
                        for q in range(j * f, min(j * f + f, cols)):
                            s += d[p, q]
                            c += 1
                    o[i + 1, j + 1] = s / c
        v = o.copy()
        if level < levels - 1:
            for i in range(1, n + 1):
                for j in range(1, m + 1):
                    v[i, j] = max(o[i, j], u[(i + 1) // 2, (j + 1) // 2])
        _sweeps(v, o, hx * f, hy * f, decay, 30 if level == levels - 1 else 12)
        u = v
    return u[1:-1, 1:-1].copy()


@njit(cache=True, fastmath=True)
def _sweeps(u, o, hx, hy, decay, sweeps):
    """Projected red-black over-relaxation of u - l^2 lap u = 0 above the obstacle; zero slope at the rim."""
    n, m = u.shape
    kx, ky, omega = over_relaxation((hx, hy), decay)
    scale = np.float32(1.0) / (np.float32(1.0) + np.float32(2.0) * (kx + ky))
    for _ in range(sweeps):
        for colour in range(2):
            # Loops over single cells: Numba takes seconds to compile the check that whole rows fit.
            for j in range(m):
                u[0, j], u[n - 1, j] = u[1, j], u[n - 2, j]
            for i in range(n):
                u[i, 0], u[i, m - 1] = u[i, 1], u[i, m - 2]
            for i in range(1, n - 1):
                for j in range(1 + (i + colour) % 2, m - 1, 2):
                    x = (kx * (u[i, j - 1] + u[i, j + 1]) + ky * (u[i - 1, j] + u[i + 1, j])) * scale
                    u[i, j] = max(o[i, j], u[i, j] + omega * (x - u[i, j]))
