"""Measuring at the bench: drives a pressure program and writes what finger and gel did."""

import shlex
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pandas as pd
from lerobot.cameras import Camera, CameraConfig, make_cameras_from_configs
from lerobot.cameras.opencv import OpenCVCameraConfig  # noqa: F401  registers the type

from lerobot_pneutac.cli.terminal import Terminal
from lerobot_pneutac.diagnosis.law_programs import EVENLY, law_programs
from lerobot_pneutac.diagnosis.programs import Limits, instructions, menu, sampled, sent_s, turning
from lerobot_pneutac.measuring import MARKERS, Intrinsics, MarkerTracker, calibrate_camera
from lerobot_robot_pneutac import DigitConfig  # noqa: F401  registers the tactile cameras
from lerobot_robot_pneutac.hardware.parts import COMMAND_S, Chambers, HardwareFault
from lerobot_robot_pneutac.robots.config_pneutac import PressureConfig
from pneutac_datasets.recording import axes
from pneutac_datasets.recording.axes import per_chamber
from pneutac_datasets.recording.mounts import CONDITIONS
from pneutac_datasets.recording.recording import Recording
from pneutac_datasets.recording.units import MAX_PRESSURE_KPA
from pneutac_datasets.recording.wording import plural
from pneutac_sim.errors import InputError, check_between, check_choice, check_length, refuse_given
from pneutac_sim.files import check_new, check_new_file, check_writable, read_json, write_image
from pneutac_sim.finger.online import check_conditions

TIP = ("tip_x_mm", "tip_y_mm", "tip_z_mm")
BUILTIN = ("steps", "ramps", "holds", "loops", "all")


@dataclass(frozen=True)
class PressureTrial:
    """One contiguous piece of a program."""

    program: str  # its label
    time_s: np.ndarray  # (n,) of the samples, rising from 0
    pressure_kpa: np.ndarray  # (n, chambers) set-points
    sent_s: np.ndarray  # (n,) when each is sent: at its sample, or a part of a sample before
    conditions: Mapping[str, float] = field(default_factory=dict)  # asked for, such as `payload_g`


def program_chambers(given: str, recording: Path | None = None) -> int:
    """Chambers of a program, or of the recording whose diagnosis it is; 0 where neither has any."""
    if given in BUILTIN or not Path(given).is_file():
        return 0
    if Path(given).suffix == ".json":
        return len(Recording.load(recording).pressure_columns) if recording is not None else 0
    return axes.chambers_commanded(_read(Path(given)))


def read_program(
    given: str,
    max_kpa: float | Sequence[float] | np.ndarray,
    hz: float,
    recording: Path | None = None,
    min_kpa: float | Sequence[float] | np.ndarray = 0.0,
    chambers: int = 1,
) -> list[PressureTrial]:
    """The trials of a program: a name of `BUILTIN`, a CSV, or the `result.json` of a recording's diagnosis.

    A CSV has `time_s` and `pressure_cmd_kpa`, or of several chambers `pressure_cmd_1_kpa` and so on, and may
    have `trial`, `program` and conditions. The built-in programs reach `max_kpa`. Raises InputError where it
    cannot be read, lacks a chamber's commands, or a pressure lies outside `min_kpa` to `max_kpa`.
    """
    if given in BUILTIN:
        names = [name for name in BUILTIN[:-1] if given in (name, "all")]
        trials = [t for name in names for t in _builtin(name, per_chamber("max_kpa", max_kpa, chambers), hz)]
    elif not Path(given).is_file():
        raise InputError(f"program={given} is neither a file nor one of {', '.join(BUILTIN)}.")
    elif Path(given).suffix == ".json":
        trials = [_proposed(Path(given), recording, hz, chambers)]
    else:
        trials = _table(Path(given), hz, chambers)
    ends = (per_chamber(n, v, chambers) for n, v in (("min_kpa", min_kpa), ("max_kpa", max_kpa)))
    allowed = list(zip(*ends, strict=True))
    for t, i in ((t, i) for t in trials for i in range(chambers)):
        low, high = t.pressure_kpa[:, i].min(), t.pressure_kpa[:, i].max()
        if low < allowed[i][0] or high > allowed[i][1]:
            where = f" in chamber {i + 1}" if chambers > 1 else ""
            goes = f"The program '{t.program}' goes from {low:g} to {high:g} kPa{where}"
            raise InputError(f"{goes}; --min_kpa and --max_kpa allow {'{:g} to {:g}'.format(*allowed[i])}.")
    return trials


def _builtin(name: str, top: np.ndarray, hz: float) -> list[PressureTrial]:
    """Short trials, so that an interruption costs little; each starts and ends at 0, on each chamber alone.

    Of several chambers loops also turn the bend about the axis.
    """
    stairs = np.r_[np.linspace(0, 1, 6), np.linspace(1, 0, 6)[1:]]
    shapes = {
        # name: (duration in s of a unit, breakpoints as (unit of time, share of the top))
        "steps": [[(k + j, s) for k, s in enumerate(stairs) for j in (0.0, 0.999)]],
        "ramps": [[(0, 0), (T / 2, 1), (T, 0)] for T in (4.0, 8.0, 16.0)],
        "holds": [[(0, 0), (0.5, 0), (0.501, s), (12, s), (12.001, 0), (16, 0)] for s in (0.5, 1.0)],
        "loops": [
            [(0, 0), (2, 0.8), (4, 0.4), (6, 1.0), (8, 0.2), (10, 0.6), (12, 0)],
            [(0, 0), (3, 1.0), (6, 0.5), (9, 1.0), (12, 0)],
        ],
    }[name]
    unit_s = 3.0 if name == "steps" else 1.0
    trials = []
    for points in shapes:
        knots_s, share = (np.array(points) * [unit_s, 1.0]).T
        time_s = np.arange(round(knots_s[-1] * hz) + 1) / hz
        along = np.interp(time_s, knots_s, share)[:, None]
        trials += [_trial(name, time_s, along * alone * top) for alone in np.eye(len(top))]
    if name == "loops" and len(top) > 1:
        for turn_s in (4.0, 12.0):
            turn = turning(len(top), turn_s, 1.0, 2.0)
            trials.append(_trial(name, *sampled(turn, Limits(0.0, top, hz))))
    return trials


def _trial(name: str, time_s: np.ndarray, pressure_kpa: np.ndarray) -> PressureTrial:
    return PressureTrial(name, time_s, pressure_kpa, sent_s(time_s, pressure_kpa))


def _read(path: Path) -> pd.DataFrame:
    try:
        return pd.read_csv(path)
    except (ValueError, OSError) as e:
        raise InputError(f"{path} cannot be read as a table: {' '.join(str(e).split()).rstrip(' .')}.") from e


def _table(path: Path, hz: float, chambers: int) -> list[PressureTrial]:
    table, commands = _read(path), axes.command_columns(chambers)
    found = [c for c in table if str(c).startswith("pressure_cmd_")]
    if found and not set(commands) <= set(found):
        given = f"{path} commands {plural(len(found), 'chamber')} ({', '.join(found)})"
        raise InputError(f"{given} of the {chambers} that are driven; give {', '.join(commands)}.")
    if extra := [c for c in found if c not in commands]:
        driven = f"{plural(chambers, 'chamber')} is driven"
        raise InputError(f"{path} commands {', '.join(extra)} too, and {driven}; leave out the others.")
    for column in ("time_s", *commands, *(c for c in CONDITIONS if c in table)):
        if column not in table:
            raise InputError(f"{path}: column '{column}' is missing; it has {', '.join(table)}.")
        values = pd.to_numeric(table[column], errors="coerce")
        if not np.isfinite(values).all():
            row = int(np.flatnonzero(~np.isfinite(values))[0]) + 1
            raise InputError(f"{path}: column '{column}' has no finite number in row {row}.")
    trials = []
    for number, rows in table.groupby(table.get("trial", pd.Series(0, table.index)), sort=False):
        time_s = rows["time_s"].to_numpy(float) - rows["time_s"].iloc[0]
        if len(rows) < 2 or (np.diff(time_s) <= 0).any():
            raise InputError(f"{path}: the time of trial {number} must rise over two rows at least.")
        grid = np.arange(round(time_s[-1] * hz) + 1) / hz
        # A command holds until the next row's: steps stay steps.
        latest = np.searchsorted(time_s, grid + 1e-9, side="right") - 1
        label = str(rows["program"].iloc[0]) if "program" in rows else path.stem
        sent = np.where(np.diff(latest, prepend=-1) > 0, time_s[latest], grid)
        conditions = {c: float(rows[c].iloc[0]) for c in CONDITIONS if c in rows}
        trials.append(PressureTrial(label, grid, rows[commands].to_numpy(float)[latest], sent, conditions))
    return trials


def _proposed(path: Path, recording: Path | None, hz: float, chambers: int) -> PressureTrial:
    """The program on the diagnosis' menu that its advice names."""
    diagnosed = read_json(path)
    advice = diagnosed.get("next_experiment")
    if not isinstance(advice, str):
        raise InputError(f"{path} is no result of pneutac diagnose: 'next_experiment' is missing.")
    if recording is None:
        raise InputError("program=result.json needs recording, the folder that was diagnosed.")
    r = Recording.load(recording)
    if len(r.pressure_columns) != chambers:
        both = f"{recording} has {plural(len(r.pressure_columns), 'chamber')}, and {chambers} would be driven"
        raise InputError(f"{both}; give the bench of the device that was diagnosed.")
    advice = advice.replace("alike about both", EVENLY)  # as it was worded before 0.2
    found = {e: {k: v["value"] for k, v in c.items()} for e, c in diagnosed.get("parameters", {}).items()}
    for p in [*menu(r), *law_programs(r, found)]:
        if p.advice in advice:
            time_s = p.samples["time_s"].to_numpy(float)
            grid = np.arange(round(time_s[-1] * hz) + 1) / hz
            commands = p.samples[r.pressure_columns].to_numpy(float).T
            return _trial(p.name, grid, np.stack([np.interp(grid, time_s, x) for x in commands], axis=1))
    raise InputError(f"{path} proposes a step that is no pressure program; do it by hand: {advice}")


MIN_HZ = 2 / COMMAND_S
OWN, STANDIN = BENCHES = ("own", "standin")
OF_OWN = "camera digit intrinsics length_mm rest_s marker_mm base_id tip_id base_offset_mm notes".split()
MOST_HZ, MOST_REPEATS, MOST_REST_S = 1000, 1000, 86_400


@dataclass
class MeasureConfig:
    """Options of `pneutac measure`."""

    pressure: PressureConfig = field(default_factory=PressureConfig)  # as the robot's `--robot.pressure`
    camera: CameraConfig | None = None  # camera of any LeRobot type that looks at the finger's two markers
    intrinsics: Path | None = None  # file of the camera's calibration; with `chessboard`, the file to write
    digit: CameraConfig | None = None  # a tactile camera whose images are recorded too
    # `own`, or `standin` to try a program on the simulated finger that stands in for a real one, or on such
    # an arm of three chambers; the stand-in needs `program` and `out` alone
    bench: str = "own"
    seed: int = 0  # of the stand-in's noise
    program: str = "all"  # `steps`, `ramps`, `holds`, `loops`, `all`, a CSV, or a diagnosis' `result.json`
    recording: Path | None = None  # folder of the recording that was diagnosed, for a `result.json` program
    out: Path | None = None  # new folder of the recording
    length_mm: float | None = None  # length of the straight finger, base to tip marker
    # largest set-point, one for all chambers or one for each; the built-in programs reach it
    max_kpa: float | tuple[float, ...] = 15.0
    # smallest set-point of a program of your own, 0 or, for a finger that vacuum bends, below; likewise one
    # for all chambers or one for each
    min_kpa: float | tuple[float, ...] = 0.0
    hz: float = 15.0  # samples per second
    repeat: int = 1  # number of times that the program is driven
    rest_s: float = 3.0  # pause without pressure before each trial
    marker_mm: float = 12.0  # side of both markers
    base_id: int = 0  # number of the marker at the base
    tip_id: int = 1  # number of the marker at the tip
    base_offset_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)  # finger's base to base marker, base frame
    # constant columns, such as {gravity_x: 1, gravity_y: 0, gravity_z: 0}, the direction of gravity in the
    # base's frame, {payload_g: 50}, {temperature_c: 22}; those of a program take precedence
    conditions: dict[str, float] = field(default_factory=dict)
    notes: str = ""  # text to store in the recording
    chessboard: Path | None = None  # photographs of a chessboard: calibrates the camera, and nothing else
    corners: tuple[int, int] = (9, 6)  # number of the chessboard's inner corners, columns and rows
    square_mm: float = 20.0  # side of the chessboard's squares

    def __post_init__(self):
        check_choice("bench", self.bench, BENCHES)
        if self.chessboard is not None:
            refuse_given(self, ("bench", "out", "program"), "is not of a --chessboard")
            if not self.chessboard.is_dir():
                raise InputError(f"There is no folder '{self.chessboard}'; give that of the photographs.")
        of_other = ("seed",) if self.bench == OWN else OF_OWN
        refuse_given(self, of_other, f"is of --bench={STANDIN if self.bench == OWN else OWN}")
        if self.bench == STANDIN and replace(self.pressure, chambers=1) != PressureConfig():
            raise InputError(f"pressure has options of --bench={OWN}; leave them out.")
        if self.chessboard is None:
            refuse_given(self, ("corners", "square_mm"), "is of a --chessboard, which is not given")
        if not self.program.endswith(".json"):
            refuse_given(self, ("recording",), "is of a `result.json` program, which is not given")
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
        if self.length_mm is not None:
            check_length(self.length_mm)
        for name in self.conditions:
            check_choice("conditions", name, tuple(CONDITIONS))
        check_conditions(self.conditions)
        for kpa in np.atleast_1d(self.max_kpa):
            check_between(0.1, MAX_PRESSURE_KPA, "kPa", max_kpa=kpa)
        for kpa in np.atleast_1d(self.min_kpa):
            check_between(-100, 0, "kPa, below 0 for vacuum", min_kpa=kpa)
        check_between(MIN_HZ, MOST_HZ, f"samples a second; pressure is held {COMMAND_S} s", hz=self.hz)
        check_between(1, MOST_REPEATS, repeat=self.repeat)
        check_between(0, MOST_REST_S, "s", rest_s=self.rest_s)
        check_between(1, 1000, "mm", marker_mm=self.marker_mm, square_mm=self.square_mm)
        check_between(0, MARKERS - 1, base_id=self.base_id, tip_id=self.tip_id)
        if self.base_id == self.tip_id:
            raise InputError(f"base_id and tip_id are both {self.tip_id}; give each marker its own.")
        if min(self.corners) < 2:
            raise InputError(f"corners is {self.corners}; a chessboard has 2 or more along each side.")
        if self.chessboard is not None:
            folder = self.intrinsics.parent
            check_writable(folder, f"{folder}, the folder of --intrinsics={self.intrinsics},")
            if self.intrinsics.is_dir():
                raise InputError(f"intrinsics={self.intrinsics} is a folder; give a file, such as lens.json.")
            check_new_file(self.intrinsics, f"intrinsics={self.intrinsics}")
        if self.out is not None:
            check_new(self.out, f"out={self.out}")
        axes.device_with(self.chambers)
        _ = self.range_kpa  # which are as many as the chambers

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

    @property
    def trials(self) -> list[PressureTrial]:
        """Those of the program, once; raises InputError where they cannot be read."""
        return read_program(self.program, self.max_kpa, self.hz, self.recording, self.min_kpa, self.chambers)


BASE_IMAGES = 15
FRAME_MS = 1000 * COMMAND_S  # a camera that is slower than this is lost; the chamber vents by itself then
OVERPRESSURE = 1.15  # of the set maximum, measured: everything stops
RESTED_S = 60.0  # without pressure before the first trial: what came before the run is then forgotten


def measure(
    config: MeasureConfig,
    on_start: Callable[[int, float], None] = lambda trials, seconds: None,
    on_trial: Callable[[int, PressureTrial, int, int], None] = lambda number, trial, taken, seen: None,
) -> Recording:
    """Drives the program; the recording holds every trial that was finished, however it ends.

    `on_start` is called with the number of trials and their seconds before anything moves; `on_trial` with
    each one's number from 0, the samples for which the cameras were quick enough, and those of them in which
    the tip was seen, which are stored.

    Raises:
        InputError: program or calibration cannot be read.
        HardwareFault: a part failed; the chamber is vented, as after KeyboardInterrupt.
    """
    trials = config.trials * config.repeat
    if config.bench == STANDIN:
        on_start(len(trials), sum(t.time_s[-1] for t in trials))
        from pneutac_datasets.generate.finger import standin_arm
        from pneutac_datasets.generate.standin import write_trials

        if config.chambers > 1:
            given = [(t.program, t.sent_s, t.pressure_kpa) for t in trials]
            return standin_arm(config.seed).measure(given, config.out)
        given = [(t.program, t.pressure_kpa[:, 0]) for t in trials]
        conditions = config.conditions | dict(trials[0].conditions)
        return write_trials(config.out, given, config.hz, config.seed, conditions)
    camera = Intrinsics.load(config.intrinsics)
    tracker = MarkerTracker(camera, config.marker_mm, config.base_id, config.tip_id, config.base_offset_mm)
    given = {"camera": config.camera} | ({"tactile": config.digit} if config.digit is not None else {})
    cameras = make_cameras_from_configs(given)
    pressure = config.pressure.make()
    driver = BenchDriver(config, pressure, cameras, tracker)
    on_start(len(trials), sum(t.time_s[-1] + config.rest_s for t in trials))
    try:
        pressure.connect()
        for name, c in cameras.items():
            _camera_call(name, "cannot be opened", c.connect)
        tracker.see_base([_image(cameras["camera"], "camera") for _ in range(BASE_IMAGES)])
        for number, trial in enumerate(trials):
            on_trial(number, trial, *driver.drive(number, trial))
    finally:
        pressure.disconnect()  # vents first, whatever comes after
        for c in cameras.values():
            if c.is_connected:
                c.disconnect()
        stored = stored_trials(config.out)
        for number in set(range(len(trials))) - stored:
            shutil.rmtree(driver.images(number), ignore_errors=True)
        shutil.rmtree(config.out / "new", ignore_errors=True)
        if not stored:
            shutil.rmtree(config.out, ignore_errors=True)
    return Recording.load(config.out)


def stored_trials(folder: Path) -> set[int]:
    """Numbers of the trials in a folder's table: what is there counts, wherever an interrupt came."""
    table = folder / "samples.csv"
    return set(pd.read_csv(table, usecols=["trial"])["trial"]) if table.exists() else set()


class BenchDriver:
    """Drives trials one by one and writes the recording after each."""

    def __init__(
        self, config: MeasureConfig, pressure: Chambers, cameras: dict[str, Camera], tracker: MarkerTracker
    ):
        self._config, self._pressure, self._cameras, self._tracker = config, pressure, cameras, tracker
        self._rows: list[dict] = []
        self._starts: dict[str, dict] = {}
        self._vented_s: float | None = None  # clock at the end of the trial before, if it was stored

    def images(self, number: int) -> Path:
        return self._config.out / "images" / f"trial_{number:03d}"

    def drive(self, number: int, trial: PressureTrial) -> tuple[int, int]:
        """Drives one trial at its own pace; returns samples taken, and those in which the tip was seen."""
        folder = self.images(number)
        folder.mkdir(parents=True)
        self._pressure.vent()
        time.sleep(self._config.rest_s)
        rows, taken, k, start_s = [], 0, 0, time.monotonic()
        command, sent_s = None, None
        started = {"start": "rested" if self._config.rest_s >= RESTED_S else "unknown"}
        if self._vented_s is not None:  # each trial leaves the chamber vented
            started = {"start": "continues", "pause_s": round(start_s - self._vented_s, 3)}
        while k < len(trial.time_s):
            _wait_until(start_s + trial.sent_s[k])
            sample, before, command, taken = k, command, trial.pressure_kpa[k], taken + 1
            if sent_s is None or (command != before).any():  # one sent again counts from the first time
                sent_s = time.monotonic() - start_s
            self._pressure.set_pressure(command)
            _wait_until(start_s + trial.time_s[k])
            images = {name: _image(c, name) for name, c in self._cameras.items()}
            now_s, kpa = time.monotonic() - start_s, self._pressure.pressure()
            self._check_pressure(kpa)
            tip = self._tracker.tip_mm(images["camera"])
            due = int(np.searchsorted(trial.time_s, time.monotonic() - start_s, side="right"))
            k = max(k + 1, min(due - 1, len(trial.time_s) - 1))
            if tip is None:
                continue
            row = {"trial": number, "time_s": now_s, "time_sent_s": sent_s, "program": trial.program}
            names = *axes.command_columns(len(kpa)), *axes.measured_columns(len(kpa)), *TIP
            row |= dict(zip(names, np.concatenate([command, kpa, tip]).tolist(), strict=True))
            row |= self._config.conditions | trial.conditions
            for name, image in images.items():
                file = folder / f"{name}_{sample:05d}.jpg"
                write_image(file, image, quality=95)
                row[f"image_{name}"] = str(file.relative_to(self._config.out))
            rows.append(row)
            sent_s = None
        self._pressure.vent()
        self._vented_s = time.monotonic() if rows else None
        if rows:
            self._rows += rows
            self._starts[str(number)] = started
            self._write()
        return taken, len(rows)

    def _check_pressure(self, kpa: np.ndarray) -> None:
        """Raises HardwareFault where a chamber is farther from zero than the program's limits explain."""
        low, high = self._config.range_kpa
        most = OVERPRESSURE * np.maximum(high, -low)
        wrong = ~(kpa <= most) | ((low < 0) & (kpa < -most))
        for i in np.flatnonzero(wrong):
            where = f" in chamber {i + 1}" if len(kpa) > 1 else ""
            raise HardwareFault(f"The pressure{where} reads {kpa[i]:.1f} kPa; check valve and sensor.")

    def _write(self) -> None:
        """The recording so far; the old one stays until the new one is whole."""
        camera = self._tracker.camera
        meta = {"length_mm": self._config.length_mm, "notes": self._config.notes, "trials": self._starts}
        numbers = {"intrinsics": camera.matrix, "extrinsics": self._tracker.extrinsics()}
        numbers |= {"distortion": camera.distortion}
        meta["cameras"] = {"camera": {name: array.tolist() for name, array in numbers.items()}}
        known = meta, pd.DataFrame(self._rows), axes.device_with(self._config.chambers)
        new = Recording(self._config.out, *known).write(self._config.out / "new")
        # a trial in the table is final, and recording.json names none that is not in it
        names = ["recording.json", "samples.csv"]
        for name in names[::-1] if (self._config.out / "samples.csv").exists() else names:
            (new / name).replace(self._config.out / name)
        new.rmdir()


def _wait_until(clock_s: float) -> None:
    time.sleep(max(0.0, clock_s - time.monotonic()))


def _camera_call(name: str, fault: str, call: Callable):
    """What a call to a camera returns; raises HardwareFault where it fails, in whichever way it does."""
    try:
        return call()
    except Exception as e:
        raise HardwareFault(f"The camera '{name}' {fault}: {str(e).rstrip('.')}.") from e


def _image(camera: Camera, name: str) -> np.ndarray:
    """The camera's next image; raises HardwareFault where none comes in time."""
    return _camera_call(name, "gives no picture", lambda: camera.async_read(timeout_ms=FRAME_MS))


MOST_UNSEEN = 0.2  # share of a trial's images without the tip marker above which it is reported
MOST_MISSED = 0.1  # share of a trial's samples for which the cameras were too slow, likewise


def command(config: MeasureConfig, terminal: Terminal) -> None:
    if config.chessboard is not None:
        camera, views = calibrate_camera(config.chessboard, config.corners, config.square_mm)
        camera.save(config.intrinsics)
        terminal.say(f"{config.intrinsics}: {views} photographs, error {camera.rms_px:.2f} px")
        return
    trials = 0

    def start(number: int, seconds: float) -> None:
        nonlocal trials
        trials = number
        what = plural(trials, "trial")
        terminal.say(f"{what}, {seconds / 60:.1f} min; finished ones stay stored after Ctrl-C.")

    def show(number: int, trial: PressureTrial, taken: int, seen: int) -> None:
        what = "stored" if seen else "left out"
        terminal.say(f"trial {number + 1} of {trials}, {trial.program}: {what}")
        unseen, missed = 1 - seen / taken, 1 - taken / len(trial.time_s)
        if unseen > MOST_UNSEEN:
            terminal.note(f"the tip marker was unseen in {100 * unseen:.0f} % of it")
        if missed > MOST_MISSED:
            terminal.note(f"{100 * missed:.0f} % of its samples are missing, the camera is slower than --hz")

    for sentence in dict.fromkeys(s for t in config.trials for s in instructions({}, t.conditions)):
        terminal.console.print(f"[yellow]first:[/] {sentence}", highlight=False)
        if terminal.console.is_terminal:
            terminal.console.input("Then press Enter: ")
    try:
        measure(config, start, show)
    except HardwareFault as e:
        raise InputError(str(e)) from e
    finally:
        stored = len(stored_trials(config.out))
        if stored:
            terminal.say(f"{config.out}: {stored} of {trials} trials")
        elif trials:
            terminal.say("No trial was finished; nothing was written.")
    following = ["pneutac", "calibrate", "--twin=TWIN", f"--recording={config.out}"]
    terminal.next_step(shlex.join(following))
