"""Air of second order: line and chamber overshoot, p'' + 2 zeta omega p' + omega^2 (p - p_cmd) = 0.

A line's inductance and a chamber's capacity make a resonator (Blackburn, Reethof, Shearer, Fluid Power
Control, 1960, ch. 5). The command is taken as a straight line between samples.
"""

import math

import numpy as np

from pneutac_sim.effects.body_effect import BodyEffect, kernel
from pneutac_sim.effects.effect import Parameter
from pneutac_sim.effects.laws import second_order


@kernel
def run(x, dt, theta, conditions, state):
    """State, a row each: nothing, the input before, pressure and its rate."""
    n, channels = x.shape
    s, f = state.reshape(4, channels), np.empty((n + 1, channels))
    f[0], f[1:] = s[1], x
    x[:] = second_order(s, f, dt, theta[0], theta[1])
    s[1] = f[n]


EFFECT = BodyEffect(
    name="air_resonance",
    stage="pneumatics",
    parameters=(
        Parameter("frequency_rad_per_s", "rad/s", 15.0, 1.0, 90.0, neutral=math.inf, log=True),
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
