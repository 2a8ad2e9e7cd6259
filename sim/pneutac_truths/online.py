"""A rod that is driven step by step: the same air, creep and hysteresis as in a recording, as state."""

import numpy as np

from pneutac_truths.effects.air import AMBIENT_KPA, _orifice
from pneutac_truths.effects.material import relay_plane
from pneutac_truths.programs import DT_S
from pneutac_truths.rod import BEND_Z, COLUMNS, SET_Z, SOFT, TIP_FORCE, Rod


class OnlineRod:
    """A rod behind an orifice whose material creeps by a power law and is hysteretic by Preisach's relays.

    `effects.air.fill_orifice`, `effects.material.creep_fractional` and `hysteresis_preisach`, whose
    parameters it takes, one after the other on the truths' fine time grid; no second physics. `air` is the
    pressure in the chamber, share of the top pressure, `drive_rad` the bend that it drives, `memory_rad` the
    one that the material remembers, with `moulded_rad`, its bend without pressure.
    """

    def __init__(
        self,
        rod: Rod,
        top_kpa: float,
        bend_rad: float,
        moulded_rad: float,
        orifice: dict[str, float],
        creep: dict[str, float],
        hysteresis: dict[str, float],
    ):
        self._rod, self._top_kpa, self._bend_rad, self._moulded = rod, top_kpa, bend_rad, moulded_rad
        self._orifice = [orifice[k] for k in ("critical", "supply", "growth", "size")]
        self._creep = creep["order"], creep["size"]
        self._size = hysteresis["size"]
        self._up, self._down, self._weight = relay_plane(hysteresis["width"])
        self.rest()

    def rest(self) -> None:
        """A rod that has long been without pressure."""
        self.air, self.drive_rad, self.memory_rad = 0.0, 0.0, self._moulded
        self._time_s, self._row = 0.0, 0
        self._relays = np.zeros(len(self._up))
        self._rows, self._steps = np.empty(0), np.empty(0)  # when the drive changed, and by how much

    @property
    def pressure_kpa(self) -> float:
        """Pressure in the chamber, kPa."""
        return self.air * self._top_kpa

    def step(self, command_kpa: float, dt_s: float) -> None:
        """Holds a command for `dt_s`, of which the rows of the fine grid that end in it are computed."""
        self._time_s += dt_s
        rows = round(self._time_s / DT_S) - self._row
        # The orifice starts settled on its first entry, so the present pressure there goes on from it.
        wanted = np.full((rows + 2, 1), command_kpa / self._top_kpa)
        wanted[0] = self.air
        air = _orifice(wanted, AMBIENT_KPA / self._top_kpa, *self._orifice)[2:, 0]
        before = np.append(self.air, air)[:-1]
        changed = np.flatnonzero(air != before)
        self._rows = np.append(self._rows, self._row + changed)
        self._steps = np.append(self._steps, self._bend_rad * (air - before)[changed])
        for x in air[changed]:
            self._relays[self._up < x] = 1.0
            self._relays[self._down > x] = 0.0
        self._row += rows
        self.air = float(air[-1]) if rows else self.air
        self.drive_rad = self._bend_rad * self.air
        order, size = self._creep
        crept = size * float(self._steps @ ((self._row - 0.5 - self._rows) * DT_S) ** order)
        relayed = self._size * self._bend_rad * (float(self._relays @ self._weight) - self.air)
        self.memory_rad = self._moulded + crept + relayed

    def bends_rad(self, parts: int) -> np.ndarray:
        """Bend (parts,) of as many equal lengths of the unloaded rod, rad; `parts` divides its elements."""
        h = self._rod.length_mm / self._rod.shapes.shape[1]
        by_air, by_memory = (x.reshape(parts, -1).sum(1) * h for x in self._rod.shapes[:2])
        return self.drive_rad * by_air + self.memory_rad * by_memory

    def tip_mm(self, force: np.ndarray | None = None) -> np.ndarray:
        """Marker (3,) in equilibrium under a force (3,) on it over bending stiffness, 1/mm^2."""
        inputs = np.zeros((1, COLUMNS))
        inputs[0, SOFT], inputs[0, BEND_Z], inputs[0, SET_Z] = 1.0, self.drive_rad, self.memory_rad
        if force is not None:
            inputs[0, TIP_FORCE] = force
        return self._rod.solve(inputs)[0][0]
