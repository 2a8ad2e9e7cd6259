"""Options of the teleoperator `pneutac_gamepad`."""

from dataclasses import dataclass

from lerobot.teleoperators import TeleoperatorConfig

from lerobot_robot_pneutac.options import refuse_if
from lerobot_robot_pneutac.teleoperators.velocity_teleop import VelocityTeleopConfig


@TeleoperatorConfig.register_subclass("pneutac_gamepad")
@dataclass(kw_only=True)
class PneutacGamepadConfig(VelocityTeleopConfig):
    """Sticks move the robot, triggers the pressure; docs/how_to/teleoperation.md has the map.

    Attributes:
        dead_zone: share of a stick's or trigger's travel that counts as rest.
    """

    dead_zone: float = 0.1

    def __post_init__(self):
        super().__post_init__()
        refuse_if(
            not 0 <= self.dead_zone < 1,
            f"--teleop.dead_zone is {self.dead_zone}; it must be from 0 to below 1.",
        )
