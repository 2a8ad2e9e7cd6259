"""A Franka Panda (or FR3) through the library franky: Cartesian velocities with the orientation held.

franky plans every change of velocity by Ruckig within limits of velocity, acceleration and jerk, in a
1 kHz thread of its own outside Python; the robot's internal joint impedance controller carries it out.
"""

import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from scipy.spatial.transform import Rotation

from lerobot_robot_pneutac.hardware.parts import COMMAND_S, ArmState, HardwareFault

RECOVERIES = 3  # so many reflexes within RECOVERY_S are a fault
RECOVERY_S = 60.0
HOLD_PER_S = 1.0  # rate at which a tilt of the flange dies away
MAX_TURN_RAD_S = 0.1
PREEMPTED = "preempted"  # in libfranka's message where a motion was replaced on purpose

logger = logging.getLogger(__name__)


class PandaArm:
    """The arm `panda` at an address.

    `dynamics` is the share of the robot's acceleration and jerk that is used; no motion of the flange is
    faster than `speed_m_s`; a contact force or torque of a joint above `collision_n`, `collision_nm` stops it
    by its own reflex; without a real-time kernel, which `realtime` demands, it may stop by itself.
    """

    def __init__(
        self,
        ip: str,
        dynamics: float = 0.1,
        speed_m_s: float = 0.25,
        collision_n: float = 30.0,
        collision_nm: float = 20.0,
        realtime: bool = True,
    ):
        self._ip, self._dynamics, self._speed, self._realtime = ip, dynamics, speed_m_s, realtime
        self._collision = collision_nm, collision_n
        self._robot = None

    def connect(self) -> None:
        """Connects, clears an old error, sets limits and thresholds. The present orientation is held."""
        try:
            import franky
        except ImportError as e:
            raise HardwareFault(
                "The arm 'panda' needs franky: uv pip install -e './robots[panda]' in PneuTac's folder."
            ) from e
        self._f = franky
        realtime = franky.RealtimeConfig.Enforce if self._realtime else franky.RealtimeConfig.Ignore
        with self._answering():
            robot = franky.Robot(
                self._ip,
                relative_dynamics_factor=franky.RelativeDynamicsFactor(1.0, self._dynamics, self._dynamics),
                controller_mode=franky.ControllerMode.JointImpedance,
                realtime_config=realtime,
            )
            if robot.has_errors and not robot.recover_from_errors():
                raise HardwareFault(f"The Panda at {self._ip} is in an error; {_DESK}.")
            robot.translation_velocity_limit.set(self._speed)
            robot.set_collision_behavior(*self._collision)
            self._held = Rotation.from_matrix(robot.state.O_T_EE.matrix[:3, :3])
        self._robot = robot
        self._reflexes: list[float] = []
        self._clock_s, self._ticked_s = -1.0, time.monotonic()

    def state(self) -> ArmState:
        """The newest state; a state that does not change any more is a lost connection."""
        with self._answering():
            s = self._need().state
        now, clock_s = time.monotonic(), s.time.to_sec()
        if clock_s != self._clock_s:
            self._clock_s, self._ticked_s = clock_s, now
        elif now - self._ticked_s > COMMAND_S:
            raise HardwareFault(f"The Panda at {self._ip} sends no new state; check its cable and {_DESK}.")
        return ArmState(
            joints_rad=np.array(s.q, float),
            joints_rad_s=np.array(s.dq, float),
            flange_m=np.array((s.O_T_EE * s.F_T_EE.inverse).translation, float),
            force_n=float(np.linalg.norm(s.O_F_ext_hat_K[:3])),
        )

    def move(self, velocity_m_s: np.ndarray) -> None:
        """Takes over from the motion under way; after `COMMAND_S` at speed the flange rests by itself.

        A reflex of the robot (a collision, say) is cleared and said once; this command then does nothing.
        """
        f, robot = self._f, self._need()
        with self._answering():
            state = robot.state
        tilt = self._held * Rotation.from_matrix(state.O_T_EE.matrix[:3, :3]).inv()
        turn = HOLD_PER_S * tilt.as_rotvec()
        turn *= min(1.0, MAX_TURN_RAD_S / max(np.linalg.norm(turn), 1e-9))
        go = f.CartesianVelocityWaypoint(
            f.RobotVelocity(f.Twist(np.asarray(velocity_m_s, float), turn)),
            hold_target_duration=f.Duration(round(1000 * COMMAND_S)),
        )
        rest = f.CartesianVelocityWaypoint(f.RobotVelocity(f.Twist()))
        with self._answering("took no command"):
            try:
                robot.poll_motion()
                if not robot.has_errors:
                    robot.move(f.CartesianVelocityWaypointMotion([go, rest]), asynchronous=True)
                    return
                wrong = ", ".join(active(robot.state.current_errors)) or "an unnamed error"
            except f.ControlException as e:
                wrong = "" if PREEMPTED in str(e) else str(e)
            if wrong:
                self._recover(wrong)

    def stop(self) -> None:
        """Brings the arm to rest as fast as its limits allow; returns at once."""
        if self._robot is None:
            return
        try:
            if self._robot.is_in_control:
                self._robot.move(self._f.CartesianVelocityStopMotion(), asynchronous=True)
        except Exception as e:
            logger.error("Stopping the Panda at %s failed (%s); its own brake remains.", self._ip, e)

    def disconnect(self) -> None:
        """Stops, waits until the arm rests, lets go."""
        robot, self._robot = self._robot, None
        if robot is None:
            return
        try:
            if robot.is_in_control:
                robot.move(self._f.CartesianVelocityStopMotion(), asynchronous=True)
                robot.join_motion(timeout=1.0)
        except Exception as e:
            logger.error("Letting go of the Panda at %s: %s", self._ip, e)

    def _recover(self, what: str) -> None:
        """Clears a reflex; raises HardwareFault where it cannot be cleared or comes again and again."""
        now = time.monotonic()
        self._reflexes = [t for t in self._reflexes if now - t < RECOVERY_S] + [now]
        if len(self._reflexes) > RECOVERIES:
            raise HardwareFault(
                f"The Panda at {self._ip} stopped itself {len(self._reflexes)} times within {RECOVERY_S:g} s,"
                f" now by {what}; free the arm."
            )
        if not self._robot.recover_from_errors():
            raise HardwareFault(
                f"The Panda at {self._ip} stopped itself ({what}) and stays stopped; {_DESK}."
            )
        logger.warning("The Panda stopped itself (%s); the error is cleared and it moves on.", what)

    @contextmanager
    def _answering(self, fault: str = "does not answer") -> Iterator[None]:
        try:
            yield
        except HardwareFault:
            raise
        except Exception as e:
            raise HardwareFault(f"The Panda at {self._ip} {fault} ({e}); {_DESK}.") from e

    def _need(self):
        if self._robot is None:
            raise HardwareFault(f"The Panda at {self._ip} is not connected; call connect() first.")
        return self._robot


_DESK = "open its Desk page, unlock the joints, release the emergency stop and activate FCI"


def active(errors) -> list[str]:
    """Names of the errors that are set in one of libfranka's error structures."""
    return [n for n in dir(errors) if not n.startswith("_") and getattr(errors, n) is True]
