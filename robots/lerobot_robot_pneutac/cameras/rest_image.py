"""Taking a tactile sensor's rest image, the picture of the gel that nothing touches."""

import cv2
import numpy as np
from lerobot.cameras import Camera

from lerobot_robot_pneutac.hardware.parts import HardwareFault

BLOCK_PX = 8  # blocks average the pixels' noise away: 2 levels per pixel become 1/4
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
            something moved or the light was not steady yet.
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
    return images.mean(axis=0).round().astype(np.uint8)


def _blocks(image: np.ndarray) -> np.ndarray:
    """Means of blocks: float32 (H / 8, W / 8, 3)."""
    rows, columns = image.shape[0] // BLOCK_PX, image.shape[1] // BLOCK_PX
    return cv2.resize(image.astype(np.float32), (columns, rows), interpolation=cv2.INTER_AREA)
