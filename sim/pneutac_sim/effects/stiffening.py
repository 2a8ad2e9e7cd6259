"""Stiffening or softening with pressure: what bends is p (1 + a |p| + b p^2).

Positive a means that each further kPa bends more (the walls soften, or folds open); negative, less.
"""

from pneutac_sim.effects import BodyEffect, Parameter, kernel


@kernel
def run(x, dt, theta, conditions, state):
    """No state."""
    a, b = theta[0], theta[1]
    n, channels = x.shape
    for t in range(n):
        for c in range(channels):
            p = x[t, c]
            x[t, c] = p * (1.0 + a * abs(p) + b * p * p)


EFFECT = BodyEffect(
    name="stiffening",
    stage="drive",
    parameters=(
        Parameter("linear_1_per_kpa", "1/kPa", default=0.1, lower=-2.0, upper=20.0, range_power=-1),
        Parameter("quadratic_1_per_kpa2", "1/kPa^2", default=0.0, lower=-10.0, upper=20.0, range_power=-2),
    ),
    run=run,
    apart=True,
    equation=r"p \to p\,(1 + a\,|p| + b\,p^2)",
    cause="a gain that changes with pressure, {percent_per_kpa:+.2g} % per kPa",
    summary="Your {device}'s gain changes with pressure: by {percent_per_kpa:+.2g} % for each kPa at low "
    "pressure.",
    experiment="Go up in small steps to a higher pressure, wait at each, and plot bend against pressure.",
    derive=lambda v: {"percent_per_kpa": 100 * v["linear_1_per_kpa"]},
)
