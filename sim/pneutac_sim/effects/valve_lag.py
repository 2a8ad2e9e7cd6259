"""Valve lag: first-order filling and venting, tau p' = p_cmd - p, each with its own time constant.

The command is taken as a straight line between samples, for which the step is exact.
"""

import math

from pneutac_sim.effects.body_effect import BodyEffect, kernel
from pneutac_sim.effects.effect import Parameter


@kernel
def run(x, dt, theta, conditions, state):
    """State = per channel the pressure and the command before."""
    n, channels = x.shape
    p, before = state[:channels], state[channels:]
    for t in range(n):
        for c in range(channels):
            command = x[t, c]
            tau = theta[0] if command > p[c] else theta[1]
            h = dt[t] / tau
            keep = math.exp(-h)
            old = (1.0 - keep) / h - keep if h > 1e-6 else 0.5 * h  # weight of the command before
            if math.isinf(h):
                p[c] = command
            else:
                p[c] = keep * p[c] + old * before[c] + (1.0 - keep - old) * command
            before[c] = command
            x[t, c] = p[c]


EFFECT = BodyEffect(
    name="valve_lag",
    stage="pneumatics",
    parameters=(
        Parameter("fill_time_s", "s", default=0.3, lower=0.005, upper=3.0, log=True),
        Parameter("vent_time_s", "s", default=0.3, lower=0.005, upper=3.0, log=True),
    ),
    run=run,
    apart=True,
    state_size=lambda channels: 2 * channels,
    equation=r"\tau\,\dot p = p_{cmd} - p",
    cause="a slow valve, {fill_time_s:.2g} s to fill and {vent_time_s:.2g} s to vent",
    summary="Your pressure lags its command: filling takes about {fill_time_s:.2g} s, venting "
    "{vent_time_s:.2g} s.",
    experiment="Log the measured pressure in single steps up and down: a lag shows in it, creep does not.",
)
