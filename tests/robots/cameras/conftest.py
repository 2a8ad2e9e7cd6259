"""A DIGIT that exists in software alone: its entries in /sys and /dev and its stream behind OpenCV."""

import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from lerobot_camera_digit import digit as digit_camera
from lerobot_camera_digit.digit import Digit, DigitConfig
from pneutac_sim.features import IMAGE_SHAPE
from pneutac_sim.gel.model import rest_image

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
        self.upright, self.noisy = UPRIGHT, NOISY
        self.frame = lambda k: NOISY[k % 8]
        self.controls, self.paths, self.mode, self.count = {}, [], "streams", 0
        self.refuses, self.lost, self.sent = None, 0, 0

    def read(self):
        time.sleep(1 / self.controls[cv2.CAP_PROP_FPS])
        if self.mode == "fails":
            return False, None
        while self.mode == "hangs":
            time.sleep(0.01)
        if self.mode != "repeats":
            self.count += 1
        self.sent += 1 + self.lost  # images that the driver has taken or missed, at the sensor's pace
        self.lost = 0
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
            if control == cv2.CAP_PROP_POS_MSEC:
                return 1e3 * (5 + sensor.sent / sensor.controls[cv2.CAP_PROP_FPS])
            return float(sensor.controls.get(control, 0))

        def read(self):
            return sensor.read()

        def release(self):
            self.open, sensor.mode = False, "streams"

    monkeypatch.setattr(cv2, "VideoCapture", Capture)
    monkeypatch.setattr(digit_camera, "SYSFS", tmp_path / "class")
    monkeypatch.setattr(digit_camera, "DEV", tmp_path / "dev")
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
