"""What there is to know of the finger in a world: where it is, how it is bent and pressed."""

import mujoco
import numpy as np

from pneutac_sim.finger.online import PressurePipeline
from pneutac_sim.world.pad import Pad
from pneutac_sim.world.placing import Placing
from pneutac_sim.world.spine import Spine
from pneutac_sim.world.touch import imprint_m


class Senses:
    """Poses and pressures of a world, read from MuJoCo's state."""

    model: mujoco.MjModel
    data: mujoco.MjData
    _pipeline: PressurePipeline
    _placing: Placing
    _pad: Pad
    _bends: Spine
    _read: np.ndarray
    _flange: int
    _gel: int
    _tip: int

    @property
    def pressure_kpa(self) -> float:
        """Pressure in the finger's first chamber, kPa; behind the command where the twin has a valve lag."""
        return float(self._pipeline.pressure_kpa[0])

    @property
    def pressures_kpa(self) -> np.ndarray:
        """The same of each chamber (C,)."""
        return self._pipeline.pressure_kpa.copy()

    @property
    def spine_rad(self) -> np.ndarray:
        """Spine joint angles (N,), with several chambers (N, 2) towards +z and +y, rad."""
        return self._bends.read(self.data)

    @property
    def press_mm(self) -> float:
        """How far the gel's surface is pressed in, mm."""
        return -1e3 * float(self.data.joint("pad").qpos[0])

    @property
    def press_n(self) -> float:
        """Force on the gel, N: that of its own material, see `gel.force`."""
        return self._pad.spring.force(1e-3 * self.press_mm)

    @property
    def imprint_m(self) -> np.ndarray | None:
        """Where the gel is pressed, in its frame: across and along the finger (2,), metres; None where not.

        Along is positive towards the tip. The tactile image shows the same.
        """
        return imprint_m(self.model, self.data)

    @property
    def flange_m(self) -> np.ndarray:
        """Flange position (3,), metres."""
        return self.data.site_xpos[self._flange].copy()

    @property
    def gel_m(self) -> np.ndarray:
        """Middle of the gel window on the resting surface (3,), metres."""
        return self.data.site_xpos[self._gel].copy()

    @property
    def tip(self) -> np.ndarray:
        """Where the finger's tip is (5,): x, y, z in mm, bend towards +z and towards +y in rad.

        In the frame in which the base is thought to stand, x along the straight finger.
        """
        d = self.data
        flange = d.site_xmat[self._flange].reshape(3, 3)
        at = self._placing.in_base(d.site_xpos[self._tip], d.site_xpos[self._flange], flange)
        bend = np.append(self.spine_rad.sum(0), 0.0)[:2]
        return np.append(at, self._placing.turned + bend)

    @property
    def markers(self) -> np.ndarray:
        """What a bench's camera would read of the tip (5,): `tip` through the twin's observation."""
        return self._read if self._pipeline.measures else self.tip

    def _measure(self, dt_s: float) -> None:
        """Takes the markers of this control step, where effects change what is read."""
        if self._pipeline.measures:
            self._read = self._pipeline.read(self.tip, dt_s)
