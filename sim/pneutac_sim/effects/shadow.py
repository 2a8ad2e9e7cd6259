"""Shadow: what rises between a point and a light takes the level lambda from it.

The shadow's height over the surface is the largest u(x + r e) - r tan(elevation) along the ray e to the
light, less u(x). Its edge is soft: the share 3 d^2 - 2 d^3 of the light is gone, with d the height over
`edge_mm`, at most 1.
"""

import math

import numpy as np
from numba import njit

from pneutac_sim.effects import Parameter, SensorEffect, each_channel
from pneutac_sim.effects.near_light import LX, LY, PX, PY

LEVEL, SLOPE, EDGE = 6, 7, 8  # of a channel's row of coefficients, see `gel.optics`


@njit(cache=True, error_model="numpy")
def darkened(s, height, level, edge):
    """Light of a point that lies `height` mm in the shadow, levels."""
    dark = min(max(height, 0.0) / edge, 1.0)
    dark *= dark * (3.0 - 2.0 * dark)
    return s - dark * (s + level)


@njit(cache=True, error_model="numpy")
def cast(u, hx, hy, c):
    """Height in mm of the shadow over the surface of one channel, zero where the light arrives.

    The shadow's height S(x) = max(u(x), S(x + e h) - h tan(elevation)) is passed on from cell to cell, in
    four sweeps, each for the cells whose light comes from that side.
    """
    n, m = u.shape
    S = u.copy()
    far = math.isnan(c[PX])
    wide, high = (0.0, 0.0) if far else ((m - 1) / 2 * hx, (n - 1) / 2 * hy)
    to_x, to_y = (-c[LX], -c[LY]) if far else (c[PX], c[PY])
    for side in range(4):
        di, dj = 1 - 2 * (side // 2), 1 - 2 * (side % 2)  # where the light comes from
        if (dj > 0 and to_x + wide <= 0) or (dj < 0 and to_x - wide > 0):
            continue  # for no cell
        if (di > 0 and to_y + high <= 0) or (di < 0 and to_y - high > 0):
            continue
        for a in range(n):
            i = n - 1 - a if di > 0 else a
            y = (i + 0.5 - n / 2) * hy
            for b in range(m):
                j = m - 1 - b if dj > 0 else b
                ex = -c[LX] if far else c[PX] - (j + 0.5 - m / 2) * hx
                ey = -c[LY] if far else c[PY] - y
                if (ex > 0) != (dj > 0) or (ey > 0) != (di > 0):
                    continue
                px, py = abs(ex) / hx, abs(ey) / hy  # cells that the ray crosses on the way to the light
                if px >= py:  # it leaves through the neighbouring column
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
                    S_in -= c[SLOPE] * math.sqrt(ex * ex + ey * ey) / max(px, py, 1e-9)
                    S[i, j] = max(S[i, j], S_in)
    for i in range(n):
        for j in range(m):
            S[i, j] -= u[i, j]
    return S


def level_and_edge(row: np.ndarray, direction: np.ndarray, v: dict[str, float]) -> None:
    """Writes lambda, tan(elevation) and the edge."""
    row[LEVEL], row[SLOPE], row[EDGE] = v["shadow_levels"], v["elevation"], v["edge_mm"]


EFFECT = SensorEffect(
    name="shadow",
    stage="light",
    parameters=(
        *each_channel("shadow_{}_levels", "levels", 40.0, 0.0, 400.0),
        *each_channel("elevation_{}", "", 0.25, 0.03, 1.0),
        Parameter("edge_mm", "mm", 0.1, 0.02, 0.6),
    ),
    prior_sd=(40.0,) * 3 + (0.08,) * 3 + (0.08,),
    standard=True,
    coefficients=level_and_edge,
    equation=r"t \to t - (3 d^2 - 2 d^3)\,(t + \lambda), \quad d = \min(1, \max(h, 0) / h_0)",
    cause="shadows of imprints",
    summary="Imprints cast shadows in your {device}: {shadow_red_levels:.3g}, {shadow_green_levels:.3g} and "
    "{shadow_blue_levels:.3g} levels are missing behind them; the lights stand at slopes of "
    "{elevation_red:.2g}, {elevation_green:.2g} and {elevation_blue:.2g} over the gel.",
    experiment="Press a ball deep in the middle and look for dark tails beyond the contact, away from each "
    "light.",
)
