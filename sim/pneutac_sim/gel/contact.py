"""Contact area s of a tactile image: the one definition for robot, environment, augmentation and policy.

A pixel is in contact where the mean over R, G, B of |image - rest| exceeds a threshold in 8-bit levels. On
real DIGITs 99.9 % of pixels away from any contact stay below 12 (noise, JPEG, drift of light), while half of
those inside a contact exceed 24; calibration replaces the 12 by the sensor's own 99.9 % level.
"""

from typing import NamedTuple

import cv2
import numpy as np
from scipy.ndimage import label, maximum

from pneutac_sim.features import SPECKS

THRESHOLD_LEVELS = 12.0
QUIET_SHARE = 0.999  # share of pixels without contact that stay below the threshold


class ContactArea(NamedTuple):
    """Contact readout of one tactile image."""

    pixels: int  # s, number of pixels in contact
    area: float  # s / N
    log_pixels: float  # log(1 + s)

    @classmethod
    def of(cls, pixels: int, n_pixels: int) -> "ContactArea":
        """The readout of `pixels` in contact among `n_pixels`."""
        return cls(int(pixels), pixels / n_pixels, float(np.log1p(pixels)))


def contact_area(
    image: np.ndarray, rest_image: np.ndarray, threshold_levels: float = THRESHOLD_LEVELS
) -> ContactArea:
    """Thresholds the mean over R, G, B of |image - rest|, uint8 (H, W, 3) both.

    Raises ValueError where the images differ in shape or are not uint8.
    """
    if image.shape != rest_image.shape or image.dtype != np.uint8 or rest_image.dtype != np.uint8:
        raise ValueError(
            f"a contact area needs two uint8 images of one shape; "
            f"got {image.dtype} {image.shape} and {rest_image.dtype} {rest_image.shape}"
        )
    sum_limit = int(3 * threshold_levels)
    pixels = differing(image, rest_image, sum_limit)
    return ContactArea.of(pixels, image.shape[0] * image.shape[1])


def quieted(image: np.ndarray) -> np.ndarray:
    """Medians of 3 x 3 pixels of a camera's image, whose single noisy pixels are no touch."""
    return cv2.medianBlur(image, 3)


def without_specks(area: np.ndarray) -> np.ndarray:
    """Contact areas (T,) of a film as shares of the image, without those that noise alone may have made.

    A touch begins with single pixels too, but it grows: a stretch of frames stays where it reaches `SPECKS`.
    """
    stretch, count = label(np.asarray(area) > 0)
    grown = maximum(area, stretch, np.arange(count + 1)) >= SPECKS
    return np.where((stretch > 0) & grown[stretch], area, 0.0)


def differing(image: np.ndarray, rest: np.ndarray, sum_limit: int) -> int:
    """How many pixels of two images, uint8 (H, W, 3), differ by more than `sum_limit` in R + G + B."""
    differences = cv2.transform(cv2.absdiff(image, rest).astype(np.float32), np.ones((1, 3), np.float32))
    return np.count_nonzero(differences > sum_limit)


def quiet_threshold(difference: np.ndarray, quiet: np.ndarray) -> float:
    """Threshold in levels that all but 0.1 % of the pixels without contact stay below.

    Of a difference (H, W, 3) of image and rest in levels, where nothing touches: `quiet` (H, W) bool.
    """
    return float(np.quantile(np.abs(difference).mean(2)[quiet], QUIET_SHARE))
