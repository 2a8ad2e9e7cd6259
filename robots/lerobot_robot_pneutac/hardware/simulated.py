"""An arm and a chamber for dry runs: they move in wall time and touch nothing."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from lerobot_robot_pneutac.hardware.parts import COMMAND_S, ArmState, HardwareFault
from lerobot_robot_pneutac.hardware.pressure_limits import checked_kpa, positive

if TYPE_CHECKING:
    from pneutac_sim.world.arms import Chain
    from pneutac_sim.world.panda import Panda


class SimulatedArm:
    """The arm `simulated`: starts at the home pose of the simulated tasks and follows velocities exactly."""

    def __init__(self, clock: Callable[[], float] = time.monotonic, arm: Chain | Panda | None = None):
        self._clock, self._arm = clock, arm
        self._lock = threading.Lock()
        self._ik = None

    def connect(self) -> None:
        from pneutac_sim.world.panda import Panda

        ik = (self._arm or Panda()).solver()
        ik.solve(ik.pose(ik.q)[1])  # compiles: the first motion would keep `state` waiting for seconds
        ik.reset()
        self._ik = ik
        self._joints = self._ik.q.copy()
        self._rates = np.zeros(len(self._joints))
        self._velocity = np.zeros(3)
        self._now_s = self._until_s = self._clock()

    def state(self) -> ArmState:
        with self._lock:
            self._advance()
            flange = self._ik.pose(self._joints)[1]
            return ArmState(self._joints.copy(), self._rates.copy(), flange, 0.0)

    def move(self, velocity_m_s: np.ndarray) -> None:
        """Moves with this velocity (3,) from now on, for `COMMAND_S`."""
        with self._lock:
            self._advance()
            self._velocity = np.array(velocity_m_s, float)
            self._until_s = self._now_s + COMMAND_S

    def stop(self) -> None:
        with self._lock:
            if self._ik is not None:
                self._advance()
                self._until_s, self._velocity = self._now_s, np.zeros(3)

    def disconnect(self) -> None:
        with self._lock:
            self._ik = None

    def _advance(self) -> None:
        if self._ik is None:
            raise HardwareFault("The simulated arm is not connected; call connect() first.")
        now = self._clock()
        moved_s = min(now, self._until_s) - self._now_s
        elapsed_s = now - self._now_s
        if elapsed_s <= 0:
            return
        before = self._joints
        if moved_s > 0:
            # From where it is, not from where it was commanded to be: beyond its reach it stays behind.
            position = self._ik.pose(self._joints)[1]
            self._joints = self._ik.solve(position + self._velocity * moved_s)
        self._rates = (self._joints - before) / elapsed_s
        self._now_s = now


class SimulatedPressure:
    """A first-order chamber: the pressure approaches the target, or zero where the command is void.

    After `time_constant_s` 63 % of a step is done; with a vacuum pump `min_kpa` is below 0.
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
