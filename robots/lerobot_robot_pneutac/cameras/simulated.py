"""Cameras of simulations: `digit_generated`, the built-in gel at a camera's pace, and `pneutac_scene`."""

import math
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from lerobot.cameras import Camera, CameraConfig
from lerobot.utils.decorators import check_if_already_connected, check_if_not_connected

from lerobot_camera_digit.elastomer import SMALLEST_PX, Framing
from lerobot_robot_pneutac.options import check_range
from pneutac_sim.features import CAMERA_SHAPE, IMAGE_SHAPE

BALL_RADIUS_M = 0.004
MOST_PX = 4096  # rows or columns of an image; a typo beyond would take all memory


@CameraConfig.register_subclass("pneutac_scene")
@dataclass(kw_only=True)
class PneutacSceneConfig(CameraConfig):
    """A camera next to the simulated robot, which draws what it sees; its name chooses its place."""

    fps: int = 0  # if omitted, the rate at which the world moves on; there is no other
    width: int = CAMERA_SHAPE[1]  # columns of the picture, px
    height: int = CAMERA_SHAPE[0]  # rows of the picture, px


@CameraConfig.register_subclass("digit_generated")
@dataclass(kw_only=True)
class DigitGeneratedConfig(CameraConfig):
    """A DIGIT that is not there: pictures of the built-in gel, for dry runs without a sensor."""

    fps: int = 30  # frames per second
    width: int = IMAGE_SHAPE[1]  # columns of an image; a DIGIT's has 240, and others are scaled from it
    height: int = IMAGE_SHAPE[0]  # rows of an image; a DIGIT's has 320
    press_period_s: float = 0.0  # a ball of radius 4 mm comes and goes once in this time; 0 for no ball
    press_depth_mm: float = 0.8  # depth to which the ball comes

    def __post_init__(self):
        size = (SMALLEST_PX, MOST_PX)
        ends = {"width": size, "height": size, "press_period_s": (0, math.inf), "press_depth_mm": (0, 100)}
        for name, (low, high) in ends.items():
            check_range(f"digit_generated: {name}", getattr(self, name), low, high)
        check_range("digit_generated: fps", self.fps, 1, 1000)


class DigitGenerated(Camera):
    """Frame k is the gel at k / fps seconds after connecting.

    A ball presses with depth D (1 - cos(2 pi t / T)) / 2 in the middle, D and T from the options.
    """

    def __init__(self, config: DigitGeneratedConfig):
        super().__init__(config)
        self.config = config
        self._start_s: float | None = None

    def __str__(self) -> str:
        return "DIGIT (generated)"

    @property
    def is_connected(self) -> bool:
        return self._start_s is not None

    @staticmethod
    def find_cameras() -> list[dict[str, Any]]:
        """None: a generated sensor is not found but made."""
        return []

    @check_if_already_connected
    def connect(self, warmup: bool = True) -> None:
        from pneutac_sim.gel.probe import SPHERE
        from pneutac_sim.gel.sensor import TactileSensor

        self._kind, self._sensor = SPHERE, TactileSensor()
        self._start_s, self._last = time.perf_counter(), -1
        self._image(1)  # compiles before the clock runs
        self._start_s = time.perf_counter()

    def read(self) -> np.ndarray:
        """Waits for the next frame; uint8 (height, width, 3)."""
        return self.async_read(timeout_ms=2000 / self.fps)

    def async_read(self, timeout_ms: float = 200) -> np.ndarray:
        """The newest frame not yet handed out, uint8 (height, width, 3).

        Raises TimeoutError: it comes later than `timeout_ms`.
        """
        wait_s = (self._last + 1) / self.fps - self._time_s()
        if wait_s > 1e-3 * timeout_ms:
            raise TimeoutError(f"{self} has its next frame in {wait_s:.3f} s and was given {timeout_ms} ms.")
        if wait_s > 0:
            time.sleep(wait_s)
        self._last = max(self._last + 1, math.floor(self._time_s() * self.fps))
        return self._image(self._last)

    def read_latest(self, max_age_ms: int = 500) -> np.ndarray:
        """The newest frame at once, uint8 (height, width, 3)."""
        return self._image(math.floor(self._time_s() * self.fps))

    def disconnect(self) -> None:
        self._time_s()
        self._start_s = None

    @check_if_not_connected
    def _time_s(self) -> float:
        return time.perf_counter() - self._start_s

    def _image(self, frame: int) -> np.ndarray:
        """The gel at a frame's time; its first row has noise of one level, so that no two are the same."""
        image = Framing(size=(self.config.height, self.config.width)).apply(self._gel(frame / self.fps))
        image[0] ^= np.random.default_rng(abs(frame)).integers(0, 2, image[0].shape, np.uint8)
        return image

    def _gel(self, time_s: float) -> np.ndarray:
        c = self.config
        if not c.press_period_s:
            return self._sensor.rest_image.copy()
        phase = 2 * math.pi * time_s / c.press_period_s
        depth_m = 0.5e-3 * c.press_depth_mm * (1 - math.cos(phase))
        centre = [0.0, 0.0, BALL_RADIUS_M - depth_m]
        grid = self._sensor.probe([self._kind], [[BALL_RADIUS_M] * 3], [centre], [np.eye(3)])
        return self._sensor.image(grid)
