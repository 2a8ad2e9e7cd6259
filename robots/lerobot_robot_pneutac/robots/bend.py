"""Commands of a bend: the pressure that bends the finger so far."""

import logging
from collections.abc import Mapping

import numpy as np

from pneutac_sim.finger.control import BendController
from pneutac_sim.twin import Twin

logger = logging.getLogger(__name__)


class BendCommands:
    """Turns commanded bends into pressures by the twin, and goes along with what was sent.

    Takes the finger's calibrated twin, the conditions of its effects and the duration of a control step;
    raises InputError as `BendController`.
    """

    def __init__(self, twin: Twin, conditions: Mapping[str, float], dt_s: float):
        self._control = BendController(twin, dt_s, conditions)
        self._warned = False

    def pressure_kpa(self, bend_rad: float) -> float:
        """What to command now; NaN for a bend that is no number, which the robot refuses like every NaN.

        A bend out of the finger's reach is brought as near as it goes, with one warning.
        """
        if not np.isfinite(bend_rad):
            return float("nan")
        low, high = self._control.reach_rad
        if not low <= bend_rad <= high and not self._warned:
            self._warned = True
            logger.warning(
                "A bend of %.3g rad is out of reach, %.3g to %.3g; it goes as far as it can.",
                bend_rad,
                low,
                high,
            )
        return self._control.plan(bend_rad)

    def sent(self, pressure_kpa: float) -> None:
        """One control step has begun, with this pressure commanded."""
        self._control.follow(pressure_kpa)
