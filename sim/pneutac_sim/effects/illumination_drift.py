"""Illumination drift: light or exposure changes over a session of photographs.

Image = (gain + drift t) x picture, with t from 0 to 1 over the session; fitted to the pixels away from all
contacts, where the picture is the rest image.
"""

from collections.abc import Sequence

import numpy as np

from pneutac_sim.effects import SensorEffect, each_channel
from pneutac_sim.effects.sensor_effect import CHANNELS, Quiet

GAIN_SD = 0.01  # how far the brightness of one photograph may be off a steady drift
PRIOR_GAIN, PRIOR_DRIFT = 0.03, 0.05


def gain(clock: float, values: dict[str, float]) -> np.ndarray:
    """Brightness over the rest image, (3,)."""
    return np.array([values[f"gain_{c}"] + values[f"drift_{c}"] * clock for c in CHANNELS])


def estimate(photographs: Sequence[Quiet]) -> dict[str, float]:
    """Weighted least squares of each photograph's brightness over its rest image, with priors."""
    gains, drifts = {}, {}
    for k, c in enumerate(CHANNELS):
        A: list[np.ndarray] = [np.diag(1 / np.array([PRIOR_GAIN, PRIOR_DRIFT]))]
        b: list[np.ndarray] = [np.zeros(2)]
        for p in photographs:
            rest, image = p.rest[:, k], p.image[:, k]
            A.append(np.array([[1.0, p.clock]]) / GAIN_SD)
            gain = (image * rest).sum() / max((rest * rest).sum(), 1e-9)
            b.append(np.array([(gain - 1) / GAIN_SD]))
        x = np.linalg.lstsq(np.concatenate(A), np.concatenate(b), rcond=None)[0]
        gains[f"gain_{c}"], drifts[f"drift_{c}"] = 1 + float(x[0]), float(x[1])
    return EFFECT.inside(gains | drifts)


EFFECT = SensorEffect(
    name="illumination_drift",
    stage="light",
    parameters=each_channel("gain_{}", "", 1.0, 0.5, 2.0, 1.0)
    + each_channel("drift_{}", "1/session", 0.0, -0.5, 0.5),
    prior_sd=(PRIOR_GAIN,) * 3 + (PRIOR_DRIFT,) * 3,
    of_session=True,
    gain=gain,
    estimate=estimate,
    equation=r"I \to (g + d\,t)\,I",
    cause="drift of light or exposure",
    summary="The light or exposure of your {device} drifts: against the rest image it begins at "
    "{gain_red:.3f}, {gain_green:.3f} and {gain_blue:.3f} times and changes by {drift_red:+.1%}, "
    "{drift_green:+.1%} and {drift_blue:+.1%} over the session.",
    experiment="Take a rest image before each press and name it in a column 'rest_image'; fix exposure and "
    "whites.",
)
