"""Registration shift: the contacts are displaced from where the recording states.

The true place is s R(turn) x + shift, with x the stated one, all from the window's centre.
"""

import math
from dataclasses import replace

from pneutac_sim.effects import Parameter, SensorEffect

STEP_MM = 0.05  # by which presses are moved to see what the images do


def moved(press, values: dict[str, float]):
    """The press, moved by the shift."""
    c, s = (values["scale"] * f(values["turn_rad"]) for f in (math.cos, math.sin))
    x = c * press.x_mm - s * press.y_mm + values["shift_x_mm"]
    y = s * press.x_mm + c * press.y_mm + values["shift_y_mm"]
    return replace(press, x_mm=x, y_mm=y, yaw_rad=press.yaw_rad + values["turn_rad"])


EFFECT = SensorEffect(
    name="registration_shift",
    stage="gel",
    parameters=(
        Parameter("shift_x_mm", "mm", 0.0, -3.0, 3.0),
        Parameter("shift_y_mm", "mm", 0.0, -3.0, 3.0),
        Parameter("turn_rad", "rad", 0.0, -0.3, 0.3),
        Parameter("scale", "", 1.0, 0.7, 1.4, 1.0),
    ),
    prior_sd=(0.5, 0.5, 0.05, 0.05),
    of_session=True,
    press=moved,
    steps=lambda reach_mm: (STEP_MM, STEP_MM, STEP_MM / reach_mm, STEP_MM / reach_mm),
    equation=r"x \to s\,R(\phi)\,x + t",
    cause="shifted contact positions",
    summary="The contacts of your {device} lie {shift_x_mm:+.2f} mm (x) and {shift_y_mm:+.2f} mm (y) from "
    "where the recording states, turned by {turn_rad:+.3f} rad and {scale:.3f} times as far from the centre.",
    experiment="Press a small ball at the four corners and in the middle, and measure where the images show "
    "it.",
)
