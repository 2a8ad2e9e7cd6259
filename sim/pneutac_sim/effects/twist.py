"""Twist: unevenly wound fibres turn the body about its axis under pressure, evenly along its length.

Joint n of N bends in a frame turned by (n - 1/2) / N of the whole angle (Connolly, Walsh and Bertoldi, Soft
Robotics 2, 2015). `bending_pressure_kpa` is the pressure that reaches the body, averaged over the chambers.
"""

import math

from pneutac_sim.effects import BodyEffect, Parameter, kernel


@kernel
def run(x, dt, theta, conditions, state):
    """No state; conditions = bending_pressure_kpa; x holds bends towards +z and +y of each joint."""
    n = x.shape[1] // 2
    for t in range(len(x)):
        for i in range(n):
            angle = theta[0] * conditions[t, 0] * (i + 0.5) / n
            c, s = math.cos(angle), math.sin(angle)
            z, y = x[t, 2 * i], x[t, 2 * i + 1]
            x[t, 2 * i], x[t, 2 * i + 1] = c * z - s * y, s * z + c * y


EFFECT = BodyEffect(
    name="twist",
    stage="material",
    parameters=(Parameter("twist_rad_per_kpa", "rad/kPa", 0.05, -3.0, 3.0, neutral=0.0, range_power=-1),),
    run=run,
    columns=("bending_pressure_kpa",),
    several=True,
    equation=r"q_n \to R(k\,p\,\frac{n - 1/2}{N})\,q_n",
    cause="a twist about the axis under pressure, {degrees:+.2g} degrees per kPa",
    summary="Your {device} twists about its axis under pressure, by {degrees:+.2g} degrees for each kPa.",
    experiment="Mark a line along the straight device, pressurise all chambers alike and measure its turn.",
    derive=lambda v: {"degrees": math.degrees(v["twist_rad_per_kpa"])},
)
