"""Creep: part of the bend arrives late, by a Prony series in the creep compliance.

q = (q_el + sum_i w_i s_i) / (1 + sum_i w_i), tau_i s_i' = q_el - s_i, tau = 0.4, 1.3, 4, 13, 40, 130 s. A
factor of about three between neighbours reproduces any one time constant in between within 5 % of the late
part, and leaves weights w_i >= 0 as the only parameters, far easier to fit than free times. The gain
is that of the fully relaxed body. q_el is taken as a straight line between samples (exact step).
"""

import math

import numpy as np

from pneutac_sim.effects import BodyEffect, Parameter, kernel

TIMES_S = (0.4, 1.3, 4.0, 13.0, 40.0, 130.0)
_TAU = np.array(TIMES_S)


@kernel
def run(x, dt, theta, conditions, state):
    """State = the elastic angle before of each channel, then the late parts of each channel."""
    n, channels = x.shape
    m = len(_TAU)
    total = 1.0 + theta.sum()
    keep, old, new = np.empty(m), np.empty(m), np.empty(m)
    last = -1.0
    before, late = state[:channels], state[channels:]
    for t in range(n):
        if dt[t] != last:
            last = dt[t]
            for i in range(m):
                h = last / _TAU[i]
                keep[i] = math.exp(-h)
                old[i] = (1.0 - keep[i]) / h - keep[i] if h > 1e-6 else 0.5 * h
                new[i] = 1.0 - keep[i] - old[i]
        for c in range(channels):
            q = x[t, c]
            sum_late = 0.0
            for i in range(m):
                s = keep[i] * late[m * c + i] + old[i] * before[c] + new[i] * q
                late[m * c + i] = s
                sum_late += theta[i] * s
            before[c] = q
            x[t, c] = (q + sum_late) / total if total != 1.0 else q


def _derive(v: dict[str, float]) -> dict[str, float]:
    """Late share of the bend, and how long until nine tenths of it have arrived."""
    w = np.array([v[f"weight_{_label(tau)}"] for tau in TIMES_S])
    if w.sum() <= 0:
        return {"late_percent": 0.0, "settle_s": 0.0}
    t = np.geomspace(0.01, 1000.0, 2000)
    left = np.exp(-t[:, None] / _TAU) @ w / w.sum()
    return {"late_percent": 100 * w.sum() / (1 + w.sum()), "settle_s": float(t[np.argmax(left < 0.1)])}


def _label(tau: float) -> str:
    return f"{tau:g}s".replace(".", "_")


EFFECT = BodyEffect(
    name="creep",
    stage="material",
    parameters=tuple(
        Parameter(f"weight_{_label(tau)}", "", default=0.04, lower=0.0, upper=12.0) for tau in TIMES_S
    ),
    run=run,
    state_size=lambda channels: channels * (1 + len(TIMES_S)),
    equation=r"q = \frac{q_{el} + \sum_i w_i\,s_i}{1 + \sum_i w_i}, \quad \tau_i\,\dot s_i = q_{el} - s_i",
    cause="creep, {late_percent:.0f} % of the bend over about {settle_s:.2g} s",
    summary="Your {device} creeps: after a step it keeps bending for about {settle_s:.2g} s, and "
    "{late_percent:.0f} % of the bend arrives late.",
    experiment="Step to a high pressure, hold two minutes and log the measured pressure: the bend goes on.",
    derive=_derive,
)
