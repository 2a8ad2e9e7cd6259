"""What the robot `pneutac` asks of its parts, and how they say that something is wrong."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from lerobot_camera_digit.parts import TICK_S, TURNS, HardwareFault, wait

__all__ = ["COMMAND_S", "TICK_S", "TURNS", "Arm", "ArmState", "HardwareFault", "PressureController", "wait"]


@dataclass(frozen=True)
class ArmState:
    """What an arm senses."""

    joints_rad: np.ndarray  # (N,), from the base on
    joints_rad_s: np.ndarray  # (N,)
    flange_m: np.ndarray  # (3,) in the base frame
    force_n: float  # size of the external force at the flange


class Arm(Protocol):
    """An arm whose flange is moved with its orientation held. Every method raises `HardwareFault`."""

    def connect(self) -> None:
        """Connects without moving."""

    def state(self) -> ArmState:
        pass

    def move(self, velocity_m_s: np.ndarray) -> None:
        """Starts moving the flange with a velocity (3,) m/s in the base frame; returns at once.

        Unless called again within `parts.COMMAND_S` the arm stops by itself.
        """

    def stop(self) -> None:
        """Brings the arm to rest; never raises, also where the connection is lost."""

    def disconnect(self) -> None:
        """Stops and lets go."""


class PressureController(Protocol):
    """A valve with a pressure sensor. Every method but `vent` and `disconnect` raises `HardwareFault`."""

    # the highest set-point; known once connected. One that makes vacuum also has `min_kpa`, its lowest;
    # without it that is 0.
    max_kpa: float

    def connect(self) -> None:
        """Opens the connection, reads limits, starts the heartbeat; the chamber stays vented."""

    def set_pressure(self, kpa: float) -> None:
        """Sets the target in kPa (gauge); returns at once.

        Unless called again within `parts.COMMAND_S` the chamber is vented. Raises InputError where the target
        is not finite or outside the controller's limits.
        """

    def pressure(self) -> float:
        """The newest measured pressure in kPa."""

    def vent(self) -> None:
        """Opens the chamber to the room; never raises."""

    def disconnect(self) -> None:
        """Vents and lets go."""


COMMAND_S = 0.25  # a command older than this is void: the arm stops, the chamber is vented


class Chambers:
    """One controller a chamber; whatever goes wrong with one vents all.

    A command of each is void after `parts.COMMAND_S`, so all are vented also where the caller stops.

    Args:
        controllers: of the chambers, in their order.
        same_limit: whether another highest set-point than the first one's is a fault.
    """

    def __init__(self, controllers: Sequence[PressureController], same_limit: bool = True):
        self.controllers = tuple(controllers)
        self._same_limit = same_limit

    @classmethod
    def of(cls, pressure: "PressureController | Chambers") -> "Chambers":
        """One controller as that of one chamber; several as they are."""
        return pressure if isinstance(pressure, cls) else cls([pressure])

    def __len__(self) -> int:
        return len(self.controllers)

    @property
    def max_kpa(self) -> np.ndarray:
        """(chambers,) highest set-points; raises HardwareFault before `connect`."""
        return np.array([c.max_kpa for c in self.controllers], float)

    @property
    def min_kpa(self) -> np.ndarray:
        """(chambers,) lowest set-points."""
        return np.array([getattr(c, "min_kpa", 0.0) for c in self.controllers], float)

    def connect(self) -> None:
        """Connects all; the chambers stay vented.

        Raises HardwareFault: one cannot be used, or its limit is not that of the others; all are let go
        again.
        """
        try:
            for c in self.controllers:
                c.connect()
            if self._same_limit and len(self) > 1 and len(set(self.max_kpa)) > 1:
                limits = ", ".join(f"{x:g}" for x in self.max_kpa)
                raise HardwareFault(
                    f"The chambers' pressure controllers have different limits, {limits} kPa; give one for"
                    " all in the options, such as {max_kpa: 15}, or each its own, such as"
                    " {max_kpa: [15, 20, 15]}."
                )
        except BaseException:
            with suppress(Exception):
                self.disconnect()
            raise

    def set_pressure(self, kpa: np.ndarray) -> None:
        """Sets the targets (chambers,) in kPa; returns at once.

        Raises:
            InputError: as a controller's own; all are vented.
            HardwareFault: likewise.
        """
        with self._vented_after():
            for c, target in zip(self.controllers, kpa, strict=True):
                c.set_pressure(float(target))

    def pressure(self) -> np.ndarray:
        """The newest measured pressures (chambers,), kPa; raises as `set_pressure`."""
        with self._vented_after():
            return np.array([c.pressure() for c in self.controllers], float)

    def vent(self) -> None:
        """Opens all chambers to the room; what a controller raises, which none should, comes after all."""
        self._each("vent")

    def disconnect(self) -> None:
        """Vents all, and only then lets go of one after the other; raises as `vent`."""
        try:
            if len(self) > 1:
                self.vent()
        finally:
            self._each("disconnect")

    def _each(self, method: str) -> None:
        faults = []
        for c in self.controllers:
            try:
                getattr(c, method)()
            except Exception as e:
                faults.append(e)
        if faults:
            raise faults[0]

    @contextmanager
    def _vented_after(self) -> Iterator[None]:
        """Vents all chambers before an exception goes on."""
        try:
            yield
        except BaseException:
            if len(self) > 1:  # one controller alone does as its maker thinks right
                with suppress(Exception):
                    self.vent()
            raise
