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
ADDED, GAIN = range(2)


@kernel
def _lag(s, at, f, before, dt, tau):
    """Exact step of tau s' = f - s with f a straight line since the sample before."""
    h = dt / tau
    if math.isinf(h):
        s[at] = f
        return f
    keep = math.exp(-h)
    old = (1.0 - keep) / h - keep if h > 1e-6 else 0.5 * h
    s[at] = keep * s[at] + old * before + (1.0 - keep - old) * f
    return s[at]


@kernel
def mode(s, f, before, dt, omega, zeta):
    """Exact steps of y'' + 2 zeta omega y' + omega^2 (y - f) = 0 with f held at the middle of each piece."""
    slowest = omega * (zeta if zeta < 1.0 else zeta - math.sqrt(zeta * zeta - 1.0))
    if slowest * dt > 30.0:
        s[2], s[3] = f, 0.0
        return f
    pieces = min(1 + int(omega * dt / 0.4), 40)
    h = dt / pieces
    decay = math.exp(-zeta * omega * h)
    if zeta < 0.9999:
        w = omega * math.sqrt(1.0 - zeta * zeta)
        c, sn = math.cos(w * h), math.sin(w * h) / w
    elif zeta > 1.0001:
        w = omega * math.sqrt(zeta * zeta - 1.0)
        c, sn = math.cosh(w * h), math.sinh(w * h) / w
    else:
        c, sn = 1.0, h
    for i in range(pieces):
        goal = before + (f - before) * (i + 0.5) / pieces
        d, v = s[2] - goal, s[3]
        s[2] = goal + decay * (d * (c + zeta * omega * sn) + v * sn)
        s[3] = decay * (v * (c - zeta * omega * sn) - d * omega * omega * sn)
    return s[2]


@kernel
def _loop(s, f, before, width):
    """Bouc-Wen without stiffness: z' = (f' - |f'| |z|^0.3 z) / width, times width."""
    d = f - before
    pieces = 1 + int(min(20.0 * abs(d) / width, 400.0))
    d /= pieces * width
    for _ in range(pieces):
        s[2] = min(1.0, max(-1.0, s[2] + d - abs(d) * abs(s[2]) ** 0.3 * s[2]))
    return width * s[2]


@kernel
def _remember(kind, f, before, dt, k, x, warm, scale, s):
    """What one channel's memory of the input f gives now; kPa where f is."""
    if kind == PLAIN:
        return f
    if kind == LAG:
        return _lag(s, 2, f, before, dt, k[0])
    if kind == LAG_WARM:
        return _lag(s, 2, f, before, dt, k[0] * k[1] ** warm)
    if kind == LAG_PRESSURE:
        return _lag(s, 2, f, before, dt, k[0] * k[1] ** (x / scale))
    if kind == SPECTRUM:
        total, weight = 0.0, 0.0
        for i in range(len(TIMES_S)):
            w = TIMES_S[i] ** k[0]
            total += w * _lag(s, 2 + i, f, before, dt, TIMES_S[i])
            weight += w
        return total / weight
    if kind == FILL_VENT:
        return _lag(s, 2, f, before, dt, k[0] if f > s[2] else k[1])
    if kind == MODE:
        return mode(s, f, before, dt, k[0], k[1])
    if kind == PLAY or kind == PLAY_CUBED or kind == FLIP:
        s[2] = min(max(s[2], f - k[0]), f + k[0])
        if kind == PLAY:
            return s[2]
        if kind == PLAY_CUBED:
            return s[2] ** 3 / scale**2
        return scale * math.tanh((s[2] - k[1]) / k[2])
    if kind == PLAY_TWO:
        s[2] = min(max(s[2], f - k[0]), f + k[1])
        return s[2]
    if kind == LOOP:
        return _loop(s, f, before, k[0])
    if kind == FADING:
        s[2] = max(s[2] * math.exp(-dt / k[0]), f)
        return s[2]
    if kind == PATH:
        s[2] += abs(f - before)
        return scale * (1.0 - 1.0 / (1.0 + s[2] / k[0]))
    if kind == HELD:
        if math.isinf(dt) or abs(f - before) > 1e-6 * scale:
            s[2] = 0.0
        else:
            e = math.exp(-k[0] * dt)
            s[2] = s[2] * e - f * (1.0 - e)
        return s[2]
    if kind == BELOW:
        s[2] = max(s[2], f, 1e-9)
        return scale * (1.0 - max(f, 0.0) / s[2]) ** k[0]
    if kind == TANH_OF:
        return scale * math.tanh(_lag(s, 2, f, f, dt, k[1]) / k[0])
    if kind == DEAD_BAND:
        if math.isinf(dt) or abs(f - s[2]) > k[0]:
            s[2] = f
        return s[2]
    if kind == FADING_TIME:
        return scale * math.exp(-warm / k[0])
    if kind == POWER:
        return math.copysign(scale * abs(f / scale) ** k[0], f)
    if kind == TANH:
        return scale * math.tanh(k[0] * f / scale) / k[0]
    if kind == HINGE:
        return max(f - k[0], 0.0)
    if kind == CUBE:
        return f**3 / scale**2
    return scale * math.sqrt(abs(_lag(s, 2, f, f, dt, k[0])) / scale)  # ROOT_LAG


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
    for t in range(n):
        c = (conditions[t, 0] - theta[5]) / theta[6] if condition > 0 else 1.0
        for i in range(channels):
            s = state[SLOTS * i : SLOTS * (i + 1)]
            p, h = x[t, i], dt[t]
            fresh = s[0] == 0.0
            rate = 0.0 if fresh or math.isinf(h) else (p - s[1]) / h
            s[1] = p  # of the input itself; the memory's own input before is kept last
            if source == P:
                f = p
            elif source == P_SQUARED:
                f = p * abs(p) / scale
            elif source == CONDITION:
                f = scale * c
            elif source == WORK:
                f = abs(p * rate) / scale
            else:
                f = rate if source == RATE else abs(rate)
            before = f if fresh or source >= RATE else s[SLOTS - 1]  # a rate holds since the sample before
            if fresh:
                h = math.inf
            m = _remember(kind, f, before, h, k, p, c, scale, s) - minus * f
            s[0], s[SLOTS - 1] = 1.0, f
            if role == GAIN:
                m *= p / scale
            x[t, i] = p + weight * m * (c if condition == 1 else 1.0)


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
    for t in range(n):
        for i in range(channels):
            f = x[t, i]
            x[t, i] = _lag(state, channels + i, f, state[i], dt[t], theta[0])
            state[i] = f
