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
    """A valve with a pressure sensor. Every method but `vent` and `disconnect` raises `HardwareFault`.

    Attributes:
        max_kpa: the highest set-point; known once connected. One that makes vacuum also has `min_kpa`, its
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
TICK_S = 0.02  # between two looks at what is waited for
TURNS = 3  # of a listening thread, after which a part that is alive has been heard


class Clock:
    """The computer's clock; tests put a simulated one into `parts.clock`."""

    now = staticmethod(time.monotonic)
    sleep = staticmethod(time.sleep)


clock = Clock()


def wait(
    until: Callable[[], bool],
    limit_s: float,
    tick_s: float = TICK_S,
    pause: Callable[[float], object] | None = None,
) -> bool:
    """Waits until something is true; the one way in which hardware is waited for.

    A computer that was held up finds everything too old until the threads that listen have had their turn;
    that is no part's fault. So a pause counts twice its time at most, and there are `TURNS` pauses at least.

    Args:
        until: asked at once, and after every pause. What it raises ends the waiting.
        limit_s: pauses in sum, s; infinite where `until` itself ends the waiting.
        tick_s: a pause, s.
        pause: waits for up to so many seconds, such as a thread's `join`; by default the clock's `sleep`.

    Returns:
        whether it became true within the limit.
    """
    waited_s, pauses = 0.0, 0
    while not until():
        if pauses >= TURNS and waited_s >= limit_s - 1e-9:
            return False
        began_s = clock.now()
        (pause or clock.sleep)(tick_s)
        waited_s += min(clock.now() - began_s, 2 * tick_s)
        pauses += 1
    return True
