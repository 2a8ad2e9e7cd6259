"""A world whose finger bends sideways too."""

from typing import override

import numpy as np

from pneutac_sim.errors import InputError
from pneutac_sim.world.base import Variation
from pneutac_sim.world.scene import Finger
from pneutac_sim.world.soft_finger import mjcf
from pneutac_sim.world.world import World

__all__ = ["SidewaysWorld", "Variation", "VariedWorld"]

VariedWorld = World  # the name of a world that takes a variation, when it was another class


class SidewaysWorld(World):
    """A world of a finger of one chamber whose joints are balls, as stiff across its plane as in it.

    That stiffness is an assumption: a bench measures the bend in the plane alone. Pressure bends it in its
    plane, as ever; only a load bends it across.

    Raises:
        InputError: the twin's body has several chambers, which any world bends to both sides.
    """

    @override
    def _finger_mjcf(self) -> Finger:
        if self.chambers > 1:
            raise InputError(
                f"The twin's {self.twin.device} has {self.chambers} chambers; a finger that a load bends"
                " sideways is made of one chamber alone."
            )
        return mjcf(self.twin, self.station.mount_mm, axes=2)

    @override
    def _bend(self, q_cmd: np.ndarray) -> np.ndarray:
        in_plane = super()._bend(q_cmd)
        return np.stack([in_plane, np.zeros_like(in_plane)], axis=1)

    @override
    def _in_plane(self, q: np.ndarray) -> np.ndarray:
        return q[:, 0]
