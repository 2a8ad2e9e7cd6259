"""What the stand-in's gel delivers: a full elastic layer, seen late by a noisy camera that drifts."""

from collections import deque
from typing import override

import cv2
import mujoco
import numpy as np

from pneutac_sim.features import CONTROL_HZ
from pneutac_sim.gel.layer import LayerGel
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.sensor import TactileSensor
from pneutac_sim.world.touch import Touch

LATE_IMAGES = 1  # control steps
NOISE_LEVELS = 1.5  # standard deviation of a pixel's channel
DRIFT_SHARE, DRIFT_S = 0.012, 20.0  # of the brightness of a channel, and over how long it wanders
POISSONS_RATIO, STIFFENING_MM = 0.48, 8.0  # of the layer


class StandinTouch(Touch):
    """The touch of the stand-in: `image`, `pixels`, `area` are late and noisy, `depth_mm` is the present."""

    def __init__(self, model: mujoco.MjModel, sensor: TactileSensor, mode: str, full=None):
        """The touch of a world.

        Args:
            model: of the world.
            sensor: the gel's.
            mode: one of `touch.MODES`.
            full: an `MpmGel` in place of the elastic layer.
        """
        super().__init__(model, sensor, mode, full)
        if full is None:
            sensor.surface = _layer(sensor.model).displacement
        self._camera = CameraNoise(sensor.rest_image.shape)
        self.begin(np.random.default_rng(0))

    def begin(self, rng: np.random.Generator) -> None:
        """A new episode, whose noise `rng` draws."""
        self._camera.begin(rng)
        self._waiting: deque[tuple] = deque()

    @override
    def sense(self, data: mujoco.MjData) -> None:
        super().sense(data)
        if self._mode in ("probe", "none"):
            return
        clean = self.sensor.image(self.depth_mm) if self.image is None else self.image
        while len(self._waiting) <= LATE_IMAGES:
            image = self._camera.photograph(clean)
            contact = self.sensor.contact(image)
            shown = None if self.image is None else image
            self._waiting.append((shown, contact.pixels, contact.area))
        self.image, self.pixels, self.area = self._waiting.popleft()


def standin_sensor(gel: GelModel) -> TactileSensor:
    """A sensor whose gel is the stand-in's elastic layer, without noise."""
    return TactileSensor(gel, _layer(gel).displacement)


def _layer(gel: GelModel) -> LayerGel:
    return LayerGel(gel.window_mm, gel.thickness_mm, POISSONS_RATIO, stiffening_mm=STIFFENING_MM)


class CameraNoise:
    """Noise of every pixel, and a slow drift of each channel's brightness about that of the rest image."""

    def __init__(self, shape: tuple[int, int, int]):
        """For images of a shape (H, W, 3)."""
        self._shape, self._size = shape, int(np.prod(shape))
        # Drawing noise anew takes longer than a whole control step; stretches of a longer one are as good.
        noise = NOISE_LEVELS * np.random.default_rng(0).standard_normal(3 * self._size, np.float32)
        self._pool = noise.round().astype(np.int8)
        self.begin(np.random.default_rng(0))

    def begin(self, rng: np.random.Generator) -> None:
        """A new episode, whose drift and noise `rng` draws."""
        self._rng, self._drift = rng, DRIFT_SHARE * rng.standard_normal(3)

    def photograph(self, image: np.ndarray) -> np.ndarray:
        """The image (H, W, 3) uint8 as the camera gives it one control step later than the last."""
        keep = np.exp(-1 / (CONTROL_HZ * DRIFT_S))
        self._drift = keep * self._drift + DRIFT_SHARE * np.sqrt(1 - keep**2) * self._rng.standard_normal(3)
        table = np.arange(256)[:, None] * (1 + self._drift)
        bright = cv2.LUT(image, table.clip(0, 255).round().astype(np.uint8)[None])
        start = int(self._rng.integers(len(self._pool) - self._size))
        noise = self._pool[start : start + self._size].reshape(self._shape)
        return cv2.add(bright, noise, dtype=cv2.CV_8U)
