import time

import numpy as np
import pytest
from draccus.utils import DecodingError
from lerobot.cameras.utils import make_cameras_from_configs
from lerobot.utils.errors import DeviceNotConnectedError

from lerobot_robot_pneutac.config_digit_generated import DigitGeneratedConfig
from lerobot_robot_pneutac.hardware.parts import HardwareFault
from lerobot_robot_pneutac.rest_image import capture_rest_image
from pneutac_sim.features import IMAGE_SHAPE
from pneutac_sim.gel.builtin import rest_image
from pneutac_sim.gel.contact import contact_area

REST = rest_image(IMAGE_SHAPE)


def generated(**options):
    camera = make_cameras_from_configs({"tactile": DigitGeneratedConfig(**options)})["tactile"]
    camera.connect()
    return camera


def test_at_rest_it_shows_the_gels_rest_image():
    camera = generated()
    assert (camera.height, camera.width, 3) == IMAGE_SHAPE
    np.testing.assert_array_equal(capture_rest_image(camera, frames=3), REST)
    camera.disconnect()
    with pytest.raises(DeviceNotConnectedError):
        camera.read()


def test_the_ball_comes_and_goes_once_a_period():
    camera = generated(fps=60, press_period_s=0.8)
    camera.read()
    areas, times = [], []
    while not times or times[-1] < 0.8:
        image = camera.async_read()
        times.append(camera._last / 60)
        areas.append(contact_area(image, REST).area)
    areas, times = np.array(areas), np.array(times)
    assert areas[(times > 0.3) & (times < 0.5)].min() > 0.01
    assert areas[times < 0.1].max(initial=0.0) < 0.2 * areas.max()
    assert areas[times > 0.78].max() < 0.2 * areas.max()
    with pytest.raises(HardwareFault, match="was refused"):
        capture_rest_image(camera, frames=24)


def test_frames_come_at_the_cameras_pace():
    camera = generated(fps=30)
    camera.read()
    start = time.perf_counter()
    for _ in range(15):
        camera.async_read()
    assert time.perf_counter() - start == pytest.approx(0.5, abs=0.1)
    with pytest.raises(TimeoutError, match="next frame in 0.0"):
        for _ in range(2):
            camera.async_read(timeout_ms=0)


def test_bad_options_are_one_sentence():
    with pytest.raises(DecodingError, match="must be 240 and 320"):
        DigitGeneratedConfig(width=320, height=240)
    with pytest.raises(DecodingError, match="press_period_s -1"):
        DigitGeneratedConfig(press_period_s=-1)
