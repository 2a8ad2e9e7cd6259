"""Options of the camera `digit_generated`."""

from dataclasses import dataclass

from lerobot.cameras import CameraConfig

from lerobot_robot_pneutac.cameras.framing import SMALLEST_PX
from lerobot_robot_pneutac.options import refuse_if
from pneutac_sim.features import IMAGE_SHAPE


@CameraConfig.register_subclass("digit_generated")
@dataclass(kw_only=True)
class DigitGeneratedConfig(CameraConfig):
    """A DIGIT that is not there: pictures of the built-in gel, for dry runs without a sensor.

    Attributes:
        fps: frames per second.
        press_period_s: a ball of radius 4 mm comes and goes once in this time; 0 for no ball.
        press_depth_mm: depth to which the ball comes.
        width: columns of an image; a DIGIT's has 240, and others are scaled from it.
        height: rows of an image; a DIGIT's has 320.
    """

    fps: int = 30
    width: int = IMAGE_SHAPE[1]
    height: int = IMAGE_SHAPE[0]
    press_period_s: float = 0.0
    press_depth_mm: float = 0.8

    def __post_init__(self):
        refuse_if(
            min(self.height, self.width) < SMALLEST_PX,
            f"digit_generated is {self.width} wide and {self.height} high; it must have {SMALLEST_PX} px each"
            " way at least.",
        )
        refuse_if(
            not (self.fps > 0 and self.press_period_s >= 0 and self.press_depth_mm >= 0),
            f"digit_generated has fps {self.fps}, press_period_s {self.press_period_s} and press_depth_mm"
            f" {self.press_depth_mm}; the first must be positive and the others not negative.",
        )
