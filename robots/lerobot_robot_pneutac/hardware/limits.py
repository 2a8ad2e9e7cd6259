"""The limits that hold below any policy, and what they make of an action; no part is touched here."""

import math
from dataclasses import dataclass, fields

import numpy as np

from lerobot_robot_pneutac.hardware.parts import COMMAND_S
from lerobot_robot_pneutac.options import refuse_if
from pneutac_sim.features import ACTION_HIGH, ACTION_LOW, ACTION_NAMES, MAX_PRESSURE_KPA, MAX_SPEED_M_S

STOPPING_S = 0.15  # to come to rest from full speed
# Beyond the range by more than this share of it, an action is a fault of its sender and not a rounding.
EXCESS = 0.2
_BEYOND = EXCESS * (ACTION_HIGH - ACTION_LOW)


@dataclass(kw_only=True)
class Limits:
    """Limits of the real robot.

    Attributes:
        speed_m_s: of the flange along each axis.
        low_m: corner (x, y, z) of the box that the flange stays in, base frame.
        high_m: the opposite corner.
        force_n: external force at the flange above which everything stops.
        pressure_kpa: highest set-point.
        pressure_rate_kpa_s: fastest change of the set-point.
        overpressure_kpa: measured pressure above which everything stops.
    """

    speed_m_s: float = MAX_SPEED_M_S
    low_m: tuple[float, float, float] = (0.25, -0.35, 0.12)
    high_m: tuple[float, float, float] = (0.65, 0.35, 0.65)
    force_n: float = 20.0
    pressure_kpa: float = MAX_PRESSURE_KPA
    pressure_rate_kpa_s: float = 100.0
    overpressure_kpa: float = 1.15 * MAX_PRESSURE_KPA

    def __post_init__(self):
        for f in fields(self):
            value = np.asarray(getattr(self, f.name), float)
            refuse_if(
                not np.isfinite(value).all() or (value.ndim == 0 and value <= 0),
                f"limits.{f.name} is {getattr(self, f.name)}; it must be a positive number.",
            )
        for name, most in (("speed_m_s", MAX_SPEED_M_S), ("pressure_kpa", MAX_PRESSURE_KPA)):
            refuse_if(
                getattr(self, name) > most,
                f"limits.{name} is {getattr(self, name)}; actions reach {most} at most.",
            )
        refuse_if(
            len(self.low_m) != 3 or len(self.high_m) != 3 or not (np.less(self.low_m, self.high_m)).all(),
            f"limits.low_m is {self.low_m} and limits.high_m {self.high_m}; give three numbers each, the"
            " first below the second.",
        )
        refuse_if(
            self.overpressure_kpa <= self.pressure_kpa,
            f"limits.overpressure_kpa is {self.overpressure_kpa}; it must be above the highest set-point,"
            f" {self.pressure_kpa}.",
        )

    def velocity(self, wanted_m_s: np.ndarray, flange_m: np.ndarray) -> np.ndarray:
        """The part of a velocity that keeps the flange in its box.

        Towards a wall the speed is at most `distance / (COMMAND_S + STOPPING_S)`: also where this is the
        last command ever sent, the arm has come to rest before the wall. Outside the box only the way back
        is open.

        Args:
            wanted_m_s: (3,).
            flange_m: present position (3,).

        Returns:
            (3,) m/s.
        """
        room_s = COMMAND_S + STOPPING_S
        up = np.clip((np.asarray(self.high_m) - flange_m) / room_s, 0.0, self.speed_m_s)
        down = np.clip((flange_m - np.asarray(self.low_m)) / room_s, 0.0, self.speed_m_s)
        return np.clip(wanted_m_s, -down, up)

    def pressure(self, wanted_kpa: float, last_kpa: float, elapsed_s: float) -> float:
        """The set-point (kPa) that follows `last_kpa` after `elapsed_s` on the way to the wanted one."""
        wanted = min(max(wanted_kpa, 0.0), self.pressure_kpa)
        step = self.pressure_rate_kpa_s * min(elapsed_s, COMMAND_S)
        return min(max(wanted, last_kpa - step), last_kpa + step)

    def broken_by(self, force_n: float, pressure_kpa: float) -> str | None:
        """What a measurement breaks, as one sentence, or None."""
        if not (math.isfinite(force_n) and math.isfinite(pressure_kpa)):
            return f"The force reads {force_n} N and the pressure {pressure_kpa} kPa; check the sensors."
        if force_n > self.force_n:
            return (
                f"The force at the flange is {force_n:.1f} N, above limits.force_n = {self.force_n:g};"
                " move the arm free by hand."
            )
        if pressure_kpa > self.overpressure_kpa:
            return (
                f"The pressure is {pressure_kpa:.1f} kPa, above limits.overpressure_kpa ="
                f" {self.overpressure_kpa:g}; check valve and sensor."
            )
        return None


def why_refused(values: np.ndarray) -> str | None:
    """Why an action (4,) is not carried out at all, or None; a small excess is clipped and not refused."""
    for name, value, low, high, beyond in zip(
        ACTION_NAMES, values, ACTION_LOW, ACTION_HIGH, _BEYOND, strict=True
    ):
        if not np.isfinite(value):
            return f"{name} is {value}"
        if not low - beyond <= value <= high + beyond:
            return f"{name} is {value:.4g}, far outside {low:g} to {high:g}"
    return None
