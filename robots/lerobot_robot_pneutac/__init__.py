"""The plugin's front door: LeRobot imports it and finds every device, environment and policy by name.

Only configurations are imported here; what they configure is imported when it is made.
"""

from lerobot_robot_pneutac.cameras.config_digit import DigitConfig
from lerobot_robot_pneutac.cameras.config_digit_generated import DigitGeneratedConfig
from lerobot_robot_pneutac.cameras.config_elastomer import ElastomerConfig
from lerobot_robot_pneutac.cameras.config_pneutac_scene import PneutacSceneConfig
from lerobot_robot_pneutac.env import PneutacEnvConfig, PneutacHubConfig, PneutacStandinConfig
from lerobot_robot_pneutac.policy.configuration_pneutac_bc import PneutacBCConfig
from lerobot_robot_pneutac.robots.config_pneutac import PneutacConfig
from lerobot_robot_pneutac.robots.config_pneutac_sim import PneutacSimConfig
from lerobot_robot_pneutac.teleoperators.config_pneutac_gamepad import PneutacGamepadConfig
from lerobot_robot_pneutac.teleoperators.config_pneutac_keyboard import PneutacKeyboardConfig
from lerobot_robot_pneutac.teleoperators.config_pneutac_scripted import PneutacScriptedConfig
from lerobot_robot_pneutac.teleoperators.config_pneutac_spacemouse import PneutacSpacemouseConfig

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
