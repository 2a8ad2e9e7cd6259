"""`pneutac measure`: drives a pressure program at the bench and writes what finger and gel did."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from lerobot.cameras import CameraConfig
from lerobot.cameras.opencv import OpenCVCameraConfig  # noqa: F401  registers the type

from lerobot_pneutac.measuring.programs import program_chambers
from lerobot_robot_pneutac import DigitConfig  # noqa: F401  registers the tactile cameras
from lerobot_robot_pneutac.hardware.parts import COMMAND_S
from lerobot_robot_pneutac.robots.config_pneutac import PressureConfig
from pneutac_datasets.recording.chambers import device_with, per_chamber
from pneutac_datasets.recording.mounts import CONDITIONS
from pneutac_sim.errors import InputError, check_choice

MIN_HZ = 2 / COMMAND_S
OWN, STANDIN = BENCHES = ("own", "standin")


@dataclass
class MeasureConfig:
    """Options of `pneutac measure`.

    Attributes:
        pressure: the controller, as `--robot.pressure` of the robot.
        camera: camera of any LeRobot type that looks at the finger's two markers.
        intrinsics: file of the camera's calibration; with `chessboard`, the file to write.
        digit: a tactile camera whose images are recorded too.
        bench: `own`, or `standin` to try a program on the simulated finger that stands in for a real one, or
            on such an arm of three chambers; the stand-in needs `program` and `out` alone.
        seed: of the stand-in's noise.
        program: `steps`, `ramps`, `holds`, `loops`, `all`, a CSV, or a diagnosis' `result.json`.
        recording: folder of the recording that was diagnosed, for a `result.json` as program.
        out: new folder of the recording.
        length_mm: length of the straight finger, base to tip marker.
        max_kpa: largest set-point, one for all chambers or one for each; the built-in programs reach it.
        min_kpa: smallest set-point of a program of your own, 0 or, for a finger that vacuum bends, below;
            likewise one for all chambers or one for each.
        hz: samples per second.
        repeat: number of times that the program is driven.
        rest_s: pause without pressure before each trial.
        marker_mm: side of both markers.
        base_id: number of the marker at the base.
        tip_id: number of the marker at the tip.
        base_offset_mm: vector from the finger's base to the base marker's centre, in the base frame.
        conditions: constant columns, such as {gravity_x: 1, gravity_y: 0, gravity_z: 0}, the
            direction of gravity in the base's frame, {payload_g: 50}, {temperature_c: 22}; those of a program
            take precedence.
        notes: text to store in the recording.
        chessboard: folder of photographs of a chessboard: calibrates the camera, and nothing else.
        corners: number of the chessboard's inner corners, columns and rows.
        square_mm: side of the chessboard's squares.
    """

    pressure: PressureConfig = field(default_factory=PressureConfig)
    camera: CameraConfig | None = None
    intrinsics: Path | None = None
    digit: CameraConfig | None = None
    bench: str = "own"
    seed: int = 0
    program: str = "all"
    recording: Path | None = None
    out: Path | None = None
    length_mm: float | None = None
    max_kpa: float | tuple[float, ...] = 15.0
    min_kpa: float | tuple[float, ...] = 0.0
    hz: float = 15.0
    repeat: int = 1
    rest_s: float = 3.0
    marker_mm: float = 12.0
    base_id: int = 0
    tip_id: int = 1
    base_offset_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    conditions: dict[str, float] = field(default_factory=dict)
    notes: str = ""
    chessboard: Path | None = None
    corners: tuple[int, int] = (9, 6)
    square_mm: float = 20.0

    def __post_init__(self):
        check_choice("bench", self.bench, BENCHES)
        needed = ["out"] if self.bench == STANDIN else ["intrinsics"]
        if self.chessboard is None and self.bench != STANDIN:
            needed += ["camera", "out", "length_mm"]
            if not self.pressure.type:
                raise InputError("--pressure.type is missing; give --pressure.type=pneutac_serial.")
            self.pressure.make()  # opens nothing
        for name in needed:
            if getattr(self, name) is None:
                option = "camera.type" if name == "camera" else name
                raise InputError(f"{option} is missing.")
        for kpa in np.atleast_1d(self.max_kpa):
            if not 0 < kpa < np.inf:
                raise InputError(f"max_kpa={kpa} must be positive.")
        for name in ("length_mm", "hz", "repeat", "marker_mm", "square_mm"):
            value = getattr(self, name)
            if value is not None and not 0 < value < np.inf:
                raise InputError(f"{name}={value} must be positive.")
        for name, value in self.conditions.items():
            check_choice("conditions", name, tuple(CONDITIONS))
            if not np.isfinite(value):
                raise InputError(f"conditions: {name} is {value}; give a number.")
        gravity = [self.conditions.get(f"gravity_{a}") for a in "xyz"]
        known = [g for g in gravity if g is not None]
        if known and (len(known) < 3 or abs(np.linalg.norm(known) - 1) > 0.01):
            raise InputError("conditions: give gravity_x, gravity_y and gravity_z together, of length 1.")
        for kpa in np.atleast_1d(self.min_kpa):
            if not -np.inf < kpa <= 0:
                raise InputError(f"min_kpa={kpa} must be 0, or below it for vacuum.")
        if self.hz < MIN_HZ:
            raise InputError(
                f"hz={self.hz} must be {MIN_HZ:g} or more; pressure is held {COMMAND_S} s a sample."
            )
        if not 0 <= self.rest_s < np.inf:
            raise InputError(f"rest_s={self.rest_s} must be 0 or more.")
        if self.out is not None and self.out.exists() and (not self.out.is_dir() or any(self.out.iterdir())):
            raise InputError(f"out={self.out} is not empty; give a new folder.")
        device_with(self.chambers)
        per_chamber("min_kpa", self.min_kpa, self.chambers)
        per_chamber("max_kpa", self.max_kpa, self.chambers)

    @property
    def chambers(self) -> int:
        """How many are driven: the bench's, and of the stand-in as many as the program has commands of."""
        if self.bench != STANDIN:
            return self.pressure.count
        limits = max(np.size(self.max_kpa), np.size(self.min_kpa), self.pressure.count)
        return program_chambers(self.program, self.recording) or limits

    @property
    def range_kpa(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest set-points, (chambers,) each."""
        low, high = (per_chamber(n, getattr(self, n), self.chambers) for n in ("min_kpa", "max_kpa"))
        return low, high
