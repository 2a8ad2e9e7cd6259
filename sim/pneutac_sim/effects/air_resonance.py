"""Air of second order: line and chamber overshoot, p'' + 2 zeta omega p' + omega^2 (p - p_cmd) = 0.

A line's inductance and a chamber's capacity make a resonator (Blackburn, Reethof, Shearer, Fluid Power
Control, 1960, ch. 5). The command is taken as a straight line between samples.
"""

import math

import numpy as np

from pneutac_sim.effects import BodyEffect, Parameter, kernel
from pneutac_sim.effects.body_effect import in_lines, replace_by


@kernel
def _mode_weights(omega, zeta, h):
    """What y and y' h seconds later are made of, where the input f goes in a straight line.

    Returns:
        Weights of y, y' and the input then for y, and the same for y'. The input before has what is left of
        1 and 0.
    """
    if math.isinf(omega * h):
        return 0.0, 0.0, 1.0, 0.0, 0.0, 0.0
    decay = math.exp(-zeta * omega * h)
    if zeta < 0.9999:
        w = omega * math.sqrt(1.0 - zeta * zeta)
        c, sn = decay * math.cos(w * h), decay * math.sin(w * h) / w
    elif zeta > 1.0001:
        w = omega * math.sqrt(zeta * zeta - 1.0)
        slow, quick = math.exp((w - zeta * omega) * h), math.exp(-(w + zeta * omega) * h)
        c, sn = 0.5 * (slow + quick), 0.5 * (slow - quick) / w
    else:
        c, sn = decay, decay * h
    yy, yv, vy, vv = c + zeta * omega * sn, sn, -omega * omega * sn, c - zeta * omega * sn
    x = omega * h
    if x < 1e-4:  # the terms below would cancel
        return yy, yv, x * x / 6.0 * (1.0 - 0.5 * zeta * x), vy, vv, 0.5 * omega * x * (1.0 - zeta * x / 1.5)
    behind = 2.0 * zeta / x
    return yy, yv, 1.0 - behind + behind * yy - yv / h, vy, vv, (1.0 - vv) / h + behind * vy


@kernel
def second_order(s, f, dt, omega, zeta):
    """Exact steps of y'' + 2 zeta omega y' + omega^2 (y - f) = 0 for f in straight lines.

    Returns y (n, channels). Rows 2 and 3 of s are y and y' (channels,), changed; f is (n + 1, channels),
    first the one before.
    """
    out = np.empty((len(f) - 1, f.shape[1]))
    y, v = s[2].copy(), s[3].copy()  # arrays of its own, which the compiler knows to be no part of f
    known = -1.0
    yy = yv = yf = vy = vv = vf = 0.0
    for t in range(len(out)):
        if dt[t] != known:
            known = dt[t]
            yy, yv, yf, vy, vv, vf = _mode_weights(omega, zeta, known)
        for i in range(out.shape[1]):
            old, new, before = f[t, i], f[t + 1, i], y[i]
            y[i] = yy * before + yv * v[i] + yf * new + (1.0 - yy - yf) * old
            v[i] = vy * before + vv * v[i] + vf * new - (vy + vf) * old
            out[t, i] = y[i]
    for i in range(out.shape[1]):
        s[2, i], s[3, i] = y[i], v[i]
    return out


@kernel
def run(x, dt, theta, conditions, state):
    """State, a row each: nothing, the input before, pressure and its rate."""
    s, f = in_lines(x, state, 4)
    replace_by(x, second_order(s, f, dt, theta[0], theta[1]), s, f)


EFFECT = BodyEffect(
    name="air_resonance",
    stage="pneumatics",
    parameters=(
        Parameter("frequency_rad_per_s", "rad/s", 15.0, 1.0, 150.0, neutral=math.inf, log=True),
        Parameter("damping_ratio", "", 0.5, 0.02, 4.0, neutral=1.0, log=True),
    ),
    run=run,
    apart=True,
    state_size=lambda channels: 4 * channels,
    equation=r"\ddot p + 2\zeta\omega\,\dot p + \omega^2 (p - p_{cmd}) = 0",
    cause="pressure oscillation in hose and chamber, {hz:.2g} Hz, damping ratio {damping_ratio:.2g}",
    summary="Your pressure oscillates in hose and chamber at {hz:.2g} Hz, damping ratio {damping_ratio:.2g}.",
    experiment="Log the measured pressure at 50 Hz or more after a step: it overshoots, or arrives in an S.",
    derive=lambda v: {"hz": v["frequency_rad_per_s"] / (2 * math.pi)},
)
