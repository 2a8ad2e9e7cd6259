"""Colours of a body without looks of its own: its largest stretch, from calm to warm."""

import numpy as np

STOPS = np.array([[38.0, 150, 155], [238, 200, 110], [226, 74, 51]])  # RGB: calm, half way, most
MOST_STRAIN = 0.15  # of the warmest colour, in a finger or an arm


def strain(gradients: np.ndarray) -> np.ndarray:
    """(...,) largest principal stretch less one of deformation gradients (..., 3, 3)."""
    return np.linalg.svd(np.asarray(gradients, float), compute_uv=False)[..., 0] - 1


def stretch_colours(value: np.ndarray, top: float = MOST_STRAIN) -> np.ndarray:
    """(P, 3) RGB, 0 to 255, from calm to warm for values from 0 to `top`."""
    share = np.clip(value / top, 0, 1) * (len(STOPS) - 1)
    return np.stack([np.interp(share, range(len(STOPS)), stop) for stop in STOPS.T], -1)
