"""A chamber inside the process, for dry runs without a controller."""

import math
import threading
import time
from collections.abc import Callable

from lerobot_robot_pneutac.hardware.parts import COMMAND_S, HardwareFault
from lerobot_robot_pneutac.hardware.pressure_limits import checked_kpa, positive


class SimulatedPressure:
    """A first-order chamber: the pressure approaches the target, or zero where the command is void.

    Args:
        max_kpa: the highest set-point.
        min_kpa: the lowest, 0 or, with a vacuum pump, below.
        time_constant_s: after this long 63 % of a step is done.
        clock: gives seconds.
    """

    def __init__(
        self,
        max_kpa: float = 15.0,
        time_constant_s: float = 0.1,
        clock: Callable[[], float] = time.monotonic,
        min_kpa: float = 0.0,
    ):
        self.max_kpa = positive("max_kpa", max_kpa)
        self.min_kpa = -positive("-min_kpa", -min_kpa) if min_kpa else 0.0
        self._tau_s = positive("time_constant_s", time_constant_s)
        self._clock = clock
        self._lock = threading.Lock()
        self._connected = False
        self._kpa = self._target_kpa = 0.0
        self._now_s = self._void_s = clock()

    def connect(self) -> None:
        self._connected = True
        self.vent()

    def set_pressure(self, kpa: float) -> None:
        """Sets the target; raises InputError outside `min_kpa` ... `max_kpa`."""
        target = checked_kpa(kpa, self.max_kpa, self.min_kpa)
        with self._lock:
            self._advance()
            self._target_kpa = target
            self._void_s = self._now_s + COMMAND_S

    def pressure(self) -> float:
        with self._lock:
            self._advance()
            return self._kpa

    def vent(self) -> None:
        with self._lock:
            if self._connected:
                self._advance()
            self._target_kpa = 0.0

    def disconnect(self) -> None:
        """Vents; the chamber empties unseen."""
        self.vent()
        self._connected = False

    def _advance(self) -> None:
        if not self._connected:
            raise HardwareFault("The simulated pressure controller is not connected; call connect first.")
        now = self._clock()
        void = min(max(self._void_s, self._now_s), now)
        for target, end in ((self._target_kpa, void), (0.0, now)):
            self._kpa = target + (self._kpa - target) * math.exp(-(end - self._now_s) / self._tau_s)
            self._now_s = end
        if now > self._void_s:
            self._target_kpa = 0.0
