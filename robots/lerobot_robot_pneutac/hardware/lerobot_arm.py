"""An arm through LeRobot's own Robot of it: joint positions for LeRobot, Cartesian velocities for us.

One thread owns the arm: it reads the joints, moves the target on, and sends it, 50 times a second. Such arms
feel no force; a joint that stays behind its target is taken for a collision.
"""

import threading
import time
from typing import Any

import numpy as np
from lerobot.robots import Robot

from lerobot_robot_pneutac.hardware.parts import COMMAND_S, TICK_S, TURNS, ArmState, HardwareFault, wait
from pneutac_sim.world.arms import Chain, ChainIK

BEHIND_RAD = 0.3  # by which a joint may stay behind its target
RUNAWAY_M = 0.003  # by which a target that is out of reach is missed
MOST_RAD_S = 1.5  # of a joint, also where it would have to be faster for the flange's velocity
END_S = 1.0  # how long an end waits for the thread


class LeRobotArm:
    """The arm `lerobot`: LeRobot's, not connected, with its names of the joints' positions from the base on.

    The chain is its kinematics, base at the origin; `per_rad` is what LeRobot's robot counts in one radian.
    """

    def __init__(self, robot: Robot, motors: tuple[str, ...], chain: Chain, per_rad: float):
        self._robot, self._motors, self._chain, self._per_rad = robot, motors, chain, per_rad
        self._ik: ChainIK | None = None
        self._ended = threading.Event()

    def connect(self) -> None:
        """Connects; the arm stays where it is, and that orientation of the flange is held."""
        try:
            self._robot.connect(calibrate=False)
            calibrated = self._robot.is_calibrated
        except Exception as e:  # each robot has errors of its own
            raise HardwareFault(f"{self._robot} does not answer ({e}); check its port and its power.") from e
        if not calibrated:
            self._robot.disconnect()
            raise HardwareFault(f"{self._robot} is not calibrated; run lerobot-calibrate with it once.")
        self._ik, self._seen = self._chain.solver(), self._chain.solver()  # the second for those who look
        self._joints, self._rates = self._read(), np.zeros(len(self._motors))
        self._ik.hold(self._joints)
        self._goal_m, self._sent = self._ik.pose(self._joints)[1], self._joints
        self._velocity, self._until_s = np.zeros(3), 0.0
        self._read_s, self._fault = time.monotonic(), None
        self._ended.clear()
        self._thread = threading.Thread(target=self._run, name="pneutac-arm", daemon=True)
        self._thread.start()

    def state(self) -> ArmState:
        self._need()
        if not wait(lambda: time.monotonic() - self._read_s <= COMMAND_S, TURNS * TICK_S, TICK_S):
            raise HardwareFault(f"{self._robot} sends no new state; check its cable and its power.")
        joints = self._joints
        return ArmState(joints, self._rates, self._seen.pose(joints)[1], 0.0)

    def move(self, velocity_m_s: np.ndarray) -> None:
        """Moves with this velocity (3,) from now on, for `COMMAND_S`."""
        self._need()
        self._velocity, self._until_s = np.array(velocity_m_s, float), time.monotonic() + COMMAND_S

    def stop(self) -> None:
        """Holds the present position by its motors."""
        self._until_s = 0.0

    def disconnect(self) -> None:
        """Stops and lets go; many arms fall then, as LeRobot's robot says."""
        if self._ik is None:
            return
        self.stop()
        self._ended.set()
        self._thread.join(END_S)
        self._ik = None
        self._robot.disconnect()

    def _run(self) -> None:
        before_s = time.monotonic()
        while not self._ended.wait(TICK_S):
            now_s = time.monotonic()
            try:
                self._tick(now_s, min(now_s - before_s, COMMAND_S))
            except Exception as e:  # in a thread of its own nobody else would hear of it
                text = f"{self._robot} failed ({e}); check its cable and its power."
                self._fault = e if isinstance(e, HardwareFault) else HardwareFault(text)
                return
            before_s = now_s

    def _tick(self, now_s: float, elapsed_s: float) -> None:
        joints = self._read()
        self._rates = (joints - self._joints) / max(now_s - self._read_s, 1e-3)
        self._joints, self._read_s = joints, now_s
        behind = np.abs(self._sent - joints)
        if behind.max() > BEHIND_RAD:
            raise HardwareFault(
                f"{self._robot}: '{self._motors[behind.argmax()]}' is {behind.max():.2f} rad from its target;"
                " free the arm."
            )
        if now_s > self._until_s:
            return
        goal = self._goal_m + self._velocity * elapsed_s
        reach = MOST_RAD_S * elapsed_s
        wanted = self._ik.solve(goal)
        if self._ik.missing_m > RUNAWAY_M:
            self._ik.q = self._sent
            return
        self._sent = self._sent + np.clip(wanted - self._sent, -reach, reach)
        self._goal_m, self._ik.q = goal, self._sent
        values = (self._sent * self._per_rad).tolist()
        self._robot.send_action(dict(zip(self._motors, values, strict=True)))

    def _read(self) -> np.ndarray:
        observed: dict[str, Any] = self._robot.get_observation()
        joints = np.array([observed[name] for name in self._motors], float) / self._per_rad
        if not np.isfinite(joints).all():
            raise HardwareFault(f"{self._robot} reads joints that are no numbers; check its motors.")
        return joints

    def _need(self) -> None:
        if self._ik is None:
            raise HardwareFault(f"{self._robot} is not connected; call connect() first.")
        if self._fault:
            raise self._fault
