"""How a sensor's picture becomes the tactile image: turned, cut, mirrored and scaled, in this order."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from lerobot_robot_pneutac.options import refuse_if

_TURNS = {0: 0, 90: -1, 180: 2, 270: 1, -90: 1}  # clockwise degrees to quarter turns of np.rot90
SMALLEST_PX = 32


@dataclass(frozen=True)
class Framing:
    """Turns, cuts, mirrors and scales pictures; by itself it changes nothing.

    Attributes:
        rotation: clockwise, 0, 90, 180 or 270 (or -90, as LeRobot writes it) degrees.
        crop: shares of the turned picture that are cut off at top, bottom, left and right.
        mirror: whether left and right are exchanged.
        size: height and width of the image; None as it comes.
    """

    rotation: int = 0
    crop: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    mirror: bool = False
    size: tuple[int, int] | None = None

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

    Args:
        name: of the camera, for the sentences.
        config: options with `rotation`, `crop`, `mirror`, `width` and `height`.
        height: rows of the picture before it is turned, px.
        width: its columns.

    Raises:
        DecodingError: one sentence where they make no image.
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
