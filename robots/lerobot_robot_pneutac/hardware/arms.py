"""Options of each kind of arm; another kind is one more registered class."""

import abc
from dataclasses import dataclass

import draccus

from lerobot_robot_pneutac.hardware.parts import Arm
from lerobot_robot_pneutac.options import refuse_if


@dataclass(kw_only=True)
class ArmConfig(draccus.ChoiceRegistry, abc.ABC):
    """Which arm: `--robot.arm.type=NAME`, and its options."""

    @property
    def type(self) -> str:
        """Name that it is registered by."""
        return str(self.get_choice_name(self.__class__))

    @abc.abstractmethod
    def make(self) -> Arm:
        """The arm, not connected."""


@ArmConfig.register_subclass("panda")
@dataclass(kw_only=True)
class PandaConfig(ArmConfig):
    """A Franka Panda or FR3.

    Attributes:
        ip: address of the robot.
        dynamics: share of the robot's acceleration and jerk that is used.
        collision_n: contact force at which the robot's own reflex stops it.
        collision_nm: the same for the torque of each joint.
        realtime: whether a real-time kernel is demanded.
    """

    ip: str = ""
    dynamics: float = 0.1
    collision_n: float = 30.0
    collision_nm: float = 20.0
    realtime: bool = True

    def __post_init__(self):
        refuse_if(not self.ip, "--robot.arm.ip is missing; give the Panda's address.")
        refuse_if(
            not 0 < self.dynamics <= 1,
            f"--robot.arm.dynamics is {self.dynamics}; it must be above 0 and at most 1.",
        )
        refuse_if(
            min(self.collision_n, self.collision_nm) <= 0,
            "--robot.arm.collision_n and collision_nm must be positive.",
        )

    def make(self) -> Arm:
        """See `ArmConfig.make`."""
        from lerobot_robot_pneutac.hardware.panda import PandaArm

        return PandaArm(
            self.ip,
            self.dynamics,
            collision_n=self.collision_n,
            collision_nm=self.collision_nm,
            realtime=self.realtime,
        )


@ArmConfig.register_subclass("simulated")
@dataclass(kw_only=True)
class SimulatedArmConfig(ArmConfig):
    """An arm for dry runs."""

    def make(self) -> Arm:
        """See `ArmConfig.make`."""
        from lerobot_robot_pneutac.hardware.simulated_arm import SimulatedArm

        return SimulatedArm()
