"""Old place of these options, for one more version."""

from lerobot_robot_pneutac.teleoperators.base_teleop import PneutacScriptedConfig

__all__ = ["PneutacScriptedConfig"]
