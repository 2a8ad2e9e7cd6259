"""What the robot `pneutac` asks of its parts, and how they say that something is wrong."""

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
