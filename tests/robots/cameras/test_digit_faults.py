import time

import numpy as np
import pytest
from awake import awake_s, hold_up_us

from lerobot_robot_pneutac.hardware.parts import HardwareFault
from pneutac_sim.features import IMAGE_SHAPE

LATE_S = 0.6  # a busy computer's delay on top of a stated time

# They wait as long as a sensor may.
pytestmark = pytest.mark.realtime


def seconds_to_fault(camera, limit_s=5.0) -> tuple[float, float, str]:
    """By the clock, and of them those in which this process ran; what the fault says."""
    began_s, start_s = time.perf_counter(), awake_s()
    while awake_s() - start_s < limit_s:
        try:
            camera.async_read()
        except HardwareFault as fault:
            return time.perf_counter() - began_s, awake_s() - start_s, str(fault)
        except TimeoutError:
            pass
    raise AssertionError("no fault")


@pytest.mark.parametrize("mode", ["repeats", "hangs", "fails"])
def test_no_new_image_is_noticed_within_the_stated_time(sensor, connected, mode):
    camera = connected(frozen_s=0.3)
    for _ in range(20):  # twice the limit: a working sensor gives no alarm
        camera.async_read(1000)
    sensor.mode = mode
    waited_s, ran_s, text = seconds_to_fault(camera)
    assert 0.2 < waited_s and ran_s < 0.3 + LATE_S
    assert text.startswith("DIGIT D2 has sent no new image for 0.") and text.count(".") == 2
    for read in (camera.read, camera.read_latest):
        with pytest.raises(HardwareFault, match="no new image"):
            read()
    sensor.mode = "streams"  # lets the reading thread end


@pytest.mark.parametrize("read", ["read", "async_read", "read_latest"])
def test_a_computer_that_stalls_is_not_taken_for_a_frozen_sensor(connected, read):
    camera = connected(frozen_s=0.2)
    camera.async_read(1000)
    for _ in range(3):
        hold_up_us(300_000)
        assert getattr(camera, read)().shape == IMAGE_SHAPE


def test_one_broken_image_is_skipped(sensor, connected):
    camera = connected(frozen_s=1.0)
    camera.async_read(1000)
    sensor.mode = "fails"
    time.sleep(0.1)
    sensor.mode = "streams"
    assert camera.read().shape == IMAGE_SHAPE


def test_unplugging_is_said_at_once_and_plugging_in_mends_it(sensor, connected, tmp_path):
    camera = connected()
    camera.async_read(1000)
    (tmp_path / "dev" / "video4").unlink()
    sensor.mode = "fails"
    _, ran_s, text = seconds_to_fault(camera)
    assert ran_s < LATE_S and text == "DIGIT D2 was unplugged; plug it in and connect again."
    camera.disconnect()
    (tmp_path / "dev" / "video4").touch()
    camera.connect(warmup=False)
    assert camera.read().shape == IMAGE_SHAPE


def test_dark_images_are_no_alarm_when_the_lights_are_off(sensor, connected):
    sensor.frame = lambda k: np.zeros(IMAGE_SHAPE)
    camera = connected(led=(0, 0, 0), frozen_s=0.2)
    for _ in range(12):
        camera.async_read(1000)
