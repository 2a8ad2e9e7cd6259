"""What a DIGIT's image says of a touch: contact area, depth and points, and how a robot gets them.

An image is compared with the rest image, which was taken while nothing touched the gel.
"""

from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from lerobot.cameras import Camera
from lerobot.configs import PipelineFeatureType
from lerobot.processor import ObservationProcessorStep, ProcessorStepRegistry

from lerobot_camera_digit.digit import Digit
from lerobot_camera_digit.elastomer import Elastomer
from lerobot_camera_digit.parts import HardwareFault

# Names and layout of touch, to change once LeRobot decides how `observation.tactile.*` is stored; its
# proposed tactile module, huggingface/lerobot pull request 4469, leaves it open. Points are displacements
# (mm), stored as one vector: LeRobot 0.6 merges no datasets with other arrays.
AREA, DEPTH, POINTS = "{sensor}.contact_area.pos", "{sensor}.depth", "{sensor}.points"
GRID = 16, 12  # rows and columns of points, about a millimetre apart on a DIGIT

THRESHOLD_LEVELS = 12.0  # 99.9 % of a real DIGIT's pixels without contact stay below it
BLOCK_PX = 8  # blocks average the pixels' noise away: 2 levels per pixel become 1/4
BLACK_LEVEL, WHITE_LEVEL = 8, 247  # an image below or above all over shows nothing
MOTION_LEVELS = 2.0  # a touch moves its blocks by more than `THRESHOLD_LEVELS`


def capture_rest_image(camera: Camera, frames: int = 30) -> np.ndarray:
    """Mean uint8 (H, W, 3) of the next images, two or more, of a camera while nothing touches the gel.

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


def _blocks(image: np.ndarray) -> np.ndarray:
    """Means of blocks: float32 (H / 8, W / 8, 3)."""
    rows, columns = image.shape[0] // BLOCK_PX, image.shape[1] // BLOCK_PX
    return cv2.resize(image.astype(np.float32), (columns, rows), interpolation=cv2.INTER_AREA)


def contact_share(
    image: np.ndarray, rest_image: np.ndarray, threshold_levels: float = THRESHOLD_LEVELS
) -> float:
    """Share of the pixels in contact: where the mean over R, G, B of |image - rest| exceeds the threshold.

    Both images, uint8 (H, W, 3), are first freed of single noisy pixels by medians of 3 x 3. Raises
    ValueError where they differ in shape or are not uint8.
    """
    return float((np.abs(_difference(image, rest_image)).sum(2) > int(3 * threshold_levels)).mean())


def depth_m(image: np.ndarray, rest_image: np.ndarray, light: np.ndarray, px_per_mm: float) -> np.ndarray:
    """Depth of an imprint by photometric stereo: float32 (H, W, 1), m, 0 along the mean border.

    The difference of the images, uint8 (H, W, 3) with H and W even, is light @ slope (Johnson and Adelson,
    CVPR 2009, linearised), of which the slope is the least-squares solution; the depth is its integral with
    free borders (Frankot and Chellappa, IEEE PAMI 10, 1988, by cosines). `light` (3, 2) is in levels per unit
    slope of R, G, B along columns and rows. Raises ValueError where shapes do not fit, or a side of the image
    is odd.
    """
    height, width = image.shape[:2]
    if height % 2 or width % 2:
        raise ValueError(f"the image is {height} x {width}; its sides must be even")
    slope = _difference(image, rest_image) @ np.linalg.pinv(np.asarray(light, float)).T.astype(np.float32)
    rise = slope / px_per_mm  # mm a pixel
    along_x, along_y = rise[:, 1:, 0] + rise[:, :-1, 0], rise[1:, :, 1] + rise[:-1, :, 1]
    source = np.diff(np.pad(0.5 * along_x, ((0, 0), (1, 1))), axis=1)
    source += np.diff(np.pad(0.5 * along_y, ((1, 1), (0, 0))), axis=0)
    eigen = [2 * np.cos(np.pi * np.arange(n) / n) - 2 for n in (height, width)]
    whole = eigen[0][:, None] + eigen[1]
    whole[0, 0] = 1.0
    depth = cv2.dct(cv2.dct(source.astype(np.float64)) / whole, flags=cv2.DCT_INVERSE)
    border = np.concatenate([depth[0], depth[-1], depth[:, 0], depth[:, -1]])
    return (1e-3 * (depth - border.mean()))[..., None].astype(np.float32)


def displacement_points(depth: np.ndarray) -> np.ndarray:
    """Displacement of the face at `GRID` points, float32 (rows, columns, 3), mm, of a depth (H, W, 1), m.

    dz is the mean over a point's cell, below 0 where the face is pressed in; dx and dy are 0, since shading
    does not show them.
    """
    rows, columns = GRID
    out = np.zeros((rows, columns, 3), np.float32)
    out[..., 2] = -1e3 * cv2.resize(depth[..., 0], (columns, rows), interpolation=cv2.INTER_AREA)
    return out


def _difference(image: np.ndarray, rest_image: np.ndarray) -> np.ndarray:
    """Image less rest image, float32 (H, W, 3) levels."""
    if image.shape != rest_image.shape or image.dtype != np.uint8 or rest_image.dtype != np.uint8:
        raise ValueError(
            f"two uint8 images of one shape are needed; got {image.dtype} {image.shape} and"
            f" {rest_image.dtype} {rest_image.shape}"
        )
    return cv2.medianBlur(image, 3).astype(np.float32) - cv2.medianBlur(rest_image, 3)


class DigitTouch:
    """Adds the contact area of each DIGIT to the state of any robot: `class Mine(DigitTouch, SO101Follower)`.

    Connecting takes the rest images, so nothing may touch a gel meanwhile.

    Attributes:
        touch_threshold_levels: of contact, see `contact_share`.
        rest_images: by camera, once connected.
    """

    touch_threshold_levels = THRESHOLD_LEVELS

    def _touch_cameras(self) -> list[str]:
        return [name for name, camera in self.cameras.items() if isinstance(camera, Digit | Elastomer)]

    @property
    def observation_features(self) -> dict:
        """The robot's own, and a float for each sensor."""
        names = [AREA.format(sensor=c) for c in self._touch_cameras()]
        return super().observation_features | dict.fromkeys(names, float)

    def connect(self, calibrate: bool = True) -> None:
        """Connects and takes the rest images.

        Raises:
            HardwareFault: a gel is touched; the robot is disconnected again.
        """
        super().connect(calibrate)
        try:
            self.rest_images = {c: capture_rest_image(self.cameras[c]) for c in self._touch_cameras()}
        except BaseException:
            self.disconnect()
            raise

    def get_observation(self) -> dict:
        """The robot's own, and the share of each sensor's image that is in contact."""
        observation = super().get_observation()
        for name, rest in self.rest_images.items():
            share = contact_share(observation[name], rest, self.touch_threshold_levels)
            observation[AREA.format(sensor=name)] = share
        return observation


@ProcessorStepRegistry.register("digit_touch")
@dataclass
class DigitTouchStep(ObservationProcessorStep):
    """Adds a sensor's depth and points to a robot's observation.

    Raises:
        ValueError: the rest image cannot be read, or the light is not 3 x 2 numbers.
    """

    rest_image: str  # PNG of the sensor without contact
    # levels per unit slope of R, G, B along columns and rows, see `depth_m`; `gel.light` of a twin that
    # `pneutac calibrate` has made
    light: list[list[float]]
    px_per_mm: float  # scale of the image
    sensor: str = "tactile"  # name of its image in the observation
    _rest: np.ndarray = field(init=False, repr=False)

    def __post_init__(self):
        image = cv2.imread(str(self.rest_image)) if Path(self.rest_image).is_file() else None
        if image is None:
            raise ValueError(f"rest_image is '{self.rest_image}', which is no picture that can be read.")
        self._rest = image[..., ::-1].copy()
        light = np.asarray(self.light, float)
        if light.shape != (3, 2) or not np.isfinite(light).all() or np.linalg.matrix_rank(light) < 2:
            raise ValueError(f"light is {self.light}; give levels per unit slope, 3 rows of 2 numbers.")

    def observation(self, observation):
        """The observation with the sensor's depth and points."""
        if self.sensor not in observation:
            raise ValueError(f"The observation has no image '{self.sensor}'; name the sensor's as `sensor`.")
        depth = depth_m(np.asarray(observation[self.sensor]), self._rest, self.light, self.px_per_mm)
        points = displacement_points(depth).ravel()
        return observation | {
            DEPTH.format(sensor=self.sensor): depth,
            POINTS.format(sensor=self.sensor): points,
        }

    def get_config(self) -> dict:
        return {
            "rest_image": str(self.rest_image),
            "light": [[float(v) for v in row] for row in self.light],
            "px_per_mm": self.px_per_mm,
            "sensor": self.sensor,
        }

    def transform_features(self, features):
        """The features and the depth; a robot's features have no place for points."""
        name = DEPTH.format(sensor=self.sensor)
        features[PipelineFeatureType.OBSERVATION][name] = (*self._rest.shape[:2], 1)
        return features
