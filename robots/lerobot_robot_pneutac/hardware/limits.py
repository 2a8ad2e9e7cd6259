"""The limits that hold below any policy, and what they make of an action; no part is touched here."""

import math
from dataclasses import dataclass, fields, replace

import numpy as np

from lerobot_robot_pneutac.hardware.parts import COMMAND_S
from lerobot_robot_pneutac.options import refuse_if
from pneutac_sim.features import MAX_SPEED_M_S, PAPER_RANGE_KPA, action_limits, action_names

STOPPING_S = 0.15  # to come to rest from full speed
# Beyond the range by more than this share of it, an action is a fault of its sender and not a rounding.
EXCESS = 0.2
OVERPRESSURE = 1.15  # of the farthest set-point


@dataclass(kw_only=True)
class Limits:
    """Limits of the real robot.

    Attributes:
        action_kpa: lowest and highest pressure of an action; beyond them one is refused, within them it is
            held to the set-points above. Not an option.
    """

    speed_m_s: float = MAX_SPEED_M_S  # of the flange along each axis
    # corner (x, y, z) of the box that the flange stays in, base frame
    low_m: tuple[float, float, float] = (0.25, -0.35, 0.12)
    high_m: tuple[float, float, float] = (0.65, 0.35, 0.65)  # the opposite corner
    force_n: float = 20.0  # external force at the flange above which everything stops
    pressure_kpa: float | None = None  # highest set-point; if omitted, what the twin was measured up to
    # lowest set-point, 0 or below; if omitted, what the twin was measured down to
    vacuum_kpa: float | None = None
    pressure_rate_kpa_s: float = 100.0  # fastest change of the set-point
    # measured pressure above which everything stops, with vacuum also where it is as far below zero; if
    # omitted, 1.15 times the farthest set-point
    overpressure_kpa: float | None = None
    beyond_twin: bool = False  # whether set-points may lie beyond what the twin was measured over

    def __post_init__(self):
        self._given = self.pressure_kpa, self.vacuum_kpa, self.overpressure_kpa
        self._set_points(PAPER_RANGE_KPA)

    def _set_points(self, twin_kpa: tuple[float, float]) -> None:
        """Fills in what was left out, from the range of a twin, and checks all."""
        low, high = twin_kpa
        pressure, vacuum, over = self._given
        self.pressure_kpa = high if pressure is None else pressure
        self.vacuum_kpa = low if vacuum is None else vacuum
        farthest = max(self.pressure_kpa, -self.vacuum_kpa)
        self.overpressure_kpa = OVERPRESSURE * farthest if over is None else over
        self.action_kpa = min(low, self.vacuum_kpa), max(high, self.pressure_kpa)
        self._check()

    def of_twin(self, twin_kpa: tuple[float, float]) -> "Limits":
        """These limits for a twin that was measured over that range, kPa.

        Raises DecodingError: a given set-point lies beyond the range, and `beyond_twin` does not allow it.
        """
        low, high = twin_kpa
        pressure, vacuum, over = self._given
        beyond = (pressure is not None and pressure > high) or (vacuum is not None and vacuum < low)
        refuse_if(
            beyond and not self.beyond_twin,
            f"limits.pressure_kpa is {self.pressure_kpa:g} and limits.vacuum_kpa {self.vacuum_kpa:g}, but the"
            f" twin was measured from {low:g} to {high:g} kPa; keep to that, or give"
            " limits.beyond_twin=true.",
        )
        limits = replace(self, pressure_kpa=pressure, vacuum_kpa=vacuum, overpressure_kpa=over)
        limits._set_points(twin_kpa)
        return limits

    def _check(self) -> None:
        for f in fields(self):
            value = np.asarray(getattr(self, f.name), float)
            positive = value.ndim or value > 0 or f.name in ("vacuum_kpa", "beyond_twin")
            wrong = f"limits.{f.name} is {getattr(self, f.name)}; it must be a positive number."
            refuse_if(not (positive and np.isfinite(value).all()), wrong)
        refuse_if(
            self.speed_m_s > MAX_SPEED_M_S,
            f"limits.speed_m_s is {self.speed_m_s}; actions reach {MAX_SPEED_M_S} at most.",
        )
        refuse_if(
            self.vacuum_kpa > 0, f"limits.vacuum_kpa is {self.vacuum_kpa}; it must be 0, or below for vacuum."
        )
        refuse_if(
            len(self.low_m) != 3 or len(self.high_m) != 3 or not (np.less(self.low_m, self.high_m)).all(),
            f"limits.low_m is {self.low_m} and limits.high_m {self.high_m}; give three numbers each, the"
            " first below the second.",
        )
        refuse_if(
            self.overpressure_kpa <= max(self.pressure_kpa, -self.vacuum_kpa),
            f"limits.overpressure_kpa is {self.overpressure_kpa}; it must be above the highest set-point,"
            f" {self.pressure_kpa}, and as far from zero as the lowest, {self.vacuum_kpa}.",
        )

    def velocity(self, wanted_m_s: np.ndarray, flange_m: np.ndarray) -> np.ndarray:
        """The part of a velocity (3,) m/s that keeps the flange, now at `flange_m` (3,), in its box.

        Towards a wall the speed is at most `distance / (COMMAND_S + STOPPING_S)`: also where this is the last
        command ever sent, the arm has come to rest before the wall. Outside the box only the way back is
        open.
        """
        room_s = COMMAND_S + STOPPING_S
        up = np.clip((np.asarray(self.high_m) - flange_m) / room_s, 0.0, self.speed_m_s)
        down = np.clip((flange_m - np.asarray(self.low_m)) / room_s, 0.0, self.speed_m_s)
        return np.clip(wanted_m_s, -down, up)

    def pressure(self, wanted_kpa: np.ndarray, last_kpa: np.ndarray, elapsed_s: float) -> np.ndarray:
        """The set-points (kPa) that follow `last_kpa` after `elapsed_s` on the way to the wanted ones."""
        wanted = np.clip(wanted_kpa, self.vacuum_kpa, self.pressure_kpa)
        step = self.pressure_rate_kpa_s * min(elapsed_s, COMMAND_S)
        return np.clip(wanted, last_kpa - step, last_kpa + step)

    def broken_by(self, force_n: float, pressure_kpa: float | np.ndarray) -> str | None:
        """What a measurement, of the pressure one a chamber, breaks, as one sentence, or None."""
        chambers = np.atleast_1d(pressure_kpa).tolist()
        if not (math.isfinite(force_n) and np.isfinite(chambers).all()):
            read = ", ".join(map(str, chambers))
            return f"The force reads {force_n} N and the pressure {read} kPa; check the sensors."
        if force_n > self.force_n:
            return (
                f"The force at the flange is {force_n:.1f} N, above limits.force_n = {self.force_n:g};"
                " move the arm free by hand."
            )
        for number, kpa in enumerate(chambers, 1):
            where = f" in chamber {number}" if len(chambers) > 1 else ""
            if kpa > self.overpressure_kpa or (self.vacuum_kpa < 0 and kpa < -self.overpressure_kpa):
                side = "above" if kpa > 0 else "farther below zero than"
                return (
                    f"The pressure{where} is {kpa:.1f} kPa, {side} limits.overpressure_kpa ="
                    f" {self.overpressure_kpa:g}; check valve and sensor."
                )
        return None


def why_refused(
    values: np.ndarray, action_kpa: tuple[float, float] = PAPER_RANGE_KPA, chambers: int = 1
) -> str | None:
    """Why an action (3 + C,) is not carried out at all, or None; a small excess is clipped, not refused."""
    names, (lowest, highest) = action_names(chambers), action_limits(action_kpa, chambers)
    excess = EXCESS * (highest - lowest)
    for name, value, low, high, beyond in zip(names, values, lowest, highest, excess, strict=True):
        if not np.isfinite(value):
            return f"{name} is {value}"
        if not low - beyond <= value <= high + beyond:
            return f"{name} is {value:.4g}, far outside {low:g} to {high:g}"
    return None
