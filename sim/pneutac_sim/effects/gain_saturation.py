"""Gain saturation: more pressure bends less and less, p_s tanh(p / p_s)."""

import math

from pneutac_sim.effects import BodyEffect, Parameter, kernel


@kernel
def run(x, dt, theta, conditions, state):
    """No state."""
    limit = theta[0]
    if math.isinf(limit):
        return
    n, channels = x.shape
    for t in range(n):
        for c in range(channels):
            x[t, c] = limit * math.tanh(x[t, c] / limit)


EFFECT = BodyEffect(
    name="gain_saturation",
    stage="drive",
    parameters=(
        Parameter(
            "saturation_pressure_kpa", "kPa", 1.2, 0.2, 10.0, neutral=math.inf, log=True, range_power=1
        ),
    ),
    run=run,
    apart=True,
    equation=r"p \to p_s \tanh(p / p_s)",
    cause="saturation, above {saturation_pressure_kpa:.3g} kPa",
    summary="Your {device} saturates: far above {saturation_pressure_kpa:.3g} kPa more pressure bends it "
    "little.",
    experiment="Go up in small steps to the highest safe pressure and wait at each: the curve flattens.",
)
