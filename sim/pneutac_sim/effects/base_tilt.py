"""Base tilt: the base stands turned and shifted in its mount, and the whole device with it."""

import math

from pneutac_sim.effects import BodyEffect, Parameter, kernel


@kernel
def run(x, dt, theta, conditions, state):
    """No state. Turns x to z by pitch, x to y by yaw, y to z by roll, in this order, then shifts."""
    cp, sp = math.cos(theta[0]), math.sin(theta[0])
    cy, sy = math.cos(theta[1]), math.sin(theta[1])
    cr, sr = math.cos(theta[2]), math.sin(theta[2])
    for t in range(len(x)):
        px, py, pz = x[t, 0], x[t, 1], x[t, 2]
        px, pz = cp * px - sp * pz, sp * px + cp * pz
        px, py = cy * px - sy * py, sy * px + cy * py
        py, pz = cr * py - sr * pz, sr * py + cr * pz
        x[t, 0] = px + theta[3]
        x[t, 1] = py + theta[4]
        x[t, 2] = pz + theta[5]
        x[t, 3] += theta[0]
        x[t, 4] += theta[1]


EFFECT = BodyEffect(
    name="base_tilt",
    stage="observation",
    signal="mount",
    parameters=(
        Parameter("pitch_rad", "rad", default=0.0, lower=-0.5, upper=0.5),
        Parameter("yaw_rad", "rad", default=0.0, lower=-0.5, upper=0.5),
        Parameter("roll_rad", "rad", default=0.0, lower=-0.5, upper=0.5),
        Parameter("shift_x_mm", "mm", default=0.0, lower=-30.0, upper=30.0),
        Parameter("shift_y_mm", "mm", default=0.0, lower=-30.0, upper=30.0),
        Parameter("shift_z_mm", "mm", default=0.0, lower=-30.0, upper=30.0),
    ),
    run=run,
    equation=r"x \to R\,x + t, \quad \mathrm{bend} \to \mathrm{bend} + (\mathrm{pitch}, \mathrm{yaw})",
    cause="a tilted or shifted base",
    summary="Your {device}'s base is tilted by {degrees:.1f} degrees in the bending plane "
    "and shifted by {shift_x_mm:.1f}, {shift_z_mm:.1f} mm along x, z.",
    experiment="Mark two points on the base itself and measure them with the tip, at zero pressure.",
    derive=lambda v: {"degrees": math.degrees(v["pitch_rad"])},
)
