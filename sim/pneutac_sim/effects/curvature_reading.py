"""Curvature reading: curvatures read off the tip of a body that is no arc depend on how far it bends.

A chord at half the bend angle gives the curvature of an arc. A body that bends more near its base, or has a
rigid tip, is no arc, and reads more or less of its bend the further it bends; the first term that is even in
the bend is its square. Source of the reading: Webster and Jones, IJRR 29 (2010) 1661. A body that truly
stiffens as it bends looks the same; curvatures alone do not show which it is.
"""

from pneutac_sim.effects import BodyEffect, Parameter, kernel


@kernel
def run(x, dt, theta, conditions, state):
    """No state."""
    for t in range(len(x)):
        read = 1.0 + theta[0] * (x[t, 3] ** 2 + x[t, 4] ** 2)
        x[t, 3] *= read
        x[t, 4] *= read


EFFECT = BodyEffect(
    name="curvature_reading",
    stage="observation",
    parameters=(Parameter("uneven_1_per_rad2", "1/rad^2", default=0.05, lower=-0.5, upper=0.5),),
    run=run,
    equation=r"\mathrm{bend} \to (1 + u\,|\mathrm{bend}|^2)\,\mathrm{bend}",
    cause="a curvature reading that is off by {percent:+.2g} % at a bend of 1 rad",
    summary="Curvatures of your {device} read {percent:+.2g} % off at a bend of 1 rad: it is no arc, or its "
    "stiffness changes with its bend.",
    experiment="Bend it far, photograph it from the side and compare its shape with an arc.",
    derive=lambda v: {"percent": 100 * v["uneven_1_per_rad2"]},
)
