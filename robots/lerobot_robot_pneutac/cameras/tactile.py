"""The camera behind the gel: new frames alone, the gel's rest image, and contact against it."""

import logging
import time

import numpy as np
from lerobot.cameras import Camera

from lerobot_camera_digit import HardwareFault, capture_rest_image
from lerobot_camera_digit.parts import TURNS, wait
from pneutac_sim.features import IMAGE_NAME, IMAGE_SHAPE
from pneutac_sim.gel.contact import ContactArea, contact_area, quieted
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.pair import RestDifference, cells

logger = logging.getLogger(__name__)

REST_FRAMES = 15
FRAME_S = 0.5  # an older picture is a lost camera
RETRY_S = 0.03  # in which the next picture comes where the computer was held up, not the camera
SAME_S = 1.0  # for so long the same picture to the last bit is a frozen camera: a live one has noise
OTHER_LIGHT = 0.1  # share by which a gel may be darker or brighter than in its twin without a warning
TOUCH_LEVELS = 25.0  # a difference to the twin's rest image that no imprint makes


class Tactile:
    """The camera behind the gel, which gives RGB frames uint8 of a shape.

    The first frames are compared with the rest image of the gel, of the sensor's twin, where there is one.

    Attributes:
        rest_image: mean of the first frames, once connected.
    """

    def __init__(
        self,
        camera: Camera,
        threshold_levels: float,
        shape: tuple[int, int, int] = IMAGE_SHAPE,
        gel: GelModel | None = None,
    ):
        self.gel = gel
        self.camera, self.threshold_levels, self.shape = camera, threshold_levels, shape
        self._live = LiveCamera(camera, IMAGE_NAME)

    def connect(self) -> None:
        """Connects and takes the rest image; nothing may touch the gel meanwhile.

        Raises HardwareFault: frames have another shape, differ from each other as by a touch, or show what
        the twin's rest image does not.
        """
        self.camera.connect()
        self.rest_image = self._checked(capture_rest_image(self.camera, REST_FRAMES))
        if self.gel is not None:
            compare_rest_images(self.rest_image, self.gel, str(self.camera))
        self.contact(self.rest_image)  # compiles before anything moves

    def read(self) -> np.ndarray:
        """The newest frame uint8 (H, W, 3); raises HardwareFault as `LiveCamera.latest`."""
        return self._checked(self._live.latest())

    def contact(self, image: np.ndarray) -> ContactArea:
        """Contact of an image against the rest image, isolated noise pixels left out."""
        return contact_area(quieted(image), quieted(self.rest_image), self.threshold_levels)

    def _checked(self, image: np.ndarray) -> np.ndarray:
        if image.shape != self.shape or image.dtype != np.uint8:
            raise HardwareFault(
                f"The tactile camera gives {image.dtype} frames of shape {image.shape}; the robot expects "
                f"uint8 {self.shape} by --robot.digit.height and --robot.digit.width."
            )
        return image


class LiveCamera:
    """A camera that is read at once, connected and let go by whoever owns it; `name` is for sentences."""

    def __init__(self, camera: Camera, name: str):
        self._camera, self._name = camera, name
        self._last: np.ndarray | None = None
        self._changed_s = 0.0

    def latest(self) -> np.ndarray:
        """The newest picture uint8 (H, W, 3).

        Raises HardwareFault: it is older than `FRAME_S`, cannot be had, or has been the same for `SAME_S`.
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
        image: np.ndarray | TimeoutError

        def came() -> bool:
            nonlocal image
            try:
                image = self._camera.read_latest(max_age_ms=round(1000 * FRAME_S))
            except TimeoutError as late:
                image = late
            return isinstance(image, np.ndarray)

        if not wait(came, TURNS * RETRY_S, RETRY_S):
            raise image
        return image


def compare_rest_images(rest: np.ndarray, gel: GelModel, camera: str) -> None:
    """Compares a rest image with that of the sensor's twin.

    Raises HardwareFault: something touches the gel, or has left a strong imprint.
    """
    if rest.shape != gel.rest_image.shape:
        return
    scale = gel.px_per_mm
    found = RestDifference.of(*(cells(i, scale) for i in (rest, gel.rest_image)), scale)
    if abs(found.gain - 1) > OTHER_LIGHT:
        logger.warning(
            "%s is %.0f %% %s than when its twin was calibrated; check its light, or calibrate again.",
            *(camera, 100 * abs(1 / found.gain - 1), "darker" if found.gain > 1 else "brighter"),
        )
    if not found.shows:
        return
    what = (
        f"The rest image of {camera} shows something at ({found.x_mm:.1f}, {found.y_mm:.1f}) mm that its"
        f" twin's does not, {found.levels:.0f} levels strong"
    )
    if found.levels > TOUCH_LEVELS:
        raise HardwareFault(f"{what}: let nothing touch the gel, or calibrate the twin again, and try again.")
    logger.warning("%s: an imprint that is left? Wait until it has faded, or calibrate the twin again.", what)
