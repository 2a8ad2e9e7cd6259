"""The DIGIT as a LeRobot camera; LeRobot imports this package and finds the types `digit` and `elastomer`."""

import lerobot_camera_digit.parts  # noqa: F401  first: refuses an older LeRobot
from lerobot_camera_digit.digit import Digit, DigitConfig, DigitDevice, find_digits
from lerobot_camera_digit.elastomer import Elastomer, ElastomerConfig
from lerobot_camera_digit.parts import HardwareFault
from lerobot_camera_digit.touch import DigitTouch, DigitTouchStep, capture_rest_image, contact_share, depth_m

__all__ = [
    "Digit",
    "DigitConfig",
    "DigitDevice",
    "DigitTouch",
    "DigitTouchStep",
    "Elastomer",
    "ElastomerConfig",
    "HardwareFault",
    "capture_rest_image",
    "contact_share",
    "depth_m",
    "find_digits",
]
