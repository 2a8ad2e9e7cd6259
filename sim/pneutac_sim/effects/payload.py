"""Payload: a known mass hung at the tip, as far as it acts there."""

from pneutac_sim.effects import BodyEffect, Parameter, kernel
from pneutac_sim.effects.gravity import STANDARD_GRAVITY


@kernel
def run(x, dt, theta, conditions, state):
    """Adds to the loads (N); conditions = payload_g, gravity_x, gravity_y, gravity_z."""
    for t in range(len(x)):
        for i in range(3):
            x[t, i] += theta[0] * 1e-3 * STANDARD_GRAVITY * conditions[t, 0] * conditions[t, 1 + i]


EFFECT = BodyEffect(
    name="payload",
    stage="load",
    parameters=(Parameter("share", "", default=1.0, lower=0.0, upper=20.0),),
    run=run,
    columns=("payload_g", "gravity_x", "gravity_y", "gravity_z"),
    equation=r"K\,(q - q_{el}) = s\,J_{tip}^T\,m\,g",
    cause="the weight at the tip",
    summary="The weight at the tip bends your {device} {share:.2g} times as far as the fitted stiffness "
    "predicts.",
    experiment="Hang two known masses at the tip, repeat one program with each, and write payload_g.",
)
