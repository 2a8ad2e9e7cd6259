"""Valve lag: first-order filling and venting, tau p' = p_cmd - p, each with its own time constant.

The command is taken as a straight line between samples, for which the step is exact.
"""

from pneutac_sim.effects.body_effect import BodyEffect, kernel
from pneutac_sim.effects.effect import Parameter
from pneutac_sim.effects.laws import lag_weights


@kernel
def run(x, dt, theta, conditions, state):
    """State = per channel the pressure and the command before."""
    n, channels = x.shape
    p, before = state[:channels], state[channels:]
    known, keep_fill, old_fill, keep_vent, old_vent = -1.0, 0.0, 0.0, 0.0, 0.0
    for t in range(n):
        if dt[t] != known:
            known = dt[t]
            keep_fill, old_fill = lag_weights(known / theta[0])
            keep_vent, old_vent = lag_weights(known / theta[1])
        for c in range(channels):
            command = x[t, c]
            keep, old = (keep_fill, old_fill) if command > p[c] else (keep_vent, old_vent)
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
