"""The camera behind the gel: its frames, and contact against the gel's rest image."""

import numpy as np
from lerobot.cameras import Camera

from lerobot_robot_pneutac.cameras.live import LiveCamera
from lerobot_robot_pneutac.cameras.rest_image import capture_rest_image, compare_rest_images
from lerobot_robot_pneutac.hardware.parts import HardwareFault
from pneutac_sim.features import IMAGE_NAME, IMAGE_SHAPE
from pneutac_sim.gel.contact import ContactArea, contact_area, quieted
from pneutac_sim.gel.model import GelModel

REST_FRAMES = 15


class Tactile:
    """The camera behind the gel.

    Args:
        camera: gives RGB frames uint8 of one size.
        shape: (H, W, 3) of them.
        threshold_levels: of contact, see `pneutac_sim.gel.contact.contact_area`.
        gel: of the sensor's twin, with whose rest image the first frames are compared; None for none.

    Attributes:
        camera, threshold_levels, shape: see above.
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

        Raises:
            HardwareFault: frames have another shape, differ from each other as by a touch, or show what the
                twin's rest image does not.
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
        """Contact of an image against the rest image, the noise of single pixels apart."""
        return contact_area(quieted(image), quieted(self.rest_image), self.threshold_levels)

    def _checked(self, image: np.ndarray) -> np.ndarray:
        if image.shape != self.shape or image.dtype != np.uint8:
            raise HardwareFault(
                f"The tactile camera gives {image.dtype} frames of shape {image.shape}; the robot was told"
                f" uint8 {self.shape} by --robot.digit.height and --robot.digit.width."
            )
        return image
