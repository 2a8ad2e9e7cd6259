"""Near light: a channel's light stands at a finite distance, so its direction turns over the image.

t = -|L| e . grad u with e = (p - x) / |p - x| instead of e = -L / |L|; the place p of the light lies against
L from the window's centre.
"""

import math

import numpy as np
from numba import njit

from pneutac_sim.effects import SensorEffect, each_channel

LX, LY, PX, PY = 0, 1, 3, 4  # of a channel's row of coefficients, see `gel.optics`
MAKE_SD_MM = 2.0  # how similar sensors of one model are


@njit(cache=True, error_model="numpy")
def towards(c, x, y):
    """Unit vector from (x, y) in mm to the light of a channel with coefficients c (12,)."""
    if math.isnan(c[PX]):
        ex, ey = -c[LX], -c[LY]
    else:
        ex, ey = c[PX] - x, c[PY] - y
    r = max(math.sqrt(ex * ex + ey * ey), 1e-9)
    return ex / r, ey / r


def place(row: np.ndarray, direction: np.ndarray, v: dict[str, float]) -> None:
    """Writes where the light stands, in mm from the window's centre."""
    row[PX], row[PY] = v["distance_mm"] * direction


EFFECT = SensorEffect(
    name="near_light",
    stage="light",
    parameters=each_channel("distance_{}_mm", "mm", 200.0, 8.0, 1000.0),
    prior_sd=(100.0,) * 3,
    standard=True,
    lend=lambda make, k: {"distance_mm": (np.hypot(*make.positions_mm[k]), make.distances_sd_mm[k])},
    coefficients=place,
    equation=r"t = -|L|\,e \cdot \nabla u, \quad e = \frac{p - x}{|p - x|}",
    cause="lights close to the gel",
    summary="The lights of your {device} are near: {distance_red_mm:.3g} mm (red), "
    "{distance_green_mm:.3g} mm (green) and {distance_blue_mm:.3g} mm (blue) from the window's centre, so "
    "their direction turns over the image.",
    experiment="Press the same ball to the same depth near all four edges.",
)
