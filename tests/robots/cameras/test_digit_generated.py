import types

import numpy as np
import pytest
from draccus.utils import DecodingError
from lerobot.cameras.utils import make_cameras_from_configs
from lerobot.utils.errors import DeviceNotConnectedError

from lerobot_robot_pneutac.cameras import simulated
from lerobot_robot_pneutac.cameras.simulated import DigitGeneratedConfig
from lerobot_robot_pneutac.cameras.tactile import capture_rest_image
from pneutac_sim.features import IMAGE_SHAPE
from pneutac_sim.gel.model import rest_image

REST = rest_image(IMAGE_SHAPE)


@pytest.fixture
def clock(monkeypatch):
    """Time that passes only in `sleep` and where a test moves it."""
    clock = types.SimpleNamespace(now_s=100.0)

    def sleep(seconds):
        clock.now_s += seconds + 1e-6

    fake = types.SimpleNamespace(perf_counter=lambda: clock.now_s, sleep=sleep)
    monkeypatch.setattr(simulated, "time", fake)
    return clock


def generated(**options):
    camera = make_cameras_from_configs({"tactile": DigitGeneratedConfig(**options)})["tactile"]
    camera.connect()
    return camera


def test_at_rest_it_shows_the_gels_rest_image(clock):
    camera = generated()
    assert (camera.height, camera.width, 3) == IMAGE_SHAPE
    np.testing.assert_array_equal(capture_rest_image(camera, frames=3)[1:], REST[1:])
    frames = [camera.read() for _ in range(3)]
    assert not np.array_equal(frames[0], frames[1])  # a live camera has noise, here in its first row
    assert np.abs(np.subtract(frames, REST, dtype=int)).max() == 1
    camera.disconnect()
    with pytest.raises(DeviceNotConnectedError):
        camera.read()


def test_frames_come_at_the_cameras_pace(clock):
    camera = generated(fps=30)
    camera.read()
    start_s = clock.now_s
    for _ in range(15):
        camera.async_read()
    assert clock.now_s - start_s == pytest.approx(0.5, abs=1e-3)
    with pytest.raises(TimeoutError, match="next frame in 0.03"):
        camera.async_read(timeout_ms=20)
    clock.now_s += 1.0  # a slow reader gets the newest frame and then waits for the next one
    camera.async_read(timeout_ms=0)
    start_s = clock.now_s
    camera.async_read()
    assert 0 < clock.now_s - start_s <= 1 / 30 + 1e-3
    camera.read_latest()
    assert clock.now_s - start_s <= 1 / 30 + 1e-3


def test_bad_options_are_one_sentence():
    with pytest.raises(DecodingError, match="height is 20; it must be 32 or more"):
        DigitGeneratedConfig(width=320, height=20)
    with pytest.raises(DecodingError, match="press_period_s is -1; it must be 0 or more"):
        DigitGeneratedConfig(press_period_s=-1)
    with pytest.raises(DecodingError, match="width is 1000000000; it must be 32 or more and at most 4096"):
        DigitGeneratedConfig(width=10**9)
    with pytest.raises(DecodingError, match="fps is 1000000000; it must be 1 or more and at most 1000"):
        DigitGeneratedConfig(fps=10**9)
