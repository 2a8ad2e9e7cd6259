"""An arm for dry runs: an arm's kinematics, moving in wall time, touching nothing."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from lerobot_robot_pneutac.hardware.parts import COMMAND_S, ArmState, HardwareFault

if TYPE_CHECKING:
    from pneutac_sim.world.arms.chain import Chain
    from pneutac_sim.world.panda import Panda


class SimulatedArm:
    """The arm `simulated`: starts at the home pose of the simulated tasks and follows velocities exactly.

    Args:
        clock: seconds, rising.
        arm: whose kinematics; default the Panda.
    """

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
