"""Faults of the pressure gauge: the air itself is as it is."""

import numpy as np

from pneutac_truths.effects.air import lag
from pneutac_truths.effects.table import effect
from pneutac_truths.world import World, seconds


@effect(
    "gauge",
    "The gauge's range ends below the top pressure.",
    "Doebelin, Measurement Systems (2003) ch. 6",
    physics=False,
    size=(0.02, 0.5),
)
def gauge_clipping(w: World, read: np.ndarray, size: float) -> np.ndarray:
    """`size`: share of the top pressure that it cannot show."""
    return np.minimum(read, 1 - size)


@effect(
    "gauge",
    "The gauge knows few steps.",
    "Widrow and Kollar, Quantization Noise (2008)",
    physics=False,
    size=(0.01, 0.35),
)
def gauge_quantised(w: World, read: np.ndarray, size: float) -> np.ndarray:
    """`size`: one step, share of the top pressure."""
    return np.round(read / size) * size


@effect(
    "gauge",
    "The gauge filters and sends its readings late.",
    "Bergh and Tijdeman, NLR-TR F.238 (1965) (tube and gauge); Doebelin, Measurement Systems (2003)",
    physics=False,
    dead_share=(0.2, 0.6),
    size=(0.01, 2.0),
)
def gauge_late(w: World, read: np.ndarray, dead_share: float, size: float) -> np.ndarray:
    """`size`: delay and time constant together, s; `dead_share` of it pure delay."""
    slow = lag(np.ascontiguousarray(read), size * (1 - dead_share))
    k = seconds(size * dead_share)
    return np.concatenate([np.tile(slow[:1], (k, 1)), slow[:-k]])


@effect(
    "gauge",
    "The gauge's zero drifts.",
    "Doebelin, Measurement Systems (2003) ch. 6 (zero shift of piezoresistive cells)",
    physics=False,
    minutes=(2.0, 10.0),
    size=(0.01, 0.4),
)
def gauge_drifting(w: World, read: np.ndarray, minutes: float, size: float) -> np.ndarray:
    """`size`: share of the top pressure by which it is off in the end."""
    return read + _uneven(read, size) * (1 - np.exp(-w.time_s / (60 * minutes)))[:, None]


@effect(
    "gauge",
    "The gauge's scale is off.",
    "Doebelin, Measurement Systems (2003) ch. 2 (span error)",
    physics=False,
    size=(0.01, 0.25),
)
def gauge_span(w: World, read: np.ndarray, size: float) -> np.ndarray:
    """`size`: share by which it reads too high."""
    return read * (1 + _uneven(read, size))


def _uneven(read: np.ndarray, size: float) -> np.ndarray:
    """The gauges of several chambers are not equally bad, nor all the same way."""
    return size * np.array([1.0, -0.5, 0.3])[: read.shape[1]]
