import os
import time
from pathlib import Path

import cv2
import draccus
import numpy as np
import pytest
from draccus.utils import DecodingError
from lerobot.cameras import CameraConfig
from lerobot.cameras.utils import make_cameras_from_configs
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

from lerobot_robot_pneutac import digit_devices
from lerobot_robot_pneutac.config_digit import DigitConfig
from lerobot_robot_pneutac.digit import Digit
from lerobot_robot_pneutac.hardware.parts import HardwareFault
from lerobot_robot_pneutac.rest_image import capture_rest_image
from pneutac_sim.errors import InputError
from pneutac_sim.features import IMAGE_SHAPE
from pneutac_sim.gel.builtin import rest_image
from pneutac_sim.gel.contact import contact_area

LATE_S = 0.6  # a busy computer's delay on top of a stated time
UPRIGHT = rest_image(IMAGE_SHAPE)
NOISY = [
    np.clip(UPRIGHT + np.random.default_rng(i).normal(0, 2, IMAGE_SHAPE), 0, 255).astype(np.float32)
    for i in range(8)
]


def lying(upright: np.ndarray) -> np.ndarray:
    """What the sensor sends for an upright RGB image: BGR, undoing the published transpose and flip."""
    return np.ascontiguousarray(upright[::-1].transpose(1, 0, 2)[..., ::-1])


class Sensor:
    """A DIGIT's firmware: streams images, holds controls, and can fail."""

    def __init__(self):
        self.frame = lambda k: NOISY[k % 8]
        self.controls, self.paths, self.mode, self.count = {}, [], "streams", 0
        self.refuses = None

    def read(self):
        time.sleep(1 / self.controls[cv2.CAP_PROP_FPS])
        if self.mode == "fails":
            return False, None
        while self.mode == "hangs":
            time.sleep(0.01)
        if self.mode != "repeats":
            self.count += 1
        return True, lying(self.frame(self.count).astype(np.uint8))


@pytest.fixture
def sensor(monkeypatch, tmp_path):
    """One sensor behind cv2.VideoCapture, and DIGITs D1 and D2 with a webcam in a made /sys and /dev."""
    sensor = Sensor()

    class Capture:
        def __init__(self, path, backend):
            assert backend == cv2.CAP_V4L2
            sensor.paths.append(path)
            self.open = Path(path).exists()

        def isOpened(self):  # noqa: N802
            return self.open

        def set(self, control, value):
            sensor.controls[control] = value
            return control != sensor.refuses

        def get(self, control):
            return float(sensor.controls.get(control, 0))

        def read(self):
            return sensor.read()

        def release(self):
            self.open, sensor.mode = False, "streams"

    monkeypatch.setattr(cv2, "VideoCapture", Capture)
    monkeypatch.setattr(digit_devices, "SYSFS", tmp_path / "class")
    monkeypatch.setattr(digit_devices, "DEV", tmp_path / "dev")
    for port, (serial, product, firmware) in enumerate(
        [
            ("W9", "HD Webcam", "0100"),
            ("D1", "DIGIT", "0200"),
            ("D2", "DIGIT", "0200"),
            ("D3", "DIGIT", "0101"),
        ]
    ):
        usb = tmp_path / "devices" / f"1-{port}"
        for name, text in {"serial": serial, "product": product, "bcdDevice": firmware}.items():
            (usb / name).parent.mkdir(parents=True, exist_ok=True)
            (usb / name).write_text(text + "\n")
        for index in (0, 1):
            node = f"video{2 * port + index}"
            node_folder = usb / "interface" / "video4linux" / node
            node_folder.mkdir(parents=True)
            (node_folder / "index").write_text(f"{index}\n")
            (node_folder / "device").symlink_to(usb / "interface")
            (tmp_path / "class").mkdir(exist_ok=True)
            (tmp_path / "class" / node).symlink_to(node_folder)
            (tmp_path / "dev").mkdir(exist_ok=True)
            (tmp_path / "dev" / node).touch()
    return sensor


@pytest.fixture
def connected(sensor):
    cameras = []

    def connect(warmup=False, **options) -> Digit:
        camera = Digit(DigitConfig(**({"serial": "D2"} | options)))
        cameras.append(camera)
        camera.connect(warmup)
        return camera

    yield connect
    for camera in cameras:
        if camera.is_connected:
            camera.disconnect()


def seconds_to_fault(camera, limit_s=5.0) -> tuple[float, str]:
    start = time.perf_counter()
    while time.perf_counter() - start < limit_s:
        try:
            camera.async_read()
        except HardwareFault as fault:
            return time.perf_counter() - start, str(fault)
        except TimeoutError:
            pass
    raise AssertionError("no fault")


def test_finds_the_sensor_by_serial_on_its_image_node(sensor, connected, tmp_path):
    connected()
    assert sensor.paths == [str(tmp_path / "dev" / "video4")]
    assert [c["id"] for c in Digit.find_cameras()] == ["D1", "D2", "D3"]


def test_wrong_serial_names_those_found(sensor, connected, monkeypatch, tmp_path):
    with pytest.raises(InputError, match="'D7' is connected; found: D1, D2, D3"):
        connected(serial="D7")
    monkeypatch.setattr(digit_devices, "SYSFS", tmp_path / "nothing")
    with pytest.raises(InputError, match="found: none"):
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
    with pytest.raises(InputError, match="firmware 1.01"):
        connected(serial="D3")


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"resolution": "HD"}, "'HD'; it must be QVGA or VGA"),
        ({"fps": 15}, "fps of the DIGIT is 15; QVGA has 30 and 60"),
        ({"fps": 60, "resolution": "VGA"}, "VGA has 15 and 30"),
        ({"led": (0, 16, 0)}, "from 0 to 15"),
        ({"frozen_s": 0.05}, "exceed two frames"),
        ({"width": 320, "height": 240}, "240 px wide and 320 px high"),
    ],
)
def test_bad_options_are_one_sentence(options, text):
    with pytest.raises(DecodingError, match=text):
        DigitConfig(serial="D2", **options)


def test_lerobot_makes_it_from_a_command_line_option(sensor):
    options = {"type": "digit", "serial": "D2", "led": [15, 0, 15], "fps": 60}
    cameras = make_cameras_from_configs({"tactile": draccus.decode(CameraConfig, options)})
    assert type(cameras["tactile"]).__name__ == "Digit"
    assert (cameras["tactile"].height, cameras["tactile"].width, 3) == IMAGE_SHAPE
    assert cameras["tactile"].fps == 60


def test_image_is_upright_rgb_as_the_simulated_one(sensor, connected):
    image = connected(warmup=True).read()
    assert image.shape == IMAGE_SHAPE and image.dtype == np.uint8
    assert any(np.array_equal(image, noisy.astype(np.uint8)) for noisy in NOISY)


def test_background_reading_keeps_the_sensors_pace_and_hands_out_the_newest(sensor, connected):
    camera = connected(fps=60)
    start, before = time.perf_counter(), sensor.count
    for _ in range(45):
        camera.async_read(1000)
    elapsed, sent = time.perf_counter() - start, sensor.count - before
    assert 44 <= sent <= 46 + 10  # one image each, none twice; some missed where the computer is busy
    assert elapsed == pytest.approx(sent / 60, rel=0.5)
    start, before = time.perf_counter(), sensor.count
    for _ in range(100):
        camera.read_latest()
    assert time.perf_counter() - start < 0.5 and sensor.count - before < 100
    time.sleep(0.2)  # a slow reader gets the last image, not the oldest
    seen = sensor.count
    assert camera.async_read(0).shape == IMAGE_SHAPE
    assert sensor.count - seen <= 1


@pytest.mark.parametrize("mode", ["repeats", "hangs", "fails"])
def test_no_new_image_is_noticed_within_the_stated_time(sensor, connected, mode):
    camera = connected(frozen_s=0.3)
    for _ in range(20):  # twice the limit: a working sensor gives no alarm
        camera.async_read(1000)
    sensor.mode = mode
    waited_s, text = seconds_to_fault(camera)
    assert 0.2 < waited_s < 0.3 + LATE_S
    assert text.startswith("DIGIT D2 has sent no new image for 0.") and text.count(".") == 2
    for read in (camera.read, camera.read_latest):
        with pytest.raises(HardwareFault, match="no new image"):
            read()
    sensor.mode = "streams"  # lets the reading thread end


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
    waited_s, text = seconds_to_fault(camera)
    assert waited_s < LATE_S and text == "DIGIT D2 was unplugged; plug it in and connect again."
    camera.disconnect()
    (tmp_path / "dev" / "video4").touch()
    camera.connect(warmup=False)
    assert camera.read().shape == IMAGE_SHAPE


def test_dark_images_are_no_alarm_when_the_lights_are_off(sensor, connected):
    sensor.frame = lambda k: np.zeros(IMAGE_SHAPE)
    camera = connected(led=(0, 0, 0), frozen_s=0.2)
    for _ in range(12):
        camera.async_read(1000)


def test_reading_needs_a_connection(sensor, connected):
    camera = connected()
    with pytest.raises(DeviceAlreadyConnectedError):
        camera.connect()
    camera.disconnect()
    with pytest.raises(DeviceNotConnectedError):
        camera.async_read()


def test_rest_image_averages_noise_away(sensor, connected):
    image = capture_rest_image(connected(fps=60), frames=16)
    error = np.abs(image.astype(float) - UPRIGHT)
    assert error.mean() < 0.8 < np.abs(NOISY[0] - UPRIGHT).mean()


@pytest.mark.parametrize("moves", ["ball", "light"])
def test_rest_image_refuses_motion(sensor, connected, moves):
    spot = np.zeros(IMAGE_SHAPE)
    spot[100:130, 50:80] = 12.0

    def frame(k):
        change = spot * (k % 12 > 8) if moves == "ball" else 0.5 * k
        return np.clip(NOISY[k % 8] + change, 0, 255)

    sensor.frame = frame
    with pytest.raises(HardwareFault, match=r"rest image of DIGIT D2 was refused.*levels within 24 frames"):
        capture_rest_image(connected(fps=60), frames=24)


def test_recorded_frames_pass_unchanged_and_show_their_contact(sensor, connected):
    if "PNEUTAC_DATA" not in os.environ:
        pytest.skip("PNEUTAC_DATA is not set: no recorded DIGIT frames")
    folder = Path(os.environ["PNEUTAC_DATA"]) / "tactile" / "digit_nagoya"
    rest = cv2.imread(str(folder / "rest_sphere.jpg"))[..., ::-1]
    pressed = cv2.imread(str(folder / "images" / "sphere_frame_4.jpg"))[..., ::-1]
    noise = np.random.default_rng(0).integers(-1, 2, (4, *rest.shape))
    shown = [rest]
    sensor.frame = lambda k: np.clip(shown[0] + noise[k % 4], 0, 255)
    camera = connected(resolution="VGA")
    quiet = capture_rest_image(camera, frames=8)
    assert quiet.shape == (640, 480, 3)
    assert np.abs(quiet.astype(float) - rest).max() <= 1
    assert contact_area(camera.read(), quiet).area < 0.001
    shown[0] = pressed
    camera.read()
    # The recording's table puts a disc of 62 px radius here, 3.9 % of the image; light reaches further.
    assert contact_area(camera.read(), quiet).area > 0.02
