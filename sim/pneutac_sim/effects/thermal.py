"""Temperature: a warm material is softer, so the same pressure or load bends it further.

By the factor exp(c dT + d dT^2), dT = T - T_ref. The second term is there because the slope of a printed
rubber changes within degrees: Agilus30 loses 15 % of its modulus a degree at 20-26 C, half that at 29-35.
"""

import math

from pneutac_sim.effects import BodyEffect, Parameter, kernel


@kernel
def run(x, dt, theta, conditions, state):
    """No state; conditions = temperature_c."""
    n, channels = x.shape
    for t in range(n):
        warmer = conditions[t, 0] - theta[2]
        factor = math.exp((theta[0] + theta[1] * warmer) * warmer)
        for c in range(channels):
            x[t, c] *= factor


EFFECT = BodyEffect(
    name="thermal",
    stage="material",
    parameters=(
        Parameter("softening_1_per_k", "1/K", default=0.01, lower=-0.3, upper=0.3),
        Parameter("curvature_1_per_k2", "1/K^2", default=0.0, lower=-0.01, upper=0.01),
        Parameter("reference_temperature_c", "°C", default=23.0, lower=-20.0, upper=80.0, fixed=True),
    ),
    run=run,
    columns=("temperature_c",),
    equation=r"q \to q\,e^{c\,\Delta T + d\,\Delta T^2}, \quad \Delta T = T - T_{ref}",
    cause="dependence on temperature, {percent:+.1f} % bend per degree",
    summary="Your {device} feels the temperature: it bends {percent:+.1f} % more for each degree near "
    "{reference_temperature_c:.0f} °C.",
    experiment="Repeat one program at two room temperatures, 5 degrees or more apart, and log temperature_c.",
    derive=lambda v: {"percent": 100 * math.expm1(v["softening_1_per_k"])},
)
