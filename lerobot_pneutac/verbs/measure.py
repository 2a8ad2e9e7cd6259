"""`pneutac measure`: drives a pressure program at the bench and writes what finger and gel did."""

import shutil
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
from lerobot.cameras import Camera, CameraConfig, make_cameras_from_configs
from lerobot.cameras.opencv import OpenCVCameraConfig  # noqa: F401  registers the type
from PIL import Image
from rich.console import Console

from lerobot_pneutac.cli.options import parse_options
from lerobot_pneutac.measuring.camera import Intrinsics, MarkerTracker, calibrate
from lerobot_pneutac.measuring.programs import Trial, read_program
from lerobot_robot_pneutac import DigitConfig  # noqa: F401  registers the tactile cameras
from lerobot_robot_pneutac.hardware.parts import COMMAND_S, HardwareFault, PressureController
from lerobot_robot_pneutac.robots.config_pneutac import PressureConfig
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError

BASE_IMAGES = 15
FRAME_MS = 1000 * COMMAND_S  # a camera that is slower than this is lost; the chamber vents by itself then
OVERPRESSURE = 1.15  # of --max_kpa, measured: everything stops
MIN_HZ = 2 / COMMAND_S
MOST_UNSEEN = 0.2  # share of a trial's images without the tip marker above which it is told
MOST_MISSED = 0.1  # share of a trial's samples for which the cameras were too slow, likewise


@dataclass
class MeasureConfig:
    """Options of `pneutac measure`.

    Attributes:
        pressure: the controller, as `--robot.pressure` of the robot.
        camera: looks at the finger's two markers: any LeRobot camera.
        intrinsics: its calibration; with `chessboard`, the file to write.
        digit: a tactile camera whose images are kept too.
        program: `steps`, `ramps`, `holds`, `loops`, `all`, a CSV, or a diagnosis' `result.json`.
        recording: what was diagnosed, with a `result.json`.
        out: new folder of the recording.
        length_mm: of the straight finger, base to tip marker.
        max_kpa: no set-point is higher, and the built-in programs reach it.
        hz: samples per second.
        repeat: how often the program is driven.
        rest_s: pause without pressure before each trial.
        marker_mm: side of both markers.
        base_id: number of the marker at the base.
        tip_id: number of the marker at the tip.
        base_offset_mm: from the finger's base to the base marker's centre, in the base frame.
        notes: kept in the recording.
        chessboard: folder of photographs of a chessboard: calibrates the camera, and nothing else.
        corners: the board's inner corners, columns and rows.
        square_mm: side of its squares.
    """

    pressure: PressureConfig = field(default_factory=PressureConfig)
    camera: CameraConfig | None = None
    intrinsics: Path | None = None
    digit: CameraConfig | None = None
    program: str = "all"
    recording: Path | None = None
    out: Path | None = None
    length_mm: float | None = None
    max_kpa: float = 15.0
    hz: float = 15.0
    repeat: int = 1
    rest_s: float = 3.0
    marker_mm: float = 12.0
    base_id: int = 0
    tip_id: int = 1
    base_offset_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    notes: str = ""
    chessboard: Path | None = None
    corners: tuple[int, int] = (9, 6)
    square_mm: float = 20.0

    def __post_init__(self):
        needed = ["intrinsics"]
        if self.chessboard is None:
            needed += ["camera", "out", "length_mm"]
            if not self.pressure.type:
                raise InputError("--pressure.type is missing; give --pressure.type=pneutac_serial.")
        for name in needed:
            if getattr(self, name) is None:
                option = f"--{name}.type" if name == "camera" else f"--{name}"
                raise InputError(f"{option} is missing.")
        for name in ("length_mm", "max_kpa", "hz", "repeat", "marker_mm", "square_mm"):
            value = getattr(self, name)
            if value is not None and not 0 < value < np.inf:
                raise InputError(f"--{name}={value} must be positive.")
        if self.hz < MIN_HZ:
            raise InputError(
                f"--hz={self.hz} must be {MIN_HZ:g} or more; pressure is held {COMMAND_S} s a sample."
            )
        if not 0 <= self.rest_s < np.inf:
            raise InputError(f"--rest_s={self.rest_s} must be 0 or more.")
        if self.out is not None and self.out.exists() and (not self.out.is_dir() or any(self.out.iterdir())):
            raise InputError(f"--out={self.out} is not empty; give a new folder.")


def main(argv: list[str]) -> None:
    """Runs the verb."""
    cfg = parse_options(MeasureConfig, argv)
    console = Console()
    if cfg.chessboard is not None:
        camera, views = calibrate(cfg.chessboard, cfg.corners, cfg.square_mm)
        camera.save(cfg.intrinsics)
        console.print(f"{cfg.intrinsics}: {views} photographs, error {camera.rms_px:.2f} px", highlight=False)
        return
    try:
        measure(cfg, console)
    except HardwareFault as e:
        raise InputError(str(e)) from e


def measure(cfg: MeasureConfig, console: Console) -> Recording:
    """Drives the program; the recording holds every trial that was finished, however it ends.

    Raises:
        HardwareFault: a part failed; the chamber is vented.
        KeyboardInterrupt: as it came; the chamber is vented.
    """
    trials = read_program(cfg.program, cfg.max_kpa, cfg.hz, cfg.recording) * cfg.repeat
    camera = Intrinsics.load(cfg.intrinsics)
    tracker = MarkerTracker(camera, cfg.marker_mm, cfg.base_id, cfg.tip_id, cfg.base_offset_mm)
    given = {"camera": cfg.camera} | ({"tactile": cfg.digit} if cfg.digit is not None else {})
    cameras = make_cameras_from_configs(given)
    pressure = cfg.pressure.make()
    bench = _Bench(cfg, pressure, cameras, tracker)
    seconds = sum(t.time_s[-1] + cfg.rest_s for t in trials)
    console.print(f"{len(trials)} trials, {seconds / 60:.1f} min; Ctrl-C keeps those that are finished.")
    try:
        pressure.connect()
        for name, c in cameras.items():
            _connect(c, name)
        tracker.see_base([_image(cameras["camera"], "camera") for _ in range(BASE_IMAGES)])
        for number, trial in enumerate(trials):
            taken, seen = bench.run(number, trial)
            said = "kept" if seen else "left out"
            console.print(f"trial {number + 1} of {len(trials)}, {trial.program}: {said}", highlight=False)
            unseen, missed = 1 - seen / taken, 1 - taken / len(trial.time_s)
            if unseen > MOST_UNSEEN:
                console.print(f"[yellow]note:[/] the tip marker was unseen in {100 * unseen:.0f} % of it")
            if missed > MOST_MISSED:
                console.print(
                    f"[yellow]note:[/] {100 * missed:.0f} % of its samples are missing, the camera is slower"
                    " than --hz"
                )
    finally:
        pressure.disconnect()  # vents first, whatever comes after
        for c in cameras.values():
            if c.is_connected:
                c.disconnect()
        kept = bench.kept()
        for number in set(range(len(trials))) - kept:
            shutil.rmtree(bench.images(number), ignore_errors=True)
        shutil.rmtree(cfg.out / "new", ignore_errors=True)
        if kept:
            console.print(f"{cfg.out}: {len(kept)} of {len(trials)} trials", highlight=False)
        else:
            console.print("No trial was finished; nothing is kept.")
            shutil.rmtree(cfg.out, ignore_errors=True)
    return Recording.load(cfg.out)


class _Bench:
    """Drives trials one by one and writes the recording after each."""

    def __init__(
        self,
        cfg: MeasureConfig,
        pressure: PressureController,
        cameras: dict[str, Camera],
        tracker: MarkerTracker,
    ):
        self._cfg, self._pressure, self._cameras, self._tracker = cfg, pressure, cameras, tracker
        self._rows: list[dict] = []

    def kept(self) -> set[int]:
        """Numbers of the trials in the table: what is there counts, wherever an interrupt came."""
        table = self._cfg.out / "samples.csv"
        return set(pd.read_csv(table, usecols=["trial"])["trial"]) if table.exists() else set()

    def images(self, number: int) -> Path:
        """Folder of a trial's images."""
        return self._cfg.out / "images" / f"trial_{number:03d}"

    def run(self, number: int, trial: Trial) -> tuple[int, int]:
        """Drives one trial at its own pace; a camera that is slower than it costs samples.

        Returns:
            Samples taken, and those of them in which the tip was seen, which are kept.
        """
        folder = self.images(number)
        folder.mkdir(parents=True)
        self._pressure.vent()
        time.sleep(self._cfg.rest_s)
        rows, taken, k, start_s = [], 0, 0, time.monotonic()
        while k < len(trial.time_s):
            time.sleep(max(0.0, start_s + trial.time_s[k] - time.monotonic()))
            sample, command, taken = k, float(trial.pressure_kpa[k]), taken + 1
            self._pressure.set_pressure(command)
            images = {name: _image(c, name) for name, c in self._cameras.items()}
            now_s, kpa = time.monotonic() - start_s, float(self._pressure.pressure())
            if not kpa <= OVERPRESSURE * self._cfg.max_kpa:
                raise HardwareFault(f"The pressure reads {kpa:.1f} kPa; check valve and sensor.")
            tip = self._tracker.tip_mm(images["camera"])
            due = int(np.searchsorted(trial.time_s, time.monotonic() - start_s, side="right"))
            k = max(k + 1, min(due - 1, len(trial.time_s) - 1))
            if tip is None:
                continue
            row = {"trial": number, "time_s": now_s, "program": trial.program}
            row |= {"pressure_cmd_kpa": command, "pressure_kpa": kpa}
            row |= dict(zip(("tip_x_mm", "tip_y_mm", "tip_z_mm"), tip.tolist(), strict=True))
            for name, image in images.items():
                file = folder / f"{name}_{sample:05d}.jpg"
                Image.fromarray(image).save(file, quality=95)
                row[f"image_{name}"] = str(file.relative_to(self._cfg.out))
            rows.append(row)
        self._pressure.vent()
        if rows:
            self._rows += rows
            self._write()
        return taken, len(rows)

    def _write(self) -> None:
        """The recording so far; the old one stays until the new one is whole."""
        camera = self._tracker.camera
        meta = {
            "length_mm": self._cfg.length_mm,
            "notes": self._cfg.notes,
            "cameras": {
                "camera": {
                    "intrinsics": camera.matrix.tolist(),
                    "extrinsics": self._tracker.extrinsics().tolist(),
                    "distortion": camera.distortion.tolist(),
                }
            },
        }
        samples = pd.DataFrame(self._rows)
        new = Recording(self._cfg.out, meta, samples, "finger").write(self._cfg.out / "new")
        for name in ("recording.json", "samples.csv"):  # the table last: a trial in it is kept
            (new / name).replace(self._cfg.out / name)
        new.rmdir()


def _connect(camera: Camera, name: str) -> None:
    """Opens the camera; raises HardwareFault where it cannot be opened."""
    try:
        camera.connect()
    except Exception as e:
        raise HardwareFault(f"The camera '{name}' cannot be opened: {str(e).rstrip('.')}.") from e


def _image(camera: Camera, name: str) -> np.ndarray:
    """The camera's next image; raises HardwareFault where none comes in time."""
    try:
        return camera.async_read(timeout_ms=FRAME_MS)
    except Exception as e:
        raise HardwareFault(f"The camera '{name}' gives no picture: {str(e).rstrip('.')}.") from e
