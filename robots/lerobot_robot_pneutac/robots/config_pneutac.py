"""Options of the robot `pneutac`."""

from dataclasses import dataclass, field

from draccus.utils import DecodingError
from lerobot.cameras import CameraConfig
from lerobot.robots import RobotConfig

from lerobot_robot_pneutac.hardware.arms import ArmConfig
from lerobot_robot_pneutac.hardware.limits import Limits
from pneutac_sim.errors import InputError
from pneutac_sim.features import IMAGE_NAME, STATE_NAMES


@dataclass(kw_only=True)
class PressureConfig:
    """Which pressure controller.

    Attributes:
        type: `pneutac_serial`, `text_serial`, `simulated`, or another that was registered.
        port: serial port, where it has one.
        options: everything else that this type takes, by name.
    """

    type: str = ""
    port: str | None = None
    options: dict[str, float | str] = field(default_factory=dict)

    def make(self):
        """The controller, not connected; raises InputError where its type or options are unknown."""
        from lerobot_robot_pneutac.hardware.pressure import make_pressure_controller

        port = {"port": self.port} if self.port is not None else {}
        return make_pressure_controller(self.type, **port, **self.options)


@RobotConfig.register_subclass("pneutac")
@dataclass(kw_only=True)
class PneutacConfig(RobotConfig):
    """A Panda with the pneumatic finger and a DIGIT, for real.

    Attributes:
        arm: `--robot.arm.type=panda --robot.arm.ip=...`, or `simulated` for a dry run.
        pressure: `--robot.pressure.type=pneutac_serial --robot.pressure.port=/dev/ttyACM0`, for example.
        limits: kept below any policy.
        digit: the tactile camera, any camera type of LeRobot's, `--robot.digit.type=digit` for example.
        cameras: more cameras, as for every LeRobot robot; a policy trained in simulation knows none.
    """

    arm: ArmConfig | None = None
    pressure: PressureConfig = field(default_factory=PressureConfig)
    limits: Limits = field(default_factory=Limits)  # draccus cannot have a nested dataclass come last
    digit: CameraConfig | None = None
    cameras: dict[str, CameraConfig] = field(default_factory=dict)

    def __post_init__(self):
        # LeRobot's commands print a DecodingError as one line and hide any other error's text.
        super().__post_init__()
        for name, given, example in (
            ("arm", self.arm, "panda"),
            ("pressure", self.pressure.type, "pneutac_serial"),
            ("digit", self.digit, "digit"),
        ):
            if not given:
                raise DecodingError(
                    (), f"--robot.{name}.type is missing; give --robot.{name}.type={example}."
                )
        try:
            self.pressure.make()  # opens nothing
        except InputError as e:
            raise DecodingError((), f"--robot.pressure: {e}") from e
        taken = {IMAGE_NAME, *STATE_NAMES} & self.cameras.keys()
        if taken:
            raise DecodingError((), f"--robot.cameras has '{taken.pop()}', which is taken; choose another.")
