"""Pictures that are new: a camera that is lost, hangs or repeats itself is a fault."""

import time

import numpy as np
from lerobot.cameras import Camera

from lerobot_robot_pneutac.hardware.parts import TURNS, HardwareFault

FRAME_S = 0.5  # an older picture is a lost camera
RETRY_S = 0.03  # in which the next picture comes where the computer was held up, not the camera
SAME_S = 1.0  # for so long the same picture to the last bit is a frozen camera: a live one has noise


class LiveCamera:
    """A camera of the robot's, read at once.

    Args:
        camera: connected and let go by whoever owns it.
        name: of its pictures, for the sentences.
    """

    def __init__(self, camera: Camera, name: str):
        self._camera, self._name = camera, name
        self._last: np.ndarray | None = None
        self._changed_s = 0.0

    def latest(self) -> np.ndarray:
        """The newest picture uint8 (H, W, 3).

        Raises:
            HardwareFault: it is older than `FRAME_S`, cannot be had, or has been the same for `SAME_S`.
        """
        try:
            image = self._newest()
        except Exception as e:
            raise HardwareFault(f"The camera '{self._name}' gives no picture: {str(e).rstrip('.')}.") from e
        now_s = time.monotonic()
        if self._last is None or not np.array_equal(image, self._last):
            self._last, self._changed_s = image.copy(), now_s
        elif now_s - self._changed_s > SAME_S:
            raise HardwareFault(
                f"The camera '{self._name}' has given the same picture for {now_s - self._changed_s:.1f} s;"
                " plug it in afresh, and look whether it is covered."
            )
        return image

    def _newest(self) -> np.ndarray:
        for _ in range(TURNS):
            try:
                return self._camera.read_latest(max_age_ms=round(1000 * FRAME_S))
            except TimeoutError:
                time.sleep(RETRY_S)
        return self._camera.read_latest(max_age_ms=round(1000 * FRAME_S))
