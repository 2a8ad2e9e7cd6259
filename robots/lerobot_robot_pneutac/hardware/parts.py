"""What the robot `pneutac` asks of its parts, and how they say that something is wrong."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np


class HardwareFault(RuntimeError):  # noqa: N818
    """A part stopped working; the message is one sentence: which part, what happened, what to do."""


@dataclass(frozen=True)
class ArmState:
    """What an arm senses.

    Attributes:
        joints_rad: (N,), from the base on.
        joints_rad_s: (N,).
        flange_m: (3,) in the base frame.
        force_n: size of the external force at the flange.
    """

    joints_rad: np.ndarray
    joints_rad_s: np.ndarray
    flange_m: np.ndarray
    force_n: float


class Arm(Protocol):
    """An arm whose flange is moved with its orientation held. Every method raises `HardwareFault`."""

    def connect(self) -> None:
        """Gets ready to move; does not move."""

    def state(self) -> ArmState:
        """The newest state."""

    def move(self, velocity_m_s: np.ndarray) -> None:
        """Starts moving the flange with a velocity (3,) m/s in the base frame; returns at once.

        Unless called again within `parts.COMMAND_S` the arm stops by itself.
        """

    def stop(self) -> None:
        """Brings the arm to rest; never raises, also where the connection is lost."""

    def disconnect(self) -> None:
        """Stops and lets go."""


class PressureController(Protocol):
    """A valve with a pressure sensor. Every method but `vent` and `disconnect` raises `HardwareFault`.

    Attributes:
        max_kpa: the highest set-point; known once connected. One that makes vacuum also tells `min_kpa`, its
            lowest; without it that is 0.
    """

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
TURNS = 3


def soon(true: Callable[[], bool], turn_s: float) -> bool:
    """Whether it is true now or within a few turns.

    A computer that was held up finds everything too old, until the threads that listen have had their turn.

    Args:
        true: asked up to `TURNS` + 1 times.
        turn_s: what a listening thread needs to hear from a part that is alive.
    """
    for _ in range(TURNS):
        if true():
            return True
        time.sleep(turn_s)
    return true()
