"""Contact area, depth and points of a DIGIT, for any robot of LeRobot's."""

import cv2
import numpy as np
import pytest
from lerobot.configs import PipelineFeatureType
from lerobot.processor import DataProcessorPipeline, TransitionKey

from lerobot_camera_digit import (
    Digit,
    DigitConfig,
    DigitTouch,
    DigitTouchStep,
    HardwareFault,
    contact_share,
    depth_m,
)
from lerobot_camera_digit.touch import GRID, POINTS, displacement_points
from pneutac_sim.features import POINTS_KEY, POINTS_SHAPE
from pneutac_sim.gel.contact import contact_area, quieted

SHAPE, PX_PER_MM = (320, 240, 3), 20.0
LIGHT = np.array([[60.0, 10.0], [-30.0, 55.0], [-35.0, -50.0]])


def imprint(depth_mm: float = 0.6) -> np.ndarray:
    """A smooth bump (H, W) in mm, off the middle."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] / PX_PER_MM
    return depth_mm * np.exp(-((x - 5) ** 2 + (y - 9) ** 2) / 2 / 1.2**2)


def shaded(u_mm: np.ndarray, rest: np.ndarray) -> np.ndarray:
    slope = np.stack(np.gradient(u_mm, 1 / PX_PER_MM)[::-1], -1)  # along columns, then rows
    return np.clip(np.round(rest + slope @ LIGHT.T), 0, 255).astype(np.uint8)


REST = np.full(SHAPE, 120, np.uint8)


def test_depth_is_the_surface_that_was_shaded():
    u = imprint()
    depth = depth_m(shaded(u, REST), REST, LIGHT, PX_PER_MM)
    assert depth.shape == (*SHAPE[:2], 1) and depth.dtype == np.float32
    np.testing.assert_allclose(1e3 * depth[..., 0], u, atol=0.02)
    assert np.abs(depth_m(REST, REST, LIGHT, PX_PER_MM)).max() == 0
    points = displacement_points(depth)
    cells = u.reshape(16, 20, 12, 20).mean((1, 3))
    np.testing.assert_allclose(points[..., 2], -cells, atol=0.02)
    assert cells.max() > 0.4 and not points[..., :2].any()


def test_contact_is_that_of_the_library():
    rng = np.random.default_rng(0)
    image = shaded(imprint(), REST)
    noisy = np.clip(image + rng.normal(0, 3, SHAPE), 0, 255).astype(np.uint8)
    expected = contact_area(quieted(noisy), quieted(REST), 12.0).area
    assert contact_share(noisy, REST) == pytest.approx(expected) and expected > 0.005
    with pytest.raises(ValueError, match="two uint8 images of one shape"):
        contact_share(noisy[:100], REST)


class Arm:
    """The least that LeRobot's robots have, without their files."""

    name = "arm"

    def __init__(self, cameras):
        self.cameras, self.is_connected = cameras, False

    @property
    def observation_features(self):
        return {"joint.pos": float, **dict.fromkeys(self.cameras, SHAPE)}

    def connect(self, calibrate=True):
        for camera in self.cameras.values():
            camera.connect(warmup=False)
        self.is_connected = True

    def disconnect(self):
        for camera in self.cameras.values():
            camera.disconnect()
        self.is_connected = False

    def get_observation(self):
        return {"joint.pos": 0.1, **{n: c.async_read(1000) for n, c in self.cameras.items()}}


class FeelingArm(DigitTouch, Arm):
    pass


def test_any_robot_gets_the_contact_area(sensor):
    robot = FeelingArm({"tactile": Digit(DigitConfig(serial="D2", fps=60))})
    assert robot.observation_features["tactile.contact_area.pos"] is float
    robot.connect()
    try:
        assert robot.get_observation()["tactile.contact_area.pos"] < 1e-3
        sensor.frame = lambda k: np.clip(sensor.noisy[k % 8] + 60 * (imprint() > 0.3)[..., None], 0, 255)
        for _ in range(3):
            felt = robot.get_observation()["tactile.contact_area.pos"]
        assert felt == pytest.approx((imprint() > 0.3).mean(), rel=0.3)
        assert set(robot.get_observation()) == set(robot.observation_features)
    finally:
        robot.disconnect()


def test_a_touched_gel_lets_the_robot_go_again(sensor):
    robot = FeelingArm({"tactile": Digit(DigitConfig(serial="D2", fps=60))})
    sensor.frame = lambda k: np.clip(sensor.noisy[k % 8] + k, 0, 255)
    with pytest.raises(HardwareFault, match="rest image of DIGIT D2 was refused"):
        robot.connect()
    assert not robot.is_connected


def test_the_step_adds_depth_and_points_and_is_stored(tmp_path):
    file = tmp_path / "rest.png"
    cv2.imwrite(str(file), REST[..., ::-1])
    step = DigitTouchStep(str(file), LIGHT.tolist(), PX_PER_MM)
    out = step({TransitionKey.OBSERVATION: {"tactile": shaded(imprint(), REST)}})[TransitionKey.OBSERVATION]
    assert out["tactile.depth"].max() == pytest.approx(0.6e-3, rel=0.05)
    assert out["tactile.points"].shape == (GRID[0] * GRID[1] * 3,)
    features = step.transform_features({PipelineFeatureType.OBSERVATION: {}})
    assert features[PipelineFeatureType.OBSERVATION] == {"tactile.depth": (320, 240, 1)}
    DataProcessorPipeline([step]).save_pretrained(tmp_path / "steps")
    again = DataProcessorPipeline.from_pretrained(
        tmp_path / "steps", config_filename="dataprocessorpipeline.json"
    )
    assert again.steps[0].get_config() == step.get_config()
    with pytest.raises(ValueError, match="no image 'tactile'"):
        step({TransitionKey.OBSERVATION: {}})
    with pytest.raises(ValueError, match="no picture"):
        DigitTouchStep(str(tmp_path / "none.png"), LIGHT.tolist(), PX_PER_MM)
    with pytest.raises(ValueError, match="3 rows of 2"):
        DigitTouchStep(str(file), [[0.0, 0.0]] * 3, PX_PER_MM)


def test_names_and_layout_are_those_of_the_library():
    assert POINTS.format(sensor="tactile") == POINTS_KEY and GRID == POINTS_SHAPE[:2]
