"""How often a finding like this one named the right physics, on devices whose physics was known.

A logistic regression on what a diagnosis knows of itself. Devices: rods of `pneutac_truths`, with one effect
each, half of them with one that no effect or law has a form for; weights by `benchmarks/belief.py`.
"""

import numpy as np

# Constant, per unit of: log of error over noise, log odds of the share, verdict that the form suffices.
WEIGHTS = (-0.86, -1.76, 0.35, 2.28)
EVEN = 0.02  # keeps shares of none and all from being certain


def likely_right(error_over_noise: float, share: float, suffices: bool) -> float:
    """Probability that the headline is the device's physics.

    Args:
        error_over_noise: on test blocks, with what was found.
        share: of the draws of blocks in which it beats the other models in the running.
        suffices: whether the verdict says that nothing of weight is left.
    """
    return float(1 / (1 + np.exp(-(np.array(WEIGHTS) @ features(error_over_noise, share, suffices)))))


def features(error_over_noise, share, suffices) -> np.ndarray:
    """(4, ...) what the weights are of, from numbers or arrays."""
    odds = np.log((np.asarray(share) + EVEN) / (1 - np.asarray(share) + EVEN))
    error = np.log(np.maximum(error_over_noise, 1.0))
    return np.stack(np.broadcast_arrays(1.0, error, odds, np.asarray(suffices, float)))
