"""Photometric nonlinearity: the light follows Lambert's cosine, not the slope.

t -> phi (max(0, 1 + t / phi) / sqrt(1 + |grad u|^2) - 1), with t the light of the linear model and phi the
direct light, both in levels: a side turned away from the light goes dark and no darker. Terms in the squares
of the slopes along and across the light and of the depth take up what Lambert's surface is not.
"""

import math

import numpy as np
from numba import njit

from pneutac_sim.effects import SensorEffect, each_channel
from pneutac_sim.effects.sensor_effect import CHANNELS

DIRECT, ALONG, ACROSS, DEEP = 5, 9, 10, 11  # of a channel's row of coefficients, see `gel.optics`
# Levels for a slope of one along the light, across it, and for a millimetre of depth, all squared.
QUADRATIC = ("along_{}_levels", "across_{}_levels", "deep_{}_levels")


@njit(cache=True, error_model="numpy")
def lambert(t, phi, gx, gy):
    """Light of a slope (gx, gy) whose linear light is t, levels; phi is infinite for the linear model."""
    if math.isinf(phi):
        return t
    return phi * (max(0.0, 1.0 + t / phi) / math.sqrt(1.0 + gx * gx + gy * gy) - 1.0)


def direct_and_squares(row: np.ndarray, direction: np.ndarray, v: dict[str, float]) -> None:
    """Writes phi and the quadratic terms."""
    row[DIRECT] = v["direct_levels"]
    row[ALONG], row[ACROSS], row[DEEP] = (v[name.format("").replace("__", "_")] for name in QUADRATIC)


EFFECT = SensorEffect(
    name="photometric_nonlinearity",
    stage="light",
    parameters=each_channel("direct_{}_levels", "levels", 60.0, 3.0, 400.0)
    + tuple(p for name in QUADRATIC for p in each_channel(name, "levels", 0.0, -400.0, 400.0)),
    prior_sd=(40.0,) * len(CHANNELS) + (30.0,) * (len(QUADRATIC) * len(CHANNELS)),
    standard=True,
    coefficients=direct_and_squares,
    equation=r"t \to \varphi\,\left(\frac{\max(0, 1 + t / \varphi)}{\sqrt{1 + |\nabla u|^2}} - 1\right)"
    r" + a\,u_\parallel^2 + b\,u_\perp^2 + c\,u^2",
    cause="a nonlinear response to the surface slope",
    summary="The light of your {device} follows Lambert's cosine, not the slope: sides that face away go "
    "dark and no darker, by {direct_red_levels:.3g}, {direct_green_levels:.3g} and {direct_blue_levels:.3g} "
    "levels.",
    experiment="Press balls of several radii to several depths at one place.",
)
