"""Options of the teleoperator `pneutac_keyboard`."""

from dataclasses import dataclass

from lerobot.teleoperators import TeleoperatorConfig

from lerobot_robot_pneutac.teleoperators.velocity_teleop import VelocityTeleopConfig


@TeleoperatorConfig.register_subclass("pneutac_keyboard")
@dataclass(kw_only=True)
class PneutacKeyboardConfig(VelocityTeleopConfig):
    """Held keys move the robot; docs/how_to/teleoperation.md has the key map."""
