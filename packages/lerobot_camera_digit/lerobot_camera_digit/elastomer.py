"""The camera `elastomer`: any camera under a gel, whose picture is turned, cut, mirrored and scaled."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from lerobot.cameras import CameraConfig
from lerobot.cameras.opencv import OpenCVCamera, OpenCVCameraConfig

from lerobot_camera_digit.parts import refuse_if

_TURNS = {0: 0, 90: -1, 180: 2, 270: 1, -90: 1}  # clockwise degrees to quarter turns of np.rot90
SMALLEST_PX = 32
PLAIN = {"rotation": 0, "crop": (0.0, 0.0, 0.0, 0.0), "mirror": False, "fourcc": None, "fps": 30}
# What is known of each make; an option that is given goes before it.
SENSORS: dict[str, dict[str, Any]] = {
    # Border and size as in the maker's own gsrobotics; stream, rate and format are not checked on a sensor.
    "gelsight_mini": {
        "stream": (3280, 2464),
        "fps": 25,
        "fourcc": "MJPG",
        "crop": (0.15, 0.15, 0.15, 0.15),
        "width": 320,
        "height": 240,
    },
    # As the camera `digit` hands it out, which is for Linux and also sets the LEDs.
    "digit": {"stream": (320, 240), "fps": 30, "rotation": 270},
}


@dataclass(frozen=True)
class Framing:
    """Turns, cuts, mirrors and scales pictures; by itself it changes nothing."""

    rotation: int = 0  # clockwise, 0, 90, 180 or 270 (or -90, as LeRobot writes it) degrees
    # shares of the turned picture that are cut off at top, bottom, left and right
    crop: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    mirror: bool = False  # whether left and right are exchanged
    size: tuple[int, int] | None = None  # height and width of the image; None as it comes

    def apply(self, image: np.ndarray) -> np.ndarray:
        """The image uint8 (height, width, 3) of a picture uint8 (H, W, 3)."""
        if self == Framing():
            return image
        image = np.rot90(image, _TURNS[self.rotation])
        rows, columns = (slice(*ends) for ends in self._ends(*image.shape[:2]))
        image = image[rows, columns]
        image = np.ascontiguousarray(image[:, ::-1] if self.mirror else image)
        if self.size is None or self.size == image.shape[:2]:
            return image
        return cv2.resize(image, self.size[::-1], interpolation=cv2.INTER_AREA)

    def shape(self, height: int, width: int) -> tuple[int, int]:
        """Height and width of what comes of a picture of that size, before it is scaled."""
        if _TURNS[self.rotation] % 2:
            height, width = width, height
        (top, bottom), (left, right) = self._ends(height, width)
        return bottom - top, right - left

    def _ends(self, height: int, width: int) -> tuple[tuple[int, int], tuple[int, int]]:
        top, bottom, left, right = self.crop
        rows = round(top * height), height - round(bottom * height)
        return rows, (round(left * width), width - round(right * width))


def framed(name: str, config: Any, height: int, width: int) -> Framing:
    """The framing that a camera's options ask for, whose `width` and `height` become those of its image.

    `name` is for sentences, `height` and `width` are those of the picture before it is turned, px. Raises
    DecodingError where the options make no image.
    """
    refuse_if(
        config.rotation not in _TURNS,
        f"rotation of {name} is {config.rotation}; it must be 0, 90, 180 or 270 degrees.",
    )
    crop = tuple(config.crop)
    cut = len(crop) == 4 and all(0 <= share < 1 for share in crop)
    refuse_if(
        not (cut and crop[0] + crop[1] < 1 and crop[2] + crop[3] < 1),
        f"crop of {name} is {list(crop)}; give the shares, from 0 to below 1, that are cut off at top,"
        " bottom, left and right, and leave some of the picture.",
    )
    own = Framing(config.rotation, crop).shape(height, width)
    refuse_if(
        (config.width is None) != (config.height is None),
        f"{name} has width {config.width} and height {config.height}; give both, or neither for"
        f" {own[1]} x {own[0]} px.",
    )
    size = own if config.height is None else (config.height, config.width)
    refuse_if(
        min(size) < SMALLEST_PX,
        f"The image of {name} is {size[1]} px wide and {size[0]} px high; it must have"
        f" {SMALLEST_PX} px each way at least.",
    )
    config.height, config.width = size
    return Framing(config.rotation, crop, config.mirror, None if size == own else size)


@CameraConfig.register_subclass("elastomer")
@dataclass(kw_only=True)
class ElastomerConfig(CameraConfig):
    """A camera under a gel, read by OpenCV.

    Attributes:
        fps: frames per second.
        width: columns of the image; if omitted, as it comes.
        height: rows of the image.
    """

    index_or_path: int | Path  # which camera, as for LeRobot's `opencv`
    # `gelsight_mini` or `digit`, for what is known of it; without it every option is yours
    sensor: str | None = None
    stream: tuple[int, int] | None = None  # width and height in which the camera sends, px
    fourcc: str | None = None  # format in which the camera sends, such as MJPG
    rotation: int | None = None  # clockwise, 0, 90, 180 or 270 degrees
    # shares cut off at top, bottom, left and right of the turned picture, such as [0, 0, 0.1, 0.1]
    crop: tuple[float, float, float, float] | None = None
    mirror: bool | None = None  # whether left and right are exchanged

    def __post_init__(self):
        known = ", ".join(SENSORS)
        refuse_if(
            self.sensor is not None and self.sensor not in SENSORS,
            f"sensor is '{self.sensor}'; it must be one of {known}, or left out.",
        )
        preset = SENSORS[self.sensor] if self.sensor else {}
        if self.width is not None or self.height is not None:
            preset = {k: v for k, v in preset.items() if k not in ("width", "height")}
        for name, value in (PLAIN | preset).items():
            if getattr(self, name) is None:
                setattr(self, name, value)
        refuse_if(
            self.stream is None,
            f"stream of the elastomer's camera is missing; give its width and height such as [640, 480], or a"
            f" sensor of {known}.",
        )
        self.framing = framed("the elastomer's camera", self, self.stream[1], self.stream[0])


class Elastomer(OpenCVCamera):
    """Images are RGB uint8 of the options' `height` and `width`."""

    def __init__(self, config: ElastomerConfig):
        width, height = config.stream
        super().__init__(
            OpenCVCameraConfig(
                index_or_path=config.index_or_path,
                fps=config.fps,
                width=width,
                height=height,
                fourcc=config.fourcc,
            )
        )
        self._framing = config.framing

    def _postprocess_image(self, image: np.ndarray) -> np.ndarray:
        return self._framing.apply(super()._postprocess_image(image))
