"""Cameras; LeRobot looks here for the class that a camera's options name."""

from lerobot_camera_digit.digit import Digit
from lerobot_camera_digit.elastomer import Elastomer
from lerobot_robot_pneutac.cameras.simulated import DigitGenerated

__all__ = ["Digit", "DigitGenerated", "Elastomer"]
