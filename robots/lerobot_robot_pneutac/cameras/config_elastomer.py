"""Options of the camera `elastomer`: any camera under a gel."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lerobot.cameras import CameraConfig

from lerobot_robot_pneutac.cameras.framing import framed
from lerobot_robot_pneutac.options import refuse_if

PLAIN = {"rotation": 0, "crop": (0.0, 0.0, 0.0, 0.0), "mirror": False, "fourcc": None, "fps": 30}
# What is known of each make; an option that is given goes before it.
SENSORS: dict[str, dict[str, Any]] = {
    # Border and size as in the maker's own gsrobotics; stream, rate and format are not checked on a sensor.
    "gelsight_mini": {
        "stream": (3280, 2464),
        "fps": 25,
        "fourcc": "MJPG",
        "crop": (0.15, 0.15, 0.15, 0.15),
        "width": 320,
        "height": 240,
    },
    # As the camera `digit` hands it out, which is for Linux and also sets the LEDs.
    "digit": {"stream": (320, 240), "fps": 30, "rotation": 270},
}


@CameraConfig.register_subclass("elastomer")
@dataclass(kw_only=True)
class ElastomerConfig(CameraConfig):
    """A camera under a gel, read by OpenCV.

    Attributes:
        index_or_path: which camera, as for LeRobot's `opencv`.
        sensor: `gelsight_mini` or `digit`, for what is known of it; without it every option is yours.
        stream: width and height in which the camera sends, px.
        fps: frames per second.
        fourcc: format in which the camera sends, such as MJPG.
        rotation: clockwise, 0, 90, 180 or 270 degrees.
        crop: shares cut off at top, bottom, left and right of the turned picture, such as [0, 0, 0.1, 0.1].
        mirror: whether left and right are exchanged.
        width: columns of the image; where it is left out, as it comes.
        height: rows of the image.
    """

    index_or_path: int | Path
    sensor: str | None = None
    stream: tuple[int, int] | None = None
    fourcc: str | None = None
    rotation: int | None = None
    crop: tuple[float, float, float, float] | None = None
    mirror: bool | None = None

    def __post_init__(self):
        known = ", ".join(SENSORS)
        refuse_if(
            self.sensor is not None and self.sensor not in SENSORS,
            f"sensor is '{self.sensor}'; it must be one of {known}, or left out.",
        )
        preset = SENSORS[self.sensor] if self.sensor else {}
        if self.width is not None or self.height is not None:
            preset = {k: v for k, v in preset.items() if k not in ("width", "height")}
        for name, value in (PLAIN | preset).items():
            if getattr(self, name) is None:
                setattr(self, name, value)
        refuse_if(
            self.stream is None,
            f"stream of the elastomer's camera is missing; give its width and height such as [640, 480], or a"
            f" sensor of {known}.",
        )
        self.framing = framed("the elastomer's camera", self, self.stream[1], self.stream[0])
