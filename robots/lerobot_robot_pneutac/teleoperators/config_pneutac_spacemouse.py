"""Options of the teleoperator `pneutac_spacemouse`."""

from dataclasses import dataclass

from lerobot.teleoperators import TeleoperatorConfig

from lerobot_robot_pneutac.teleoperators.velocity_teleop import VelocityTeleopConfig


@TeleoperatorConfig.register_subclass("pneutac_spacemouse")
@dataclass(kw_only=True)
class PneutacSpacemouseConfig(VelocityTeleopConfig):
    """A 3Dconnexion SpaceMouse; docs/how_to/teleoperation.md has the map."""
