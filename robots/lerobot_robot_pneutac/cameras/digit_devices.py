"""Which DIGITs are connected, from the USB descriptors that Linux shows under /sys."""

from pathlib import Path
from typing import NamedTuple

SYSFS = Path("/sys/class/video4linux")
DEV = Path("/dev")


class DigitDevice(NamedTuple):
    """A connected DIGIT.

    Attributes:
        serial: USB serial number, the one printed on the sensor.
        path: the video device, such as /dev/video0.
        firmware: USB device release as a number: 200 is version 2.00.
    """

    serial: str
    path: Path
    firmware: int


def find_digits() -> list[DigitDevice]:
    """The connected DIGITs, ordered by serial number."""
    found = []
    for node in SYSFS.glob("video*"):
        usb = (node / "device").resolve().parent  # node/device is the interface; the descriptors lie above
        # A UVC camera has a second node, which carries metadata and no images.
        if _text(usb / "product") == "DIGIT" and _text(node / "index") == "0":
            firmware = int(_text(usb / "bcdDevice") or 0)
            found.append(DigitDevice(_text(usb / "serial"), DEV / node.name, firmware))
    return sorted(found)


def _text(file: Path) -> str:
    return file.read_text().strip() if file.is_file() else ""
