"""Camera misalignment: the camera that measures the markers stands a little off where it is thought to be.

The camera looks along +y at the middle of the finger from `distance_mm`. A point P in its frame is seen as if
at dR P + dt and read back at its right depth, which gives the perspective errors a base tilt does not have.
"""

import math

from pneutac_sim.effects import BodyEffect, Parameter, kernel


@kernel
def run(x, dt, theta, conditions, state):
    """No state; conditions = length_mm. Turns about the optical axis y (roll), z (pan), x (tilt)."""
    cr, sr = math.cos(theta[0]), math.sin(theta[0])
    cp, sp = math.cos(theta[1]), math.sin(theta[1])
    ct, st = math.cos(theta[2]), math.sin(theta[2])
    distance = theta[6]
    for t in range(len(x)):
        a, depth, h = x[t, 0] - 0.5 * conditions[t, 0], x[t, 1] + distance, x[t, 2]
        u, v, w = cr * a - sr * h, depth, sr * a + cr * h
        u, v = cp * u - sp * v, sp * u + cp * v
        v, w = ct * v - st * w, st * v + ct * w
        u, v, w = u + theta[3], v + theta[4], w + theta[5]
        x[t, 0] += u * (depth / v) - a
        x[t, 2] += w * (depth / v) - h
        x[t, 3] += theta[0]


EFFECT = BodyEffect(
    name="camera_misalignment",
    stage="observation",
    parameters=(
        Parameter("roll_rad", "rad", default=0.0, lower=-0.3, upper=0.3),
        Parameter("pan_rad", "rad", default=0.0, lower=-0.3, upper=0.3),
        Parameter("tilt_rad", "rad", default=0.0, lower=-0.3, upper=0.3),
        Parameter("shift_x_mm", "mm", default=0.0, lower=-100.0, upper=100.0),
        Parameter("shift_y_mm", "mm", default=0.0, lower=-100.0, upper=100.0),
        Parameter("shift_z_mm", "mm", default=0.0, lower=-100.0, upper=100.0),
        Parameter("distance_mm", "mm", default=500.0, lower=50.0, upper=5000.0, neutral=500.0, fixed=True),
    ),
    run=run,
    columns=("length_mm",),
    equation=r"P \to d\,\frac{P'}{d'}, \quad P' = \delta R\,P + \delta t, \quad "
    r"\mathrm{bend} \to \mathrm{bend} + \mathrm{roll}",
    cause="a tilted camera",
    summary="Your camera stands askew: turned by {roll:.1f}, {pan:.1f}, {tilt:.1f} degrees "
    "(roll, pan, tilt).",
    experiment="Photograph a printed ruler in the bending plane, in two directions, and compare its lengths.",
    derive=lambda v: {k: math.degrees(v[f"{k}_rad"]) for k in ("roll", "pan", "tilt")},
)
