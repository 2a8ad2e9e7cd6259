"""Gravity: the weight of the body and of what sits at its tip turns each joint.

The direction of gravity in the base frame comes with the recording, as a unit vector. Only weight over joint
stiffness can be seen, so the masses are right as far as `joint_stiffness_nm_per_rad` is.
"""

from pneutac_sim.effects import BodyEffect, Parameter, kernel

STANDARD_GRAVITY = 9.80665


@kernel
def run(x, dt, theta, conditions, state):
    """Adds to the loads (N); conditions = gravity_x, gravity_y, gravity_z."""
    for t in range(len(x)):
        for i in range(3):
            pull = 1e-3 * STANDARD_GRAVITY * conditions[t, i]
            x[t, i] += theta[1] * pull
            x[t, 3 + i] += theta[0] * pull


EFFECT = BodyEffect(
    name="gravity",
    stage="load",
    parameters=(
        Parameter("body_mass_g", "g", default=40.0, lower=0.0, upper=3000.0),
        Parameter("tip_mass_g", "g", default=20.0, lower=0.0, upper=3000.0),
    ),
    run=run,
    columns=("gravity_x", "gravity_y", "gravity_z"),
    equation=r"K\,(q - q_{el}) = \sum_j J_j^T\,m_j\,g",
    cause="the weight of the body",
    summary="Your {device} sags under its own weight ({body_mass_g:.0f} g along it, {tip_mass_g:.0f} g at "
    "its tip).",
    experiment="Repeat one program with the base upside down, and write gravity_x, gravity_y, gravity_z.",
)
