"""Rest colour: a gel lights up where light falls, so what a contact adds goes with the rest image.

w = (rest / mean) ^ gamma, a power of the rest image over its mean, pixel by pixel.
"""

import numpy as np

from pneutac_sim.effects import SensorEffect, each_channel

MAKE_SD = 0.05  # how similar sensors of one model are


def weight(log_rest: np.ndarray, v: dict[str, float]) -> np.ndarray:
    """(rest / mean) ^ gamma from its logarithm."""
    return np.exp(v["exponent"] * log_rest)


EFFECT = SensorEffect(
    name="rest_colour",
    stage="light",
    parameters=each_channel("exponent_{}", "", 0.7, -1.0, 4.0),
    prior_sd=(0.1,) * 3,
    standard=True,
    lend=lambda make, k: {"exponent": (make.exponents[k], make.exponents_sd[k])},
    weight=weight,
    equation=r"w = (I_{rest} / \bar I_{rest})^\gamma",
    cause="light that follows the colour at rest",
    summary="The light of your {device} is stronger where its rest image is brighter: it goes with the rest "
    "colour to the power {exponent_red:.2g} (red), {exponent_green:.2g} (green), {exponent_blue:.2g} (blue).",
    experiment="Press the same ball to the same depth at a bright and at a dark place of the rest image.",
)
