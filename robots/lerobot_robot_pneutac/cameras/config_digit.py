"""Options of the camera `digit`, a DIGIT tactile sensor."""

from dataclasses import dataclass

from lerobot.cameras import CameraConfig

from lerobot_robot_pneutac.cameras.framing import framed
from lerobot_robot_pneutac.options import refuse_if

# What the sensor streams: width and height of its own, lying image in px, and frame rates in Hz.
STREAMS = {"QVGA": (320, 240, (30, 60)), "VGA": (640, 480, (15, 30))}
MAX_LED = 15


@CameraConfig.register_subclass("digit")
@dataclass(kw_only=True)
class DigitConfig(CameraConfig):
    """A DIGIT, found by its serial number.

    Attributes:
        serial: number printed on the sensor, such as `D20001`.
        resolution: `QVGA`, images of 320 rows and 240 columns as the simulated sensor's, or `VGA`, 640 x 480.
        fps: 30, or 60 (QVGA alone) or 15 (VGA alone).
        led: brightness of the red, green and blue LEDs, 0 (off) to 15.
        frozen_s: seconds without a new image after which reading says that the sensor hangs. A working one
            never sends the same image twice: the pixels are noisy.
        rotation: clockwise, 0, 90, 180 or 270 degrees, of a sensor that is mounted otherwise.
        crop: shares cut off at top, bottom, left and right of the turned image.
        mirror: whether left and right are exchanged.
        width: columns of the image, to which it is scaled; follows from the resolution where it is left out.
        height: rows of the image; likewise.
    """

    serial: str
    resolution: str = "QVGA"
    fps: int = 30
    led: tuple[int, int, int] = (MAX_LED, MAX_LED, MAX_LED)
    frozen_s: float = 0.5
    rotation: int = 0
    crop: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    mirror: bool = False

    def __post_init__(self):
        refuse_if(
            self.resolution not in STREAMS,
            f"resolution of the DIGIT is '{self.resolution}'; it must be QVGA or VGA.",
        )
        columns, rows, rates = STREAMS[self.resolution]
        refuse_if(
            self.fps not in rates,
            f"fps of the DIGIT is {self.fps}; {self.resolution} has {rates[0]} and {rates[1]}.",
        )
        refuse_if(
            len(self.led) != 3 or not all(isinstance(v, int) and 0 <= v <= MAX_LED for v in self.led),
            f"led of the DIGIT is {list(self.led)}; give three whole numbers from 0 to {MAX_LED}.",
        )
        refuse_if(
            not self.frozen_s > 2 / self.fps,
            f"frozen_s of the DIGIT is {self.frozen_s}; it must exceed two frames, {2 / self.fps:.3f} s.",
        )
        # Its lying image is handed out upright, `columns` high.
        self.framing = framed("the DIGIT", self, columns, rows)
