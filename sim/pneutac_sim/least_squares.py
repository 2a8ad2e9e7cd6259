"""Bounded nonlinear least squares for many residuals and few parameters (Levenberg-Marquardt).

scipy.optimize.least_squares decomposes the whole Jacobian in every step and only creeps towards an active
bound; with 10^4 residuals, ten parameters and weights that end at zero, that takes nine tenths of a fit. Here
each step is a small bounded linear least-squares problem in the normal equations, solved exactly by SciPy.

`confidence` is what a fit knows about its parameters. Residuals of a model that is a little wrong are
strongly correlated in time, so n samples are worth only n (1 - rho) / (1 + rho) independent ones (first-order
autoregression; Bayley and Hammersley, J. R. Stat. Soc. Suppl. 8, 1946); intervals widen accordingly.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.linalg import cholesky, solve_triangular

_LARGEST_STEP = 0.3  # of a parameter's whole range
# A pull towards the start worth this share of the residual's scale over a parameter's whole range. It decides
# only what the data leave open, and keeps flat valleys from costing hundreds of steps.
_PULL = 1e-4


@dataclass(frozen=True)
class Solution:
    """Where the iteration ended: parameters v (F,) in [0, 1], sum of squares, number of Jacobians taken."""

    v: np.ndarray
    cost: float
    steps: int


def minimise(
    residual: Callable[[np.ndarray], np.ndarray],
    jacobian: Callable[[np.ndarray], np.ndarray],
    v: np.ndarray,
    steps: int = 30,
    tolerance: float = 1e-6,
    prior: tuple[np.ndarray, np.ndarray] | None = None,
) -> Solution:
    """Minimises the sum of squares of residuals v -> (m,) over v in [0, 1]^F, from `v` (F,) on.

    The Jacobian, v -> (m, F), is called at the v at which the residual was called last, `steps` times at
    most; it stops where a step promises or brings less than the share `tolerance` of the cost. A prior of
    centres (F,) and weights W (F, F) adds (v - centre) W (v - centre) to the cost; without one there is a
    slight pull towards the start.
    """
    v = np.clip(v, 0.0, 1.0)
    r = residual(v)
    cost = float(r @ r)
    if len(v) == 0:
        return Solution(v, cost, 0)
    slight = _PULL**2 * max(cost, 1e-12) * np.eye(len(v))
    centre, weight = (v.copy(), slight) if prior is None else (prior[0], prior[1] + slight)
    penalty = (lambda v: 0.0) if prior is None else lambda v: float((v - centre) @ weight @ (v - centre))
    cost += penalty(v)
    damping = 1e-3
    for step in range(1, steps + 1):
        J = jacobian(v)
        if not np.isfinite(J).all():
            return Solution(v, cost, step)
        H, g = J.T @ J + weight, J.T @ r + weight @ (v - centre)
        size = np.diag(H)
        accepted = False
        while not accepted and damping < 1e8:
            d = _bounded_step(H + np.diag(damping * size), g, v)
            promised = -(2 * g @ d + d @ H @ d)
            if promised <= tolerance * cost:
                return Solution(v, cost, step)
            trial = residual(v + d)
            new = float(trial @ trial) + penalty(v + d)
            accepted = np.isfinite(new) and new < cost
            gain = (cost - new) / promised
            damping = damping * (0.2 if gain > 0.5 else 1.0) if accepted else damping * 5.0
        if not accepted:
            return Solution(v, cost, step)
        small = cost - new <= tolerance * cost
        v, r, cost = np.clip(v + d, 0.0, 1.0), trial, new
        if small:
            return Solution(v, cost, step)
    return Solution(v, cost, steps)


def _bounded_step(A: np.ndarray, g: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Minimises d A d / 2 + g d with v + d in [0, 1] and |d| limited."""
    R = cholesky(A)
    low, high = np.maximum(-v, -_LARGEST_STEP), np.minimum(1 - v, _LARGEST_STEP)
    free = -solve_triangular(R, solve_triangular(R, g, trans="T"))
    if ((free >= low) & (free <= high)).all():
        return free
    from scipy.optimize import lsq_linear  # half a second to start, which whoever only predicts does not wait

    room = high > low
    return lsq_linear(
        R, -solve_triangular(R, g, trans="T"), bounds=(low, np.where(room, high, low + 1e-12)), method="bvls"
    ).x


@njit(cache=True)
def cholesky_solve(A, y):
    """Solves A x = y into `y` for a positive definite A, of which the lower triangle is used up."""
    n = len(y)
    for c in range(n):
        for k in range(c):
            A[c, c] -= A[c, k] ** 2
        A[c, c] = math.sqrt(A[c, c])
        for r in range(c + 1, n):
            for k in range(c):
                A[r, c] -= A[r, k] * A[c, k]
            A[r, c] /= A[c, c]
    for r in range(n):
        for k in range(r):
            y[r] -= A[r, k] * y[k]
        y[r] /= A[r, r]
    for r in range(n - 1, -1, -1):
        for k in range(r + 1, n):
            y[r] -= A[k, r] * y[k]
        y[r] /= A[r, r]


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
