"""Valve lag: first-order filling and venting, tau p' = p_cmd - p, each with its own time constant.

The command is taken as a straight line between samples, for which the step is exact.
"""

import numpy as np

from pneutac_sim.effects import BodyEffect, Parameter, kernel
from pneutac_sim.effects.laws import fill_vent_lag


@kernel
def run(x, dt, theta, conditions, state):
    """State, a row each: nothing, the command before, the pressure."""
    n, channels = x.shape
    s, f = state.reshape(3, channels), np.empty((n + 1, channels))
    for i in range(channels):
        f[0, i] = s[1, i]
    for t in range(n):  # not whole arrays: Numba takes seconds to compile the check of their shapes
        for i in range(channels):
            f[t + 1, i] = x[t, i]
    y = fill_vent_lag(s, f, dt, theta)
    for t in range(n):
        for i in range(channels):
            x[t, i] = y[t, i]
    for i in range(channels):
        s[1, i] = f[n, i]


EFFECT = BodyEffect(
    name="valve_lag",
    stage="pneumatics",
    parameters=(
        Parameter("fill_time_s", "s", default=0.3, lower=0.005, upper=3.0, log=True),
        Parameter("vent_time_s", "s", default=0.3, lower=0.005, upper=3.0, log=True),
    ),
    run=run,
    apart=True,
    state_size=lambda channels: 3 * channels,
    equation=r"\tau\,\dot p = p_{cmd} - p, \quad "
    r"\tau = \tau_{fill} \text{ where } p_{cmd} > p, \text{ else } \tau_{vent}",
    cause="a slow valve, {fill_time_s:.2g} s to fill and {vent_time_s:.2g} s to vent",
    summary="Your pressure lags its command: filling takes about {fill_time_s:.2g} s, venting "
    "{vent_time_s:.2g} s.",
    experiment="Log the measured pressure in single steps up and down: a lag shows in it, creep does not.",
)
