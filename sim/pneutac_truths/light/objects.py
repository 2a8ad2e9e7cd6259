"""How far rigid objects reach below a plane, by marching along parallel rays to their distance fields.

Distances: Hart, The Visual Computer 12 (1996) 527 (sphere tracing); shapes and sizes as MuJoCo numbers them.
"""

import math

import numpy as np
from numba import njit

SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX = 2, 3, 4, 5, 6
REACH_MM = 3.0  # rays start this far below the plane
NEAR_MM = 2e-3
MARCHES = 80


@njit(cache=True)
def _distance(kind, s, x, y, z):
    """From a point in the shape's frame to its surface, or less; negative inside. All in mm."""
    if kind == SPHERE:
        return math.sqrt(x * x + y * y + z * z) - s[0]
    if kind == CAPSULE:
        along = min(max(z, -s[1]), s[1])
        return math.sqrt(x * x + y * y + (z - along) ** 2) - s[0]
    if kind == ELLIPSOID:
        k = math.sqrt((x / s[0]) ** 2 + (y / s[1]) ** 2 + (z / s[2]) ** 2)
        g = math.sqrt((x / s[0] ** 2) ** 2 + (y / s[1] ** 2) ** 2 + (z / s[2] ** 2) ** 2)
        return k * (k - 1.0) / max(g, 1e-12)
    if kind == CYLINDER:
        a, b = math.sqrt(x * x + y * y) - s[0], abs(z) - s[1]
        return min(max(a, b), 0.0) + math.hypot(max(a, 0.0), max(b, 0.0))
    a, b, c = abs(x) - s[0], abs(y) - s[1], abs(z) - s[2]
    out = math.sqrt(max(a, 0.0) ** 2 + max(b, 0.0) ** 2 + max(c, 0.0) ** 2)
    return min(max(a, max(b, c)), 0.0) + out


@njit(cache=True)
def _march(kinds, sizes, places, turns, xs, ys, out):
    for k in range(len(kinds)):
        R, c = turns[k], places[k]
        for i in range(len(ys)):
            for j in range(len(xs)):
                px, py, z = xs[j] - c[0], ys[i] - c[1], -REACH_MM
                for _ in range(MARCHES):
                    pz = z - c[2]
                    d = _distance(
                        kinds[k],
                        sizes[k],
                        R[0, 0] * px + R[1, 0] * py + R[2, 0] * pz,
                        R[0, 1] * px + R[1, 1] * py + R[2, 1] * pz,
                        R[0, 2] * px + R[1, 2] * py + R[2, 2] * pz,
                    )
                    z += d
                    if d < NEAR_MM or z > REACH_MM:
                        break
                out[i, j] = max(out[i, j], -z)


def reach_below(kinds, sizes_mm, places_mm, turns, xs_mm: np.ndarray, ys_mm: np.ndarray) -> np.ndarray:
    """How far objects reach below the plane z = 0, mm, at most `REACH_MM`; negative where they end above.

    Args:
        kinds: (n,) shape numbers.
        sizes_mm: (n, 3).
        places_mm: (n, 3) centres in the plane's frame.
        turns: (n, 3, 3) shape to plane.
        xs_mm: (columns,) of the grid.
        ys_mm: (rows,).
    """
    out = np.full((len(ys_mm), len(xs_mm)), -REACH_MM)
    kinds, turns = np.asarray(kinds, np.int64), np.asarray(turns, float).reshape(-1, 3, 3)
    sizes, places = (np.asarray(x, float).reshape(-1, 3) for x in (sizes_mm, places_mm))
    _march(kinds, sizes, places, turns, xs_mm, ys_mm, out)
    return out
