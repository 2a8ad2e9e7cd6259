"""The camera `digit`: a DIGIT tactile sensor, read in the background as LeRobot reads any USB camera.

The stream sizes, the turned image and the LEDs behind the zoom control are those of the sensor's published
interface (digit-interface, firmware 2.00 and later).
"""

import logging
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from lerobot.cameras import CameraConfig
from lerobot.cameras.configs import Cv2Backends, Cv2Rotation
from lerobot.cameras.opencv import OpenCVCamera, OpenCVCameraConfig
from lerobot.utils.decorators import check_if_already_connected
from lerobot.utils.errors import DeviceNotConnectedError

from lerobot_camera_digit.elastomer import framed
from lerobot_camera_digit.parts import TURNS, HardwareFault, refuse_if, wait

logger = logging.getLogger(__name__)

RGB_FIRMWARE = 200  # 2.00 is the first whose LEDs are set one by one
START_S = 1.0  # a USB camera's first image may take longer than those after it
# What the sensor streams: width and height of its own, lying image in px, and frame rates in Hz.
STREAMS = {"QVGA": (320, 240, (30, 60)), "VGA": (640, 480, (15, 30))}
MAX_LED = 15
DEFAULT_SERIAL = "DXXXXX"  # of firmware that was written without a number: several sensors may have it
# What can be fixed: the control of its automatic, V4L2's values of it for off and on, the value's control.
CONTROLS = {
    "exposure": (cv2.CAP_PROP_AUTO_EXPOSURE, 1, 3, cv2.CAP_PROP_EXPOSURE),
    "white_balance": (cv2.CAP_PROP_AUTO_WB, 0, 1, cv2.CAP_PROP_WB_TEMPERATURE),
}
SYSFS = Path("/sys/class/video4linux")
DEV = Path("/dev")


@CameraConfig.register_subclass("digit")
@dataclass(kw_only=True)
class DigitConfig(CameraConfig):
    """A DIGIT, found by its serial number.

    Attributes:
        width: columns of the image, to which it is scaled; follows from the resolution if omitted.
        height: rows of the image; likewise.
    """

    serial: str  # number printed on the sensor, such as `D20001`; `DXXXXX` where none was ever written to it
    # USB port, such as `1-2`, of the sensor that is meant where several have one serial number
    port: str | None = None
    # `QVGA`, images of 320 rows and 240 columns as the simulated sensor's, or `VGA`, 640 x 480
    resolution: str = "QVGA"
    fps: int = 30  # 30, or 60 (QVGA alone) or 15 (VGA alone)
    # brightness of the red, green and blue LEDs, 0 (off) to 15
    led: tuple[int, int, int] = (MAX_LED, MAX_LED, MAX_LED)
    # exposure time in the driver's unit (V4L2: 100 us), which then stays; None: as it is
    exposure: int | None = None
    white_balance: int | None = None  # colour temperature in K, which then stays; None: as it is
    lock: bool = False  # whether exposure and white balance stay as they are after the warm-up
    # seconds without a new image after which reading says that the sensor hangs; a working one never sends
    # the same image twice, for its pixels are noisy
    frozen_s: float = 0.5
    rotation: int = 0  # clockwise, 0, 90, 180 or 270 degrees, of a sensor that is mounted otherwise
    # shares cut off at top, bottom, left and right of the turned image
    crop: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    mirror: bool = False  # whether left and right are exchanged

    def __post_init__(self):
        refuse_if(
            not self.serial.strip(),
            "serial of the DIGIT is empty; give the number that is printed on it, such as D20001."
            " `Digit.find_cameras()` lists those that are connected.",
        )
        refuse_if(
            self.resolution not in STREAMS,
            f"resolution of the DIGIT is '{self.resolution}'; it must be QVGA or VGA.",
        )
        columns, rows, rates = STREAMS[self.resolution]
        refuse_if(
            self.fps not in rates,
            f"fps of the DIGIT is {self.fps}; {self.resolution} has {rates[0]} and {rates[1]}.",
        )
        refuse_if(
            len(self.led) != 3 or not all(isinstance(v, int) and 0 <= v <= MAX_LED for v in self.led),
            f"led of the DIGIT is {list(self.led)}; give three whole numbers from 0 to {MAX_LED}.",
        )
        refuse_if(
            not self.frozen_s > 2 / self.fps,
            f"frozen_s of the DIGIT is {self.frozen_s}; it must exceed two frames, {2 / self.fps:.3f} s.",
        )
        # Its lying image is handed out upright, `columns` high.
        self.framing = framed("the DIGIT", self, columns, rows)


class DigitDevice(NamedTuple):
    """A connected DIGIT."""

    serial: str  # USB serial number, the one printed on the sensor
    path: Path  # the video device, such as /dev/video0
    firmware: int  # USB device release as a number: 200 is version 2.00
    port: str  # USB port, such as `1-2`, which stays the same as long as the cable does


def find_digits() -> list[DigitDevice]:
    """The connected DIGITs, ordered by serial number."""
    found = []
    for node in SYSFS.glob("video*"):
        usb = (node / "device").resolve().parent  # node/device is the interface; the descriptors lie above
        # A UVC camera has a second node, which carries metadata and no images.
        if _text(usb / "product") == "DIGIT" and _text(node / "index") == "0":
            firmware = int(_text(usb / "bcdDevice") or 0)
            found.append(DigitDevice(_text(usb / "serial"), DEV / node.name, firmware, usb.name))
    return sorted(found)


def _text(file: Path) -> str:
    return file.read_text().strip() if file.is_file() else ""


class Digit(OpenCVCamera):
    """Images are RGB uint8, 320 rows and 240 columns in QVGA, upright as the simulated sensor's, or as asked.

    Every reading method raises `HardwareFault` once the sensor is unplugged, or has sent no new image for
    `frozen_s`.

    Attributes:
        device: the sensor that was found, while connected.
        received: images since it was connected.
        dropped: images that the sensor sent, or was due to send, and that never came, by the times at which
            the driver took the others.
    """

    def __init__(self, config: DigitConfig):
        # The device path is known only when the serial number has been looked up.
        columns, rows, _ = STREAMS[config.resolution]
        super().__init__(
            OpenCVCameraConfig(
                index_or_path=Path(),
                fps=config.fps,
                width=rows,
                height=columns,
                rotation=Cv2Rotation.ROTATE_270,
                backend=Cv2Backends.V4L2,
            )
        )
        self.options = config
        self.device: DigitDevice | None = None
        self._fault: str | None = None
        self._raw: np.ndarray | None = None
        self._new_image_s = self._taken_s = 0.0
        self.received = self.dropped = 0

    def __str__(self) -> str:
        return f"DIGIT {self.options.serial}"

    @staticmethod
    def find_cameras() -> list[dict[str, Any]]:
        """Serial number, device path, firmware and USB port of every connected DIGIT."""
        return [
            {"type": "digit", "id": d.serial, "path": str(d.path), "firmware": d.firmware, "port": d.port}
            for d in find_digits()
        ]

    @check_if_already_connected
    def connect(self, warmup: bool = True) -> None:
        """Finds the sensor, sets stream and LEDs, starts reading; a warm-up of a second settles the exposure.

        Raises:
            HardwareFault: no DIGIT, or more than one, has this serial number and port, its firmware is too
                old, it cannot be opened or does not take its settings.
        """
        device = self._find()
        self.index_or_path = str(device.path)
        self._fault, self._raw, self._taken_s = None, None, 0.0
        self.received = self.dropped = 0
        try:
            super().connect(warmup)
        except (ConnectionError, RuntimeError, TimeoutError) as error:
            if isinstance(error, HardwareFault):
                raise
            raise HardwareFault(
                f"{self} at {device.path} cannot be used ({error}); close other programs that read it and"
                " check that your user is in the group 'video'."
            ) from error
        self.device = device
        if self.options.lock:
            try:
                self._hold()
            except HardwareFault:
                self.disconnect()
                raise

    def disconnect(self) -> None:
        """Lets go, and logs how many images were dropped, if any."""
        super().disconnect()
        if self.dropped:
            share = 100 * self.dropped / (self.dropped + self.received)
            logger.warning("%s: %d images were dropped, %.1f %%.", self, self.dropped, share)

    def read(self, color_mode=None) -> np.ndarray:
        """Waits for the next image; uint8 (H, W, 3)."""
        self._check()
        return super().read(color_mode)

    def async_read(self, timeout_ms: float = 200) -> np.ndarray:
        """The newest image not yet handed out, waiting for one at most `timeout_ms`; uint8 (H, W, 3)."""
        self._check()
        try:
            return super().async_read(min(timeout_ms, 1e3 * self._patience_s))
        except (TimeoutError, RuntimeError):
            self._check()
            if self.new_frame_event.is_set():  # it came while this computer was held up
                return super().async_read(0)
            raise

    def read_latest(self, max_age_ms: int = 500) -> np.ndarray:
        """The newest image at once; uint8 (H, W, 3)."""
        self._check()
        return super().read_latest(max_age_ms)

    def _find(self) -> DigitDevice:
        wanted, devices = self.options, find_digits()
        same = [d for d in devices if d.serial == wanted.serial and wanted.port in (None, d.port)]
        if not same:
            there = ", ".join(f"{d.serial} at port {d.port}" for d in devices) or "none"
            at = f" at port {wanted.port}" if wanted.port else ""
            raise HardwareFault(f"No DIGIT with serial '{wanted.serial}'{at} is connected; found: {there}.")
        if len(same) > 1:
            default = ", which the firmware has by default" if wanted.serial == DEFAULT_SERIAL else ""
            raise HardwareFault(
                f"{len(same)} DIGITs have the serial '{wanted.serial}'{default}; give also the port of the"
                f" one that is meant, one of {' and '.join(d.port for d in same)}."
            )
        device = same[0]
        if device.firmware < RGB_FIRMWARE:
            raise HardwareFault(
                f"{self} has firmware {device.firmware / 100:.2f}, which cannot set LEDs; update it to 2.00."
            )
        return device

    def _configure_capture_settings(self) -> None:
        super()._configure_capture_settings()
        red, green, blue = self.options.led
        value = red << 8 | green << 4 | blue
        if not self.videocapture.set(cv2.CAP_PROP_ZOOM, value):
            raise HardwareFault(f"{self} does not take LED brightness {self.options.led}; plug it in afresh.")
        actual = self.videocapture.get(cv2.CAP_PROP_ZOOM)
        if actual != value:
            logger.warning("%s was set to LED setting %d and reports %d.", self, value, actual)
        for option, (switch, _, automatic, _) in CONTROLS.items():
            value = getattr(self.options, option)
            if value is not None:
                self._fix(option, value)
            elif self.options.lock:
                self.videocapture.set(switch, automatic)  # so that it settles before it is held
        self._new_image_s = time.perf_counter()

    def _hold(self) -> None:
        """Exposure and white balance from now on as they are."""
        for option, (*_, control) in CONTROLS.items():
            if getattr(self.options, option) is None:
                self._fix(option, self.videocapture.get(control))

    def _fix(self, option: str, value: float) -> None:
        switch, fixed, _, control = CONTROLS[option]
        if not (self.videocapture.set(switch, fixed) and self.videocapture.set(control, value)):
            raise HardwareFault(
                f"{self} does not take a fixed {option} of {value:g}; leave option and lock out."
            )

    def _read_from_hardware(self) -> np.ndarray:
        """One raw image, BGR and lying; a broken one is skipped."""
        stop, capture = self.stop_event, self.videocapture
        while not stop.is_set():
            whole, image = capture.read()
            if whole:
                self._count(capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3)
                return image
            if not Path(self.index_or_path).exists():
                self._fault = f"{self} was unplugged; plug it in and connect again."
                break
            time.sleep(1 / self.fps)
        raise DeviceNotConnectedError(f"{self} no longer reads.")

    def _count(self, taken_s: float) -> None:
        """Counts the image that the driver took at this time, and those that are missing before it."""
        if self.received and taken_s > 0:  # a driver without times says 0
            self.dropped += max(round((taken_s - self._taken_s) * self.fps) - 1, 0)
        self.received, self._taken_s = self.received + 1, taken_s

    def _postprocess_image(self, image: np.ndarray) -> np.ndarray:
        result = super()._postprocess_image(image)
        # Without light there is no noise to distinguish images.
        if not any(self.options.led) or self._raw is None or not np.array_equal(image, self._raw):
            self._new_image_s = time.perf_counter()
        self._raw = image
        return self.options.framing.apply(result)

    @property
    def _patience_s(self) -> float:
        return START_S if self._raw is None else self.options.frozen_s

    def _check(self) -> None:
        if not self.is_connected:
            return  # said by LeRobot's own check
        if self._fault:
            raise HardwareFault(self._fault)
        if not wait(lambda: self._age_s <= self._patience_s, TURNS / self.fps, 1 / self.fps):
            raise HardwareFault(f"{self} has sent no new image for {self._age_s:.2f} s; plug it in afresh.")

    @property
    def _age_s(self) -> float:
        return time.perf_counter() - self._new_image_s
