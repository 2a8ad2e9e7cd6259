"""What the gel feels: task objects against the resting gel, as a probe grid, an image and a contact area."""

import mujoco
import numpy as np

from pneutac_sim.errors import InputError
from pneutac_sim.gel.sensor import TactileSensor
from pneutac_sim.world.scene import OBJECT_GROUP

MODES = ("image", "area", "none")


class Touch:
    """The tactile pipeline of a world: object poses -> probe grid -> image and contact area.

    Attributes:
        depth_mm: last probe grid (rows, columns), mm.
        image: last tactile image uint8 (H, W, 3), or None where the mode has none.
        pixels: last count s of pixels in contact.
        area: s / N.
    """

    def __init__(self, model: mujoco.MjModel, sensor: TactileSensor, mode: str):
        if mode not in MODES:
            raise InputError(f"There is no touch mode '{mode}'; the modes are {', '.join(MODES)}.")
        self.sensor = sensor
        self._mode = mode
        self._gel = model.site("gel").id
        self._felt = np.flatnonzero(model.geom_group == OBJECT_GROUP)
        self._kinds = model.geom_type[self._felt]
        self._sizes = model.geom_size[self._felt]

    def sense(self, data: mujoco.MjData) -> None:
        """Senses the present state; `data` must have its kinematics up to date."""
        self.image, self.pixels, self.area = None, 0, 0.0
        if self._mode == "none":
            return
        self.depth_mm = self.sensor.probe(
            self._kinds,
            self._sizes,
            data.geom_xpos[self._felt],
            data.geom_xmat[self._felt],
            data.site_xpos[self._gel],
            data.site_xmat[self._gel],
        )
        if self._mode == "image":
            self.image = self.sensor.image(self.depth_mm)
            contact = self.sensor.contact(self.image)
        else:
            contact = self.sensor.contact_from_depth(self.depth_mm)
        self.pixels, self.area = contact.pixels, contact.area
