"""Taking a tactile sensor's rest image, the picture of the gel that nothing touches."""

import logging

import cv2
import numpy as np
from lerobot.cameras import Camera

from lerobot_robot_pneutac.hardware.parts import HardwareFault
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.pair import RestDifference, cells

logger = logging.getLogger(__name__)

BLOCK_PX = 8  # blocks average the pixels' noise away: 2 levels per pixel become 1/4
BLACK_LEVEL, WHITE_LEVEL = 8, 247  # an image below or above all over shows nothing
OTHER_LIGHT = 0.1  # share by which a gel may be darker or brighter than in its twin without a warning
TOUCH_LEVELS = 25.0  # a difference to the twin's rest image that no imprint makes
MOTION_LEVELS = 2.0  # a touch moves its blocks by more than the 12 levels of `gel.contact`


def capture_rest_image(camera: Camera, frames: int = 30) -> np.ndarray:
    """Mean of the next images while nothing touches the gel.

    Args:
        camera: connected camera with images uint8 (H, W, 3).
        frames: number of images, at least 2.

    Returns:
        uint8 (H, W, 3).

    Raises:
        HardwareFault: some block of 8 x 8 pixels differed from its mean by more than 2 levels in one image:
            something moved or the light was not steady yet. Or the picture is black or white all over.
    """
    if frames < 2:
        raise ValueError(f"a rest image needs at least 2 frames; got {frames}")
    images = np.stack([camera.async_read(timeout_ms=1000) for _ in range(frames)])
    blocks = np.stack([_blocks(image) for image in images])
    motion = float(np.abs(blocks - blocks.mean(axis=0)).max())
    if motion > MOTION_LEVELS:
        raise HardwareFault(
            f"The rest image of {camera} was refused: the picture changed by {motion:.1f} of 255 levels"
            f" within {frames} frames; let nothing touch the gel and try again."
        )
    rest = images.mean(axis=0).round().astype(np.uint8)
    dark, bright = np.percentile(rest, (1, 99))
    if bright < BLACK_LEVEL or dark > WHITE_LEVEL:
        colour = "black" if bright < BLACK_LEVEL else "white"
        raise HardwareFault(
            f"The rest image of {camera} was refused: it is {colour} all over; switch the sensor's"
            " light on, or lower its brightness or the exposure."
        )
    return rest


def compare_rest_images(rest: np.ndarray, gel: GelModel, camera: str) -> None:
    """Compares a rest image with that of the sensor's twin.

    Raises:
        HardwareFault: something touches the gel, or has left a strong imprint.
    """
    if rest.shape != gel.rest_image.shape:
        return
    scale = gel.px_per_mm
    found = RestDifference.of(*(cells(i, scale) for i in (rest, gel.rest_image)), scale)
    if abs(found.gain - 1) > OTHER_LIGHT:
        logger.warning(
            "%s is %.0f %% %s than when its twin was calibrated; check its light, or calibrate anew.",
            *(camera, 100 * abs(1 / found.gain - 1), "darker" if found.gain > 1 else "brighter"),
        )
    if not found.shows:
        return
    what = (
        f"The rest image of {camera} shows something at ({found.x_mm:.1f}, {found.y_mm:.1f}) mm that its"
        f" twin's does not, {found.levels:.0f} levels strong"
    )
    if found.levels > TOUCH_LEVELS:
        raise HardwareFault(f"{what}: let nothing touch the gel, or calibrate the twin anew, and try again.")
    logger.warning("%s: an imprint that is left? Wait until it has faded, or calibrate the twin anew.", what)


def _blocks(image: np.ndarray) -> np.ndarray:
    """Means of blocks: float32 (H / 8, W / 8, 3)."""
    rows, columns = image.shape[0] // BLOCK_PX, image.shape[1] // BLOCK_PX
    return cv2.resize(image.astype(np.float32), (columns, rows), interpolation=cv2.INTER_AREA)
