"""What laws remember: the compiled interpreter that runs all of them.

Sources: first-order lags; a power-law spectrum of them (a spring-pot: Nutting, J. Franklin Inst. 191, 1921);
second order; play and Bouc-Wen loops (Macki, Nistri, Zecca, SIAM Review 35, 1993); a maximum that fades
(Mullins: Diani, Fayolle, Gilormini, Eur. Polym. J. 45, 2009); path travelled; loss while held.
"""

import math

import numpy as np

from pneutac_sim.effects.body_effect import kernel

SLOTS = 16  # numbers that a channel remembers: whether it has begun, its input before, and the memory's own
TIMES_S = np.geomspace(0.1, 400.0, 12)  # of the power-law spectrum

# Codes of the interpreter.
P, P_SQUARED, CONDITION, RATE, SPEED, WORK = range(6)  # p, p |p| / P, P c, dp/dt, |dp/dt|, p |dp/dt| / P
PLAIN, LAG, LAG_WARM, LAG_PRESSURE, SPECTRUM, FILL_VENT, MODE, PLAY, PLAY_TWO, LOOP, FADING, PATH = range(12)
HELD, BELOW, FLIP, PLAY_CUBED, TANH_OF, POWER, TANH, HINGE, CUBE, ROOT_LAG, DEAD_BAND, FADING_TIME = range(
    12, 24
)
STEP = 24
ADDED, GAIN = range(2)


@kernel
def _weights(h):
    """Weights of the state and of the input before, after h time constants."""
    keep = math.exp(-h)
    return keep, 0.0 if math.isinf(h) else (1.0 - keep) / h - keep if h > 1e-6 else 0.5 * h


@kernel
def mode(s, f, dt, omega, zeta, out):
    """Exact steps of y'' + 2 zeta omega y' + omega^2 (y - f) = 0 with f held at the middle of each piece.

    Args:
        s: rows 2 and 3 are y and y' (channels,), changed.
        f: (n + 1, channels), first the one before.
        dt: (n,) s.
        omega: rad/s.
        zeta: damping ratio.
        out: (n, channels) y, written.
    """
    slowest = omega * (zeta if zeta < 1.0 else zeta - math.sqrt(zeta * zeta - 1.0))
    known, decay, c, sn, pieces = -1.0, 0.0, 0.0, 0.0, 1
    for t in range(len(out)):
        if slowest * dt[t] > 30.0:
            for i in range(out.shape[1]):
                s[2, i], s[3, i], out[t, i] = f[t + 1, i], 0.0, f[t + 1, i]
            continue
        if dt[t] != known:
            known = dt[t]
            pieces = min(1 + int(omega * known / 0.4), 40)
            h = known / pieces
            decay = math.exp(-zeta * omega * h)
            if zeta < 0.9999:
                w = omega * math.sqrt(1.0 - zeta * zeta)
                c, sn = math.cos(w * h), math.sin(w * h) / w
            elif zeta > 1.0001:
                w = omega * math.sqrt(zeta * zeta - 1.0)
                c, sn = math.cosh(w * h), math.sinh(w * h) / w
            else:
                c, sn = 1.0, h
        for piece in range(pieces):
            share = (piece + 0.5) / pieces
            for i in range(out.shape[1]):
                goal = f[t, i] + (f[t + 1, i] - f[t, i]) * share
                d, v = s[2, i] - goal, s[3, i]
                s[2, i] = goal + decay * (d * (c + zeta * omega * sn) + v * sn)
                s[3, i] = decay * (v * (c - zeta * omega * sn) - d * omega * omega * sn)
        for i in range(out.shape[1]):
            out[t, i] = s[2, i]


@kernel
def _loop(z, f, before, width):
    """Bouc-Wen without stiffness: z' = (f' - |f'| |z|^0.3 z) / width."""
    d = f - before
    pieces = 1 + int(min(20.0 * abs(d) / width, 400.0))
    d /= pieces * width
    for _ in range(pieces):
        z = min(1.0, max(-1.0, z + d - abs(d) * abs(z) ** 0.3 * z))
    return z


@kernel
def _lag(s, at, f, late, dt, tau, out):
    """Exact steps of tau s' = f - s, row `at` of s, written to out; see `_remember`."""
    known, keep, old = -1.0, 0.0, 0.0
    for t in range(len(out)):
        h = dt[t] / tau[t % len(tau)]
        if h != known:  # most samples follow each other after the same time
            known = h
            keep, old = _weights(h)
        for i in range(out.shape[1]):
            s[at, i] = keep * s[at, i] + old * f[t + late, i] + (1.0 - keep - old) * f[t + 1, i]
            out[t, i] = s[at, i]


@kernel
def _remember(kind, f, late, dt, k, x, warm, scale, s, out):
    """Writes what memories of f (n + 1, channels), that before first, give; `late`: it holds from there."""
    n, channels = x.shape
    if kind == PLAIN:
        for t in range(n):
            for i in range(channels):
                out[t, i] = f[t + 1, i]
    elif kind == LAG:
        _lag(s, 2, f, late, dt, k[:1], out)
    elif kind == LAG_WARM:
        _lag(s, 2, f, late, dt, k[0] * k[1] ** warm, out)
    elif kind == LAG_PRESSURE:
        for t in range(n):
            for i in range(channels):
                keep, old = _weights(dt[t] / (k[0] * k[1] ** (x[t, i] / scale)))
                s[2, i] = keep * s[2, i] + old * f[t + late, i] + (1.0 - keep - old) * f[t + 1, i]
                out[t, i] = s[2, i]
    elif kind == SPECTRUM:
        weight = TIMES_S ** k[0]
        weight /= weight.sum()
        known, keeps, olds = -1.0, np.zeros(len(TIMES_S)), np.zeros(len(TIMES_S))
        for t in range(n):
            for i in range(channels):
                out[t, i] = 0.0
            for j in range(len(TIMES_S)):
                if dt[t] != known:
                    keeps[j], olds[j] = _weights(dt[t] / TIMES_S[j])
                keep, old, w = keeps[j], olds[j], weight[j]
                for i in range(channels):
                    y = keep * s[2 + j, i] + old * f[t + late, i] + (1.0 - keep - old) * f[t + 1, i]
                    s[2 + j, i] = y
                    out[t, i] += w * y
            known = dt[t]
    elif kind == FILL_VENT:
        known, keeps, olds = -1.0, np.zeros(2), np.zeros(2)
        for t in range(n):
            if dt[t] != known:
                known = dt[t]
                for j in range(2):
                    keeps[j], olds[j] = _weights(known / k[j])
            for i in range(channels):
                way = 0 if f[t + 1, i] > s[2, i] else 1
                keep, old = keeps[way], olds[way]
                s[2, i] = keep * s[2, i] + old * f[t + late, i] + (1.0 - keep - old) * f[t + 1, i]
                out[t, i] = s[2, i]
    elif kind == MODE:
        mode(s, f, dt, k[0], k[1], out)
    elif kind == PLAY or kind == PLAY_TWO:
        up = k[1] if kind == PLAY_TWO else k[0]
        for t in range(n):
            for i in range(channels):
                s[2, i] = min(max(s[2, i], f[t + 1, i] - k[0]), f[t + 1, i] + up)
                out[t, i] = s[2, i]
    elif kind == PLAY_CUBED:
        for t in range(n):
            for i in range(channels):
                s[2, i] = min(max(s[2, i], f[t + 1, i] - k[0]), f[t + 1, i] + k[0])
                out[t, i] = s[2, i] ** 3 / scale**2
    elif kind == FLIP:
        for t in range(n):
            for i in range(channels):
                s[2, i] = min(max(s[2, i], f[t + 1, i] - k[0]), f[t + 1, i] + k[0])
                out[t, i] = scale * math.tanh((s[2, i] - k[1]) / k[2])
    elif kind == LOOP:
        for t in range(n):
            for i in range(channels):
                s[2, i] = _loop(s[2, i], f[t + 1, i], f[t + late, i], k[0])
                out[t, i] = k[0] * s[2, i]
    elif kind == FADING:
        for t in range(n):
            keep = math.exp(-dt[t] / k[0])
            for i in range(channels):
                s[2, i] = max(s[2, i] * keep, f[t + 1, i])
                out[t, i] = s[2, i]
    elif kind == PATH:
        for t in range(n):
            for i in range(channels):
                s[2, i] += abs(f[t + 1, i] - f[t + late, i])
                out[t, i] = scale * (1.0 - 1.0 / (1.0 + s[2, i] / k[0]))
    elif kind == HELD:
        for t in range(n):
            keep = math.exp(-dt[t] * k[0])
            for i in range(channels):
                moved = math.isinf(dt[t]) or abs(f[t + 1, i] - f[t + late, i]) > 1e-6 * scale
                s[2, i] = 0.0 if moved else s[2, i] * keep - f[t + 1, i] * (1.0 - keep)
                out[t, i] = s[2, i]
    elif kind == BELOW:
        for t in range(n):
            for i in range(channels):
                s[2, i] = max(s[2, i], f[t + 1, i], 1e-9)
                out[t, i] = scale * (1.0 - max(f[t + 1, i], 0.0) / s[2, i]) ** k[0]
    elif kind == TANH_OF:
        _lag(s, 2, f, 1, dt, k[1:2], out)
        for t in range(n):
            for i in range(channels):
                out[t, i] = scale * math.tanh(out[t, i] / k[0])
    elif kind == STEP:
        for t in range(n):
            for i in range(channels):
                out[t, i] = scale * math.tanh((f[t + 1, i] - k[0]) / k[1])
    elif kind == DEAD_BAND:
        for t in range(n):
            for i in range(channels):
                if math.isinf(dt[t]) or abs(f[t + 1, i] - s[2, i]) > k[0]:
                    s[2, i] = f[t + 1, i]
                out[t, i] = s[2, i]
    elif kind == FADING_TIME:
        for t in range(n):
            for i in range(channels):
                out[t, i] = scale * math.exp(-warm[t] / k[0])
    elif kind == POWER:
        for t in range(n):
            for i in range(channels):
                out[t, i] = math.copysign(scale * abs(f[t + 1, i] / scale) ** k[0], f[t + 1, i])
    elif kind == TANH:
        for t in range(n):
            for i in range(channels):
                out[t, i] = scale * math.tanh(k[0] * f[t + 1, i] / scale) / k[0]
    elif kind == HINGE:
        for t in range(n):
            for i in range(channels):
                out[t, i] = max(f[t + 1, i] - k[0], 0.0)
    elif kind == CUBE:
        for t in range(n):
            for i in range(channels):
                out[t, i] = f[t + 1, i] ** 3 / scale**2
    else:  # ROOT_LAG
        _lag(s, 2, f, 1, dt, k[:1], out)
        for t in range(n):
            for i in range(channels):
                out[t, i] = scale * math.sqrt(abs(out[t, i]) / scale)


@kernel
def run_drive(x, dt, theta, conditions, state):
    """Theta = codes (input, memory, role, minus, condition, its zero and unit), weight, P, constants."""
    source, kind, role, minus, condition = (
        int(theta[0]),
        int(theta[1]),
        int(theta[2]),
        theta[3],
        int(theta[4]),
    )
    weight, scale, k = theta[7], theta[8], theta[9:]
    n, channels = x.shape
    s = state.reshape(channels, SLOTS).T.copy()  # a row a slot: channels side by side
    h, c, f, m = dt.copy(), np.ones(n), np.empty((n + 1, channels)), np.empty((n, channels))
    if condition > 0:
        c = (conditions[:, 0] - theta[5]) / theta[6]
    fresh = s[0, 0] == 0.0
    h[0] = math.inf if fresh else h[0]
    for t in range(n):
        for i in range(channels):
            p = x[t, i]
            rate = 0.0 if math.isinf(h[t]) else (p - (x[t - 1, i] if t > 0 else s[1, i])) / h[t]
            if source == P:
                f[t + 1, i] = p
            elif source == P_SQUARED:
                f[t + 1, i] = p * abs(p) / scale
            elif source == CONDITION:
                f[t + 1, i] = scale * c[t]
            elif source == WORK:
                f[t + 1, i] = abs(p * rate) / scale
            else:
                f[t + 1, i] = rate if source == RATE else abs(rate)
    for i in range(channels):
        f[0, i] = f[1, i] if fresh else s[SLOTS - 1, i]
        s[0, i], s[1, i], s[SLOTS - 1, i] = 1.0, x[n - 1, i], f[n, i]
    # a rate holds since the sample before
    _remember(kind, f, 1 if source >= RATE else 0, h, k, x, c, scale, s, m)
    for t in range(n):
        factor = weight * (c[t] if condition == 1 else 1.0)
        for i in range(channels):
            x[t, i] += factor * (m[t, i] - minus * f[t + 1, i]) * (x[t, i] / scale if role == GAIN else 1.0)
    state[:] = s.T.copy().reshape(channels * SLOTS)


@kernel
def run_seen(x, dt, theta, conditions, state):
    """Theta = codes (output, feature, its zero, unit), weight; conditions = length_mm, its column."""
    out, feature, weight = int(theta[0]), int(theta[1]), theta[4]
    for t in range(len(x)):
        length = conditions[t, 0] if out < 3 else 1.0
        if feature == 0:
            f = x[t, 2] * x[t, 2] / (length * length)
        elif feature == 1:
            f = x[t, 0] * x[t, 2] / (length * length)
        elif feature == 2:
            f = (conditions[t, 1] - theta[2]) / theta[3]
        else:
            f = x[t, 3] * x[t, 3]
        x[t, out] += weight * length * f


@kernel
def run_tracker(x, dt, theta, conditions, state):
    """A camera or tracker that filters: all markers lag; theta = time; state = before, lagged of each."""
    n, channels = x.shape
    s = state.reshape(2, channels)
    f = np.empty((n + 1, channels))
    f[0], f[1:] = s[0], x
    _lag(s, 1, f, 0, dt, theta[:1], x)
    s[0] = f[n]
