"""Valve lag: first-order filling and venting, tau p' = p_cmd - p, each with its own time constant.

The command is taken as a straight line between samples, for which the step is exact.
"""

from pneutac_sim.effects import BodyEffect, Parameter, kernel
from pneutac_sim.effects.body_effect import in_lines, replace_by
from pneutac_sim.effects.laws import fill_vent_lag


@kernel
def run(x, dt, theta, conditions, state):
    """State, a row each: nothing, the command before, the pressure."""
    s, f = in_lines(x, state, 3)
    replace_by(x, fill_vent_lag(s, f, dt, theta), s, f)


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
