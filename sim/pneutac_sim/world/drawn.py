"""How a world is drawn, by its `render`."""

import mujoco

from pneutac_sim.gel.sensor import TactileSensor
from pneutac_sim.twin import Twin
from pneutac_sim.world.view import View


def drawn(render: str, model: mujoco.MjModel, twin: Twin, sensor: TactileSensor | None) -> View:
    """The view of a world, and its tactile images with it.

    Args:
        render: one of `features.RENDERS`.
        model: of the world; with `splats` the geoms of the finger's skin leave its seen groups.
        twin: of the finger.
        sensor: the gel's; None where no images are wanted.
    """
    if render == "mesh":
        return View(model)
    from pneutac_sim.splat.gel import SplatSensor  # numba takes a second to start
    from pneutac_sim.world.splats import DEVICE, SplatView

    if sensor is not None:
        sensor.draw = SplatSensor(sensor.model, device=DEVICE).image
    return SplatView(model, twin)
