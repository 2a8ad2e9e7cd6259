"""Options of each kind of arm; another kind is one more registered class."""

import abc
import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import draccus
from draccus.utils import DecodingError

from lerobot_robot_pneutac.hardware.parts import Arm
from lerobot_robot_pneutac.options import check_range, check_station, refuse_if
from pneutac_sim.errors import InputError
from pneutac_sim.features import PANDA_JOINTS

if TYPE_CHECKING:
    from pneutac_sim.world.station import Station


@dataclass(kw_only=True)
class ArmConfig(draccus.ChoiceRegistry, abc.ABC):
    """Which arm: `--robot.arm.type=NAME`, and its options."""

    _station = None  # of an arm that has a model; with an annotation it would be an option

    @property
    def type(self) -> str:
        return str(self.get_choice_name(self.__class__))

    @property
    def joints(self) -> int:
        return self._station.joints if self._station else PANDA_JOINTS

    @abc.abstractmethod
    def make(self) -> Arm:
        """Makes the arm; it is not connected."""


@ArmConfig.register_subclass("panda")
@dataclass(kw_only=True)
class PandaConfig(ArmConfig):
    """A Franka Panda or FR3."""

    ip: str = ""  # address of the robot
    dynamics: float = 0.1  # share of the robot's acceleration and jerk that is used
    collision_n: float = 30.0  # contact force at which the robot's own reflex stops it
    collision_nm: float = 20.0  # the same for the torque of each joint
    realtime: bool = True  # whether a real-time kernel is demanded

    def __post_init__(self):
        refuse_if(not self.ip, "--robot.arm.ip is missing; give the Panda's address.")
        check_range("--robot.arm.dynamics", self.dynamics, 0, 1, "(]")
        check_range("--robot.arm.collision_n", self.collision_n, 0, ends="()")
        check_range("--robot.arm.collision_nm", self.collision_nm, 0, ends="()")

    def make(self) -> Arm:
        from lerobot_robot_pneutac.hardware.panda import PandaArm

        limits = {"collision_n": self.collision_n, "collision_nm": self.collision_nm}
        return PandaArm(self.ip, self.dynamics, **limits, realtime=self.realtime)


@ArmConfig.register_subclass("simulated")
@dataclass(kw_only=True)
class SimulatedArmConfig(ArmConfig):
    """An arm for dry runs."""

    model: str = "panda"  # `panda`, `ur5`, `so101`, or the file `station.yaml` that describes it

    def __post_init__(self):
        self._station = _station(self.model)

    def make(self) -> Arm:
        from lerobot_robot_pneutac.hardware.simulated import SimulatedArm

        return SimulatedArm(arm=_of_base(self._station))


@ArmConfig.register_subclass("lerobot")
@dataclass(kw_only=True)
class LeRobotArmConfig(ArmConfig):
    """An arm that LeRobot has a Robot of, commanded by joint positions."""

    # its options, such as {type: so101_follower, port: /dev/ttyACM1, id: mine}
    robot: dict[str, Any] = field(default_factory=dict)
    model: str = "so101"  # its kinematics: `so101`, or the file `station.yaml` that describes it
    # its names of the joints' positions from the base on; left out, all that end in `.pos` but the gripper's
    motors: list[str] = field(default_factory=list)
    degrees: bool = True  # whether it counts in degrees and not in radians

    def __post_init__(self):
        self._station = _station(self.model)
        refuse_if(self._station.arm == "panda", "--robot.arm.model is 'panda'; give --robot.arm.type=panda.")
        refuse_if(
            not self.robot.get("type"),
            "--robot.arm.robot is missing; give LeRobot's, such as '{type: so101_follower, port: ...}'.",
        )
        refuse_if(
            self.degrees and not self.robot.get("use_degrees", True),
            "--robot.arm.robot has use_degrees=false, whose numbers are no angles; leave it out.",
        )

    def make(self) -> Arm:
        """See `ArmConfig.make`; raises InputError where LeRobot's robot has other joints."""
        import lerobot.robots.so_follower  # noqa: F401  registers; LeRobot's commands import all of its robots
        from lerobot.robots import RobotConfig, make_robot_from_config

        from lerobot_robot_pneutac.hardware.lerobot_arm import LeRobotArm

        try:
            robot = make_robot_from_config(draccus.decode(RobotConfig, self.robot))
        except (ImportError, ValueError, DecodingError) as e:  # its package's name, or its options
            raise InputError(f"--robot.arm.robot: {e}") from e
        found = [n for n in robot.action_features if n.endswith(".pos")]
        motors = self.motors or [n for n in found if not n.startswith("gripper")]
        if len(motors) != self.joints or not set(motors) <= set(found):
            raise InputError(
                f"--robot.arm.motors is {motors}, of LeRobot's {', '.join(found)}; give one of these for each"
                f" of the {self.joints} joints of '{self.model}', from the base on."
            )
        per_rad = math.degrees(1) if self.degrees else 1.0
        return LeRobotArm(robot, tuple(motors), _of_base(self._station), per_rad)


def _station(model: str) -> "Station":
    """The station that has an arm: of the library's, or of a file."""
    from pneutac_sim.world.arms import ARMS
    from pneutac_sim.world.station import Station

    if model in ARMS:
        return Station(arm=model)
    check_station("robot.arm.model", Path(model))
    return Station.load(model)


def _of_base(station: "Station"):
    """A station's arm in its own frame: on hardware every place is given in it."""
    return replace(station, base_m=(0.0, 0.0, 0.0)).make_arm()
