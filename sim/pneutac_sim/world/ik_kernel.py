"""Compiled inverse kinematics of an arm with modified Denavit-Hartenberg parameters."""

import math

import numpy as np
from numba import njit

TASK = 6  # position and rotation


@njit(cache=True)
def solve(q, position, rotation, a, d, ca, sa, flange_m, low, high, damping2, iterations):
    """Moves joint angles `q` (7,) by damped least squares, `dq = J^T (J J^T + damping2 I)^-1 e`.

    Args:
        q: rad; overwritten.
        position: (3,) m, where the flange has to be.
        rotation: (3, 3), how it has to stand.
        a: link offsets (7,), m.
        d: joint offsets (7,), m.
        ca: cosines (7,) of the twists.
        sa: their sines.
        flange_m: from the last frame along its z.
        low: lower limits (7,) of the joints, rad.
        high: upper ones.
        damping2: square of the damping.
        iterations: number of them.
    """
    n = len(q)
    J, A, y = np.empty((TASK, n)), np.empty((TASK, TASK)), np.empty(TASK)
    R, p = np.empty((3, 3)), np.empty(3)
    axes, origins = np.empty((n, 3)), np.empty((n, 3))
    for _ in range(iterations):
        R[:] = 0.0
        R[0, 0] = R[1, 1] = R[2, 2] = 1.0
        p[:] = 0.0
        for i in range(n):
            ct, st = math.cos(q[i]), math.sin(q[i])
            for r in range(3):
                x, s, z = R[r]
                p[r] += a[i] * x - sa[i] * d[i] * s + ca[i] * d[i] * z
                R[r, 0] = ct * x + st * (ca[i] * s + sa[i] * z)
                R[r, 1] = -st * x + ct * (ca[i] * s + sa[i] * z)
                R[r, 2] = ca[i] * z - sa[i] * s
                axes[i, r], origins[i, r] = R[r, 2], p[r]
        for r in range(3):
            p[r] += flange_m * R[r, 2]
        for i in range(n):
            z, o = axes[i], origins[i]
            u, v, w = p[0] - o[0], p[1] - o[1], p[2] - o[2]
            J[0, i], J[1, i], J[2, i] = z[1] * w - z[2] * v, z[2] * u - z[0] * w, z[0] * v - z[1] * u
            J[3, i], J[4, i], J[5, i] = z
        _error(position, rotation, p, R, y)
        for r in range(TASK):
            for c in range(r + 1):
                A[r, c] = damping2 if r == c else 0.0
                for i in range(n):
                    A[r, c] += J[r, i] * J[c, i]
        _cholesky_solve(A, y)
        for i in range(n):
            step = 0.0
            for r in range(TASK):
                step += J[r, i] * y[r]
            q[i] = min(max(q[i] + step, low[i]), high[i])


@njit(cache=True)
def _error(position, rotation, p, R, e):
    """Into `e` (6,): what is missing in position, and the rotation vector of `rotation` R^T."""
    trace = 0.0
    E = np.zeros((3, 3))
    for r in range(3):
        e[r] = position[r] - p[r]
        for c in range(3):
            for k in range(3):
                E[r, c] += rotation[r, k] * R[c, k]
        trace += E[r, r]
    x, y, z = 0.5 * (E[2, 1] - E[1, 2]), 0.5 * (E[0, 2] - E[2, 0]), 0.5 * (E[1, 0] - E[0, 1])
    sine = math.sqrt(x * x + y * y + z * z)
    scale = math.atan2(sine, 0.5 * (trace - 1.0)) / sine if sine > 1e-12 else 1.0
    e[3], e[4], e[5] = scale * x, scale * y, scale * z


@njit(cache=True)
def _cholesky_solve(A, y):
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
