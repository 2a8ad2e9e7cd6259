"""Compiled loops of the action network: its value, motion of the skeleton under it, and where that rests.

`numbers` are the layers and, in float64, normalisation and box; `x` and `f` are work space in float32.
"""

import numpy as np
from numba import njit

from pneutac_sim.surrogate.skeleton import G, advance

FASTEST_RAD_S = 100.0  # fifteen times what commands bring about
STEPS, RESOLUTION_RAD = 50, 1e-8  # of the search for rest


@njit(cache=True)
def residual(numbers, q, qd, p, x, f):
    """f_r into f[2] (N,); returns whether the state lies in the box, to which the layers' inputs are clipped.

    The straight part goes on beyond it, as an elastic body does.
    """
    (w1, b1, w2, b2, w3, b3), (slope, mean, scale, torque_mean, torque_scale, low, high) = numbers
    n = len(q)
    h1, h2, out = f
    inside, straight = True, torque_mean.copy()
    for i in range(2 * n + 1):
        v = q[i] if i < n else (qd[i - n] if i < 2 * n else p)
        for j in range(n):
            straight[j] += (v - mean[i]) / scale[i] * slope[i, j]
        if not low[i] <= v <= high[i]:
            inside = False
            v = min(max(v, low[i]), high[i])
        x[i] = (v - mean[i]) / scale[i]  # of unit variance
    _layer(x, w1, b1, h1)
    _softsign(h1)
    _layer(h1, w2, b2, h2)
    _softsign(h2)
    _layer(h2, w3, b3, out)
    for i in range(n):
        out[i] = straight[i] + torque_scale[i] * out[i]
    return inside


@njit(cache=True)
def _layer(x, w, b, y):
    for i in range(len(y)):
        y[i] = b[i]
    for j in range(len(x)):
        a = x[j]
        for i in range(len(y)):  # along memory, so that it becomes vector instructions
            y[i] += a * w[j, i]


@njit(cache=True)
def _softsign(y):
    for i in range(len(y)):  # y / (1 + |y|): smooth enough, and cheaper than tanh
        y[i] /= np.float32(1) + abs(y[i])


@njit(cache=True)
def roll(A, inertia, K, D, loss, numbers, x, f, q, qd, targets, pressure, substeps, h, out_q, out_v, inside):
    """Motion over S targets of `substeps` steps of `h` seconds each; see `ActionNetwork.roll`."""
    n = len(q)
    extra, target, end = np.empty(n), np.empty(n), np.empty(n)
    for s in range(len(out_q)):
        for k in range(substeps):
            # targets and pressure run straight from one control step to the next
            middle, last = (k + 0.5 * G) / substeps, (k + 1) / substeps
            p = pressure[s] + middle * (pressure[s + 1] - pressure[s])
            residual(numbers, q + 0.5 * h * qd, qd, p, x, f)
            for i in range(n):
                extra[i] = f[2][i]
                rise = targets[s + 1, i] - targets[s, i]
                target[i] = targets[s, i] + middle * rise
                end[i] = targets[s, i] + last * rise
            advance(A, inertia, K, D, loss, q, qd, target, end, extra, h, FASTEST_RAD_S)
        inside[s] = residual(numbers, q, qd, pressure[s + 1], x, f)
        for i in range(n):
            out_q[s, i], out_v[s, i] = q[i], qd[i]


@njit(cache=True)
def resistance(numbers, q_free, q, p, near, x, f, torque, J):
    """Into `torque` and `J`, see `ActionNetwork.resistance`; returns whether `q` lies in the box."""
    n = len(q)
    still, at = np.zeros(n), q.copy()
    for i in range(n):
        at[i] = q[i] + near
        residual(numbers, at, still, p, x, f)
        for j in range(n):
            J[j, i] = f[2][j]
        at[i] = q[i] - near
        residual(numbers, at, still, p, x, f)
        for j in range(n):
            J[j, i] = (J[j, i] - f[2][j]) / (2.0 * near)
        at[i] = q[i]
    for i in range(n):
        for j in range(i):
            J[i, j] = J[j, i] = 0.5 * (J[i, j] + J[j, i])
    residual(numbers, q_free, still, p, x, f)
    for i in range(n):
        torque[i] = -f[2][i]
    inside = residual(numbers, q, still, p, x, f)
    for i in range(n):
        torque[i] += f[2][i]
    return inside


@njit(cache=True)
def rest(K, numbers, x, f, q, p):
    """Fixed-point iteration from the target in `q`: the body gives way by a few percent of the controller."""
    target, still = q.copy(), np.zeros(len(q))
    inside = True
    for _ in range(STEPS):
        inside = residual(numbers, q, still, p, x, f)
        change = 0.0
        for i in range(len(q)):
            new = target[i] + f[2][i] / K  # K (q - target) = f_r(q, 0, p)
            change = max(change, abs(new - q[i]))
            q[i] = new
        if change < RESOLUTION_RAD:
            break
    return inside
