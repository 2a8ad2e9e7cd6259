"""What a least-squares fit knows about its parameters, when neighbouring residuals are correlated.

Residuals of a model that is a little wrong are strongly correlated in time, so n samples are worth only
n (1 - rho) / (1 + rho) independent ones (first-order autoregression; Bayley and Hammersley, J. R. Stat. Soc.
Suppl. 8, 1946); intervals widen accordingly.
"""

from dataclasses import dataclass

import numpy as np

Z95 = 1.959964
TOLERANCE = 1e-3


@dataclass(frozen=True)
class Confidence:
    """Uncertainty of F fitted parameters, in the fit's own scaled units."""

    rho: float  # correlation of residuals of neighbouring samples
    sd: np.ndarray  # (F,) standard deviations; infinite where nothing was learned


def autocorrelation(residual: np.ndarray, adjacent: np.ndarray) -> float:
    """Correlation of neighbouring residuals (n, D), within [0, 0.9999].

    `adjacent` (n,) is True where a sample follows the one before it.
    """
    at = np.flatnonzero(adjacent)
    power = (residual * residual).sum() / max(len(residual), 1)
    if len(at) == 0 or power == 0:
        return 0.0
    together = (residual[at] * residual[at - 1]).sum() / len(at)
    return float(np.clip(together / power, 0.0, 0.9999))


def independent(J: np.ndarray) -> np.ndarray:
    """Which columns of a Jacobian (m, F) add something that the columns before them do not.

    A column counts as dependent when less than `TOLERANCE` of its length is left after projecting out the
    earlier independent ones; so base parameters, which come first, win over effects. One that is shorter than
    a tenth of `TOLERANCE` times the longest moves nothing over its whole range (a yaw, seen in the plane).

    Returns:
        (F,) booleans.
    """
    length = np.linalg.norm(J, axis=0)
    largest = length.max(initial=0.0)
    keep = np.zeros(J.shape[1], bool)
    basis: list[np.ndarray] = []
    for j in range(J.shape[1]):
        if length[j] <= 0.1 * TOLERANCE * largest:
            continue
        column = J[:, j] / length[j]
        for _ in range(2):  # twice, as rounding spoils a single pass
            for b in basis:
                column = column - (b @ column) * b
        left = np.linalg.norm(column)
        if left > TOLERANCE:
            keep[j] = True
            basis.append(column / left)
    return keep


def confidence(J: np.ndarray, residual: np.ndarray, adjacent: np.ndarray, at_bound: np.ndarray) -> Confidence:
    """Uncertainty after a fit, by the Jacobian (n D, F) of scaled residuals (n, D) of the training samples.

    `adjacent` (n,) is True where one directly follows another. Parameters `at_bound` (F,) stay there while
    the others' spread is found, and each gets the spread that it would have alone with those.
    """
    count = J.shape[1]
    rho = autocorrelation(residual, adjacent)
    inflation = (1 + rho) / (1 - rho)
    variance = (residual**2).sum() / max(residual.size - count, 1)
    sd = np.full(count, np.inf)
    inside = np.flatnonzero(~at_bound)
    H = J.T @ J
    if len(inside):
        sd[inside] = np.sqrt(np.diag(_inverse(H[np.ix_(inside, inside)])))
    for j in np.flatnonzero(at_bound):
        which = np.append(inside, j)
        sd[j] = np.sqrt(_inverse(H[np.ix_(which, which)])[-1, -1])
    return Confidence(rho, sd * np.sqrt(variance * inflation))


def _inverse(H: np.ndarray) -> np.ndarray:
    """Inverse of a normal matrix; infinite variance along directions without any information."""
    size = np.sqrt(np.diag(H))
    size[size == 0] = 1.0
    w, V = np.linalg.eigh(H / np.outer(size, size))
    lost = w <= 1e-12 * max(w[-1], 1e-300)
    covariance = (V / np.where(lost, np.inf, w)) @ V.T
    touched = (V[:, lost] ** 2).sum(axis=1) > 1e-3
    covariance[touched, touched] = np.inf
    return covariance / np.outer(size, size)
