import time

import cv2
import numpy as np
import pytest
from awake import awake_s, undisturbed
from draccus.utils import DecodingError
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

from lerobot_camera_digit import digit as digit_camera
from lerobot_camera_digit.digit import Digit, DigitConfig
from lerobot_robot_pneutac.hardware.parts import HardwareFault
from pneutac_sim.features import IMAGE_SHAPE


def test_finds_the_sensor_by_serial_on_its_image_node(sensor, connected, tmp_path):
    connected()
    assert sensor.paths == [str(tmp_path / "dev" / "video4")]
    assert [c["id"] for c in Digit.find_cameras()] == ["D1", "D2", "D3"]


def test_wrong_serial_names_those_found(sensor, connected, monkeypatch, tmp_path):
    with pytest.raises(HardwareFault, match="'D7' is connected; found: D1 at port 1-1, D2 at"):
        connected(serial="D7")
    monkeypatch.setattr(digit_camera, "SYSFS", tmp_path / "nothing")
    with pytest.raises(HardwareFault, match="found: none"):
        connected()


def test_lights_are_set_as_the_sensor_takes_them(sensor, connected, caplog):
    connected(led=(1, 2, 15))
    assert sensor.controls[cv2.CAP_PROP_ZOOM] == 0x12F
    assert (sensor.controls[cv2.CAP_PROP_FRAME_WIDTH], sensor.controls[cv2.CAP_PROP_FRAME_HEIGHT]) == (
        320,
        240,
    )


def test_refused_settings_and_old_firmware_are_said(sensor, connected):
    sensor.refuses = cv2.CAP_PROP_ZOOM
    with pytest.raises(HardwareFault, match="LED brightness"):
        connected()
    sensor.refuses = cv2.CAP_PROP_FPS
    with pytest.raises(HardwareFault, match="DIGIT D2 at .*video4 cannot be used.*fps=30.*'video'"):
        connected()
    with pytest.raises(HardwareFault, match="firmware 1.01"):
        connected(serial="D3")


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"resolution": "HD"}, "'HD'; it must be QVGA or VGA"),
        ({"fps": 15}, "fps of the DIGIT is 15; QVGA has 30 and 60"),
        ({"led": (0, 16, 0)}, "from 0 to 15"),
        ({"frozen_s": 0.05}, "exceed two frames"),
        ({"width": 320}, "the DIGIT has width 320 and height None; give both, or neither for 240 x 320 px"),
    ],
)
def test_bad_options_are_one_sentence(options, text):
    with pytest.raises(DecodingError, match=text):
        DigitConfig(**{"serial": "D2"} | options)


def test_image_is_upright_rgb_as_the_simulated_one(sensor, connected):
    image = connected(warmup=True).read()
    assert image.shape == IMAGE_SHAPE and image.dtype == np.uint8
    assert any(np.array_equal(image, noisy.astype(np.uint8)) for noisy in sensor.noisy)


def test_a_large_image_is_scaled_to_the_simulated_sensors(sensor, connected):
    image = connected(warmup=True, width=120, height=160, mirror=True).read()
    assert image.shape == (160, 120, 3)
    half = cv2.resize(sensor.upright[:, ::-1].astype(np.uint8), (120, 160), interpolation=cv2.INTER_AREA)
    assert np.abs(image.astype(int) - half).mean() < 2  # noise


@pytest.mark.realtime
def test_background_reading_keeps_the_sensors_pace_and_hands_out_the_newest(sensor, connected):
    camera = connected(fps=60)
    start, before, awake = time.perf_counter(), sensor.count, awake_s()
    for _ in range(45):
        camera.async_read(1000)
    elapsed, sent = time.perf_counter() - start, sensor.count - before
    assert sent >= 44 and 0.95 * 44 / 60 < elapsed  # no image twice; a busy computer misses some
    assert awake_s() - awake < 3.0
    before, awake = sensor.count, awake_s()
    for _ in range(100):
        camera.read_latest()
    assert awake_s() - awake < 0.5 and sensor.count - before < 100

    def a_slow_reader_gets_the_last_image_not_the_oldest():
        time.sleep(0.2)
        seen = sensor.count
        image = camera.async_read(0)
        shown = [np.array_equal(image, noisy.astype(np.uint8)) for noisy in sensor.noisy].index(True)
        assert (shown - seen) % len(sensor.noisy) in (7, 0, 1)

    undisturbed(a_slow_reader_gets_the_last_image_not_the_oldest)


def test_reading_needs_a_connection(sensor, connected):
    camera = connected()
    with pytest.raises(DeviceAlreadyConnectedError):
        camera.connect()
    camera.disconnect()
    with pytest.raises(DeviceNotConnectedError):
        camera.async_read()


def test_two_sensors_with_one_serial_are_refused_with_both_devices(sensor, connected, monkeypatch, tmp_path):
    devices = digit_camera.find_digits()
    second = next(d for d in devices if d.serial == "D2")._replace(
        path=tmp_path / "dev" / "video8", port="1-9"
    )
    monkeypatch.setattr("lerobot_camera_digit.digit.find_digits", lambda: [*devices, second])
    with pytest.raises(
        HardwareFault, match="2 DIGITs have the serial 'D2'; give also the port .* one of 1-2 and 1-9"
    ):
        connected()


def test_sensors_with_the_factory_serial_are_reported_by_their_port(sensor, connected, tmp_path):
    for port in (1, 2):
        (tmp_path / "devices" / f"1-{port}" / "serial").write_text("DXXXXX\n")
    with pytest.raises(
        HardwareFault, match="'DXXXXX', which the firmware has by default; give also the port"
    ):
        connected(serial="DXXXXX")
    camera = connected(serial="DXXXXX", port="1-2")
    assert sensor.paths == [str(tmp_path / "dev" / "video4")] and camera.device.port == "1-2"
    with pytest.raises(HardwareFault, match="'DXXXXX' at port 1-7 is connected; found: D3 at port 1-3, DXX"):
        connected(serial="DXXXXX", port="1-7")


def test_exposure_and_white_balance_are_fixed_or_held(sensor, connected):
    exposure, white = digit_camera.CONTROLS["exposure"], digit_camera.CONTROLS["white_balance"]
    connected()
    assert not {exposure[0], exposure[3], white[0], white[3]} & set(sensor.controls)
    connected(exposure=120, white_balance=4600)
    assert [sensor.controls[c] for c in (exposure[0], exposure[3], white[0], white[3])] == [1, 120, 0, 4600]
    sensor.controls[exposure[3]] = 77.0  # what the automatic has found
    connected(lock=True, white_balance=5000)
    assert [sensor.controls[c] for c in (exposure[0], exposure[3], white[0], white[3])] == [1, 77, 0, 5000]
    sensor.refuses = white[3]
    with pytest.raises(
        HardwareFault, match="DIGIT D2 does not take a fixed white_balance of 5000; leave option"
    ):
        connected(lock=True)


def test_dropped_images_are_counted_and_logged(sensor, connected, caplog):
    camera = connected(fps=60)
    for _ in range(5):
        camera.async_read(1000)
    assert camera.dropped == 0
    for lost in (3, 1):
        sensor.lost = lost
        for _ in range(3):
            camera.async_read(1000)
    assert camera.dropped == 4 and camera.received >= 11
    camera.disconnect()
    assert "DIGIT D2: 4 images were dropped" in caplog.text
