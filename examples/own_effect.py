"""An effect of your own: a marker that is glued off the finger's axis swings about the tip."""

import math

import numpy as np

from pneutac_sim.effects import BodyEffect, Parameter, kernel


@kernel
def run(x, dt, theta, conditions, state):
    """Moves tip x, z (mm) as a rigid arm of theta[0] mm at the tip does when it turns by the bend angle."""
    for t in range(len(x)):
        bend = x[t, 3]
        x[t, 0] -= theta[0] * math.sin(bend)
        x[t, 2] -= theta[0] * (1.0 - math.cos(bend))


EFFECT = BodyEffect(
    name="marker_offset",
    stage="observation",
    parameters=(Parameter("offset_mm", "mm", default=1.0, lower=-50.0, upper=50.0),),
    run=run,
    summary="Your marker sits {offset_mm:.0f} mm off the axis of your {device}.",
    experiment="Glue a second marker onto the axis and record both.",
)

# Tip x, y, z in mm, bend towards +z and +y in rad, at five samples 0.1 s apart.
bend = np.linspace(0.0, 1.0, 5)
markers = np.column_stack([100 * np.cos(bend / 2), 0 * bend, 100 * np.sin(bend / 2), bend, 0 * bend])
moved = EFFECT.apply(markers, np.full(5, 0.1), {"offset_mm": 3.0})

assert np.allclose(EFFECT.apply(markers, np.full(5, 0.1), {"offset_mm": 0.0}), markers)
print(EFFECT.describe({"offset_mm": 3.0}))
print(np.round(moved - markers, 2)[:, [0, 2]])
# In a package of yours, an entry point makes every verb know it: docs/how_to/add_an_effect.md.
