"""Leak: while the valve holds (the command does not change) the gauge pressure decays, p' = -k p."""

import math

from pneutac_sim.effects import BodyEffect, Parameter, kernel

_STILL_KPA = 1e-6  # a command that changes by less is held; rounding changes it by far less


@kernel
def run(x, dt, theta, conditions, state):
    """State = per channel the share of the pressure still there and the command before."""
    n, channels = x.shape
    left, before = state[:channels], state[channels:]
    for t in range(n):
        for c in range(channels):
            command = x[t, c]
            if math.isinf(dt[t]) or abs(command - before[c]) > _STILL_KPA:
                left[c] = 1.0  # the valve opens and fills up again
            else:
                left[c] *= math.exp(-theta[0] * dt[t])
            before[c] = command
            x[t, c] = command * left[c]


EFFECT = BodyEffect(
    name="leak",
    stage="pneumatics",
    parameters=(Parameter("leak_rate_1_per_s", "1/s", default=0.01, lower=0.0, upper=0.5),),
    run=run,
    apart=True,
    state_size=lambda channels: 2 * channels,
    equation=r"\dot p = -k\,p \text{ while } \dot p_{cmd} = 0",
    cause="loss of pressure during holds, {percent_per_min:.0f} % a minute",
    summary="Your {device} leaks: while the valve holds it loses {percent_per_min:.0f} % of its pressure a "
    "minute.",
    experiment="Hold a high pressure for two minutes with the valve shut and log the measured pressure.",
    derive=lambda v: {"percent_per_min": 100 * (1 - math.exp(-60 * v["leak_rate_1_per_s"]))},
)
