"""Bounded nonlinear least squares for many residuals and few parameters (Levenberg-Marquardt).

scipy.optimize.least_squares decomposes the whole Jacobian in every step and only creeps towards an active
bound; with 10^4 residuals, ten parameters and weights that end at zero, that takes nine tenths of a fit. Here
each step is a small bounded linear least-squares problem in the normal equations, solved exactly by SciPy.
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
