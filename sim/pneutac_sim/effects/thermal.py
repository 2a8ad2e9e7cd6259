"""Temperature: a warm material is softer, so the same pressure or load bends it exp(c (T - T_ref)) times."""

import math

from pneutac_sim.effects.effect import Effect, Parameter, kernel


@kernel
def run(x, dt, theta, conditions, state):
    """No state; conditions = temperature_c."""
    softening, reference = theta[0], theta[1]
    n, channels = x.shape
    for t in range(n):
        factor = math.exp(softening * (conditions[t, 0] - reference))
        for c in range(channels):
            x[t, c] *= factor


EFFECT = Effect(
    name="thermal",
    stage="body",
    parameters=(
        Parameter("softening_1_per_k", "1/K", default=0.01, lower=-0.3, upper=0.3),
        Parameter("reference_temperature_c", "°C", default=23.0, lower=-20.0, upper=80.0, fixed=True),
    ),
    run=run,
    columns=("temperature_c",),
    summary="Your {device} feels the temperature: it bends {percent:+.1f} % more for each degree.",
    experiment="Repeat one program at two room temperatures, 5 degrees or more apart, and log temperature_c.",
    derive=lambda v: {"percent": 100 * math.expm1(v["softening_1_per_k"])},
)
