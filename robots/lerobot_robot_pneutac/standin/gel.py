"""What the stand-in's gel delivers: contact by theory, light by rays, seen late by a noisy camera."""

from collections import deque
from dataclasses import replace

import cv2
import mujoco
import numpy as np

from lerobot_robot_pneutac.standin.finger import DOME_MM, GEL_KPA
from pneutac_sim.errors import InputError, check_choice
from pneutac_sim.features import CONTROL_HZ, IMAGE_SHAPE
from pneutac_sim.world.scene import OBJECT_GROUP
from pneutac_truths.light import Gel, Lamps

MODES = ("image", "area", "none")
LATE_IMAGES = 1  # control steps
NOISE_LEVELS = 1.5  # standard deviation of a pixel's channel
DRIFT_SHARE, DRIFT_S = 0.012, 20.0  # of the brightness of a channel, and over how long it wanders
WINDOW_MM = (12.0, 16.0)  # of a DIGIT
# LEDs such that the rest image is like photographs of two DIGITs (correlation 0.8).
LAMPS = Lamps(
    places=np.array([[-7.0, -1.7, -6.0], [10.0, -4.9, -6.0], [0.2, 13.0, -3.5]]),
    colours=np.array([[100.0, 11.0, 11.0], [8.0, 77.0, 12.0], [4.5, 14.0, 83.0]]),
    scattered=np.array([0.05, 0.12, 0.2]),
    camera_mm=14.0,
)


def new_gel(
    image_shape: tuple[int, int, int] = IMAGE_SHAPE, window_mm: tuple[float, float] = WINDOW_MM
) -> Gel:
    """The gel under its light, for images of a shape (H, W, 3).

    Lights stand as far apart as the window of the camera is wide and high, mm.
    """
    scale = np.append(np.divide(window_mm, WINDOW_MM), 1.0)
    lamps = replace(LAMPS, places=LAMPS.places * scale)
    return Gel(image_shape, window_mm, GEL_KPA, DOME_MM, lamps)


class GelTouch:
    """The stand-in's touch: `image`, `pixels`, `area` are late and noisy.

    Attributes:
        displacement_mm: (rows, columns) of the gel's face now.
        image: last tactile image uint8 (H, W, 3), or None where the mode has none.
        pixels: last count s of pixels in contact.
        area: s / N.
        rest_image: without contact, noise and drift.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        mode: str,
        threshold_levels: float,
        brightness: tuple[float, float, float] = (1.0, 1.0, 1.0),
        image_shape: tuple[int, int, int] = IMAGE_SHAPE,
        window_mm: tuple[float, float] = WINDOW_MM,
        dt_s: float = 1 / CONTROL_HZ,
    ):
        """The touch of a world; see `StandinWorld`."""
        check_choice("touch", mode, MODES)
        self.gel, self._mode, self._threshold = new_gel(image_shape, window_mm), mode, threshold_levels
        self.rest_image = self.gel.rest_image
        self._camera = CameraNoise(self.rest_image.shape, brightness, dt_s)
        self._site = model.site("gel").id
        shaped = model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE
        self._felt = np.flatnonzero((model.geom_group == OBJECT_GROUP) & shaped)
        if (model.geom_type[self._felt] == mujoco.mjtGeom.mjGEOM_MESH).any():
            raise InputError(
                "The stand-in's gel feels no meshes; build the task's objects of boxes, cylinders, capsules, "
                "spheres and ellipsoids to play it there."
            )
        self._kinds, self._sizes_mm = model.geom_type[self._felt], 1e3 * model.geom_size[self._felt]
        self._reach = model.geom_rbound[self._felt] + 1e-3 * np.hypot(*window_mm) / 2
        self.begin(np.random.default_rng(0))

    def begin(self, rng: np.random.Generator) -> None:
        """Starts an episode, whose noise `rng` draws."""
        self._camera.begin(rng)
        self._waiting: deque[tuple] = deque()
        self.displacement_mm = np.zeros(self.gel.shape)

    def prepare(self) -> None:
        """Presses a ball that nobody feels: what is compiled at the first touch is so before a clock runs."""
        kinds, sizes_mm, places_mm = [mujoco.mjtGeom.mjGEOM_SPHERE], np.full((1, 3), 4.0), [[0.0, 0.0, 3.5]]
        self.gel.image(self.gel.press(kinds, sizes_mm, np.array(places_mm), np.eye(3)[None])[0])

    def sense(self, data: mujoco.MjData) -> None:
        """Senses the present state; `data` must have its kinematics up to date."""
        self.image, self.pixels, self.area = None, 0, 0.0
        if self._mode == "none":
            return
        self.displacement_mm = self._press(data)
        touched = self.displacement_mm.any()
        clean = self.gel.image(self.displacement_mm) if touched else self.rest_image
        while len(self._waiting) <= LATE_IMAGES:
            image = self._camera.photograph(clean)
            pixels = contact_pixels(image, self.rest_image, self._threshold)
            self._waiting.append((image if self._mode == "image" else None, pixels))
        self.image, self.pixels = self._waiting.popleft()
        self.area = self.pixels / (self.rest_image.shape[0] * self.rest_image.shape[1])

    def _press(self, data: mujoco.MjData) -> np.ndarray:
        away = data.geom_xpos[self._felt] - data.site_xpos[self._site]
        near = np.square(away).sum(1) < self._reach**2
        if not near.any():
            return np.zeros(self.gel.shape)
        R = data.site_xmat[self._site].reshape(3, 3)
        turns = R.T @ data.geom_xmat[self._felt][near].reshape(-1, 3, 3)
        return self.gel.press(self._kinds[near], self._sizes_mm[near], 1e3 * away[near] @ R, turns)[0]


def contact_pixels(image: np.ndarray, rest_image: np.ndarray, threshold_levels: float) -> int:
    """How many pixels of an image uint8 (H, W, 3) differ from the rest image by more, mean over R, G, B.

    The median of 3 x 3 pixels counts, as on the robot: single pixels of noise are no touch.
    """
    change = cv2.absdiff(cv2.medianBlur(image, 3), cv2.medianBlur(rest_image, 3)).reshape(-1, 3)
    return int(np.count_nonzero(change @ np.ones(3, np.uint16) > 3 * threshold_levels))


class CameraNoise:
    """Noise of every pixel, and a slow drift of each channel's brightness about that of the rest image."""

    def __init__(
        self,
        shape: tuple[int, int, int],
        brightness: tuple[float, float, float] = (1.0, 1.0, 1.0),
        dt_s: float = 1 / CONTROL_HZ,
    ):
        """For images of a shape (H, W, 3), `dt_s` apart, whose colours are brighter by these factors."""
        self._brightness, self._keep = np.array(brightness), np.exp(-dt_s / DRIFT_S)
        self._shape, self._size = shape, int(np.prod(shape))
        # Drawing new noise takes longer than a whole control step; stretches of a longer one are as good.
        noise = NOISE_LEVELS * np.random.default_rng(0).standard_normal(3 * self._size, np.float32)
        self._pool = noise.round().astype(np.int8)
        self.begin(np.random.default_rng(0))

    def begin(self, rng: np.random.Generator) -> None:
        """A new episode, whose drift and noise `rng` draws."""
        self._rng, self._drift = rng, DRIFT_SHARE * rng.standard_normal(3)

    def photograph(self, image: np.ndarray) -> np.ndarray:
        """The image (H, W, 3) uint8 as the camera gives it one control step later than the last."""
        keep = self._keep
        self._drift = keep * self._drift + DRIFT_SHARE * np.sqrt(1 - keep**2) * self._rng.standard_normal(3)
        table = np.arange(256)[:, None] * (1 + self._drift) * self._brightness
        bright = cv2.LUT(image, table.clip(0, 255).round().astype(np.uint8)[None])
        start = int(self._rng.integers(len(self._pool) - self._size))
        noise = self._pool[start : start + self._size].reshape(self._shape)
        return cv2.add(bright, noise, dtype=cv2.CV_8U)
