"""The plugin's front door: LeRobot imports it and finds every device, environment and policy by name.

Only configurations are imported here; what they configure is imported when it is made.
"""

from lerobot_camera_digit.digit import DigitConfig
from lerobot_camera_digit.elastomer import ElastomerConfig
from lerobot_robot_pneutac.cameras.simulated import DigitGeneratedConfig, PneutacSceneConfig
from lerobot_robot_pneutac.env import PneutacEnvConfig, PneutacHubConfig, PneutacStandinConfig
from lerobot_robot_pneutac.lerobot_inside import prepare
from lerobot_robot_pneutac.policy.configuration_pneutac_bc import PneutacBCConfig
from lerobot_robot_pneutac.robots.config_pneutac import PneutacConfig
from lerobot_robot_pneutac.robots.config_pneutac_sim import PneutacSimConfig
from lerobot_robot_pneutac.teleoperators.base_teleop import (
    PneutacGamepadConfig,
    PneutacKeyboardConfig,
    PneutacScriptedConfig,
    PneutacSpacemouseConfig,
)

__all__ = [
    "DigitConfig",
    "DigitGeneratedConfig",
    "ElastomerConfig",
    "PneutacBCConfig",
    "PneutacConfig",
    "PneutacEnvConfig",
    "PneutacGamepadConfig",
    "PneutacHubConfig",
    "PneutacKeyboardConfig",
    "PneutacSceneConfig",
    "PneutacScriptedConfig",
    "PneutacSimConfig",
    "PneutacSpacemouseConfig",
    "PneutacStandinConfig",
]

prepare()
