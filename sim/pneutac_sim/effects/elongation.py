"""Elongation: pressure also changes the device's length, so the tip's distance grows by 1 + e p.

Negative where it draws in, as a muscle does, or where the marker sits on the inside of the bend.

`bending_pressure_kpa` is the pressure that reaches the body, averaged over the chambers.
"""

from pneutac_sim.effects import BodyEffect, Parameter, kernel


@kernel
def run(x, dt, theta, conditions, state):
    """No state; conditions = bending_pressure_kpa."""
    for t in range(len(x)):
        stretch = 1.0 + theta[0] * conditions[t, 0]
        for i in range(3):
            x[t, i] *= stretch


EFFECT = BodyEffect(
    name="elongation",
    stage="material",
    signal="markers",
    parameters=(Parameter("strain_1_per_kpa", "1/kPa", default=0.02, lower=-0.5, upper=1.0, range_power=-1),),
    run=run,
    columns=("bending_pressure_kpa",),
    equation=r"x \to (1 + e\,p)\,x",
    cause="change of length under pressure, {percent:+.2g} % per kPa",
    summary="Your {device} changes its length under pressure, by {percent:+.2g} % for each kPa.",
    experiment="Mark the base and the tip, pressurise in steps and measure the arc between the marks.",
    derive=lambda v: {"percent": 100 * v["strain_1_per_kpa"]},
)
