"""Pressure programs for the bench: built-in ones, a table, or the experiment that a diagnosis proposes.

`pneutac measure`: drives a pressure program at the bench and writes what finger and gel did.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
from lerobot.cameras import CameraConfig
from lerobot.cameras.opencv import OpenCVCameraConfig  # noqa: F401  registers the type

from lerobot_pneutac.diagnosis.law_programs import law_programs
from lerobot_pneutac.diagnosis.programs import Limits, menu, sampled, sent_s, turning
from lerobot_robot_pneutac import DigitConfig  # noqa: F401  registers the tactile cameras
from lerobot_robot_pneutac.hardware.parts import COMMAND_S
from lerobot_robot_pneutac.robots.config_pneutac import PressureConfig
from pneutac_datasets.recording.axes import chambers_commanded, command_columns, device_with, per_chamber
from pneutac_datasets.recording.mounts import CONDITIONS
from pneutac_datasets.recording.recording import Recording
from pneutac_datasets.recording.wording import plural
from pneutac_sim.errors import InputError, check_choice
from pneutac_sim.files import check_new, read_json

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
    return chambers_commanded(_read(Path(given)))


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
    for t in trials:
        _check_range(t, per_chamber("min_kpa", min_kpa, chambers), per_chamber("max_kpa", max_kpa, chambers))
    return trials


def _check_range(t: PressureTrial, min_kpa: np.ndarray, max_kpa: np.ndarray) -> None:
    lowest, highest = t.pressure_kpa.min(axis=0), t.pressure_kpa.max(axis=0)
    for i, (low, high) in enumerate(zip(lowest, highest, strict=True)):
        if low < min_kpa[i] or high > max_kpa[i]:
            where = f" in chamber {i + 1}" if len(lowest) > 1 else ""
            raise InputError(
                f"The program '{t.program}' goes from {low:g} to {high:g} kPa{where}; --min_kpa and --max_kpa"
                f" allow {min_kpa[i]:g} to {max_kpa[i]:g}."
            )


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
        raise InputError(f"{path} cannot be read as a table: {e}.") from e


def _table(path: Path, hz: float, chambers: int) -> list[PressureTrial]:
    table, commands = _read(path), command_columns(chambers)
    found = [c for c in table if str(c).startswith("pressure_cmd_")]
    if found and not set(commands) <= set(found):
        raise InputError(
            f"{path} commands {plural(len(found), 'chamber')} ({', '.join(found)}) of the {chambers} that are"
            f" driven; give {', '.join(commands)}."
        )
    if extra := [c for c in found if c not in commands]:
        raise InputError(
            f"{path} commands {', '.join(extra)} too, and {plural(chambers, 'chamber')} is driven; leave out"
            " the others."
        )
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
        asked = {c: float(rows[c].iloc[0]) for c in CONDITIONS if c in rows}
        trials.append(PressureTrial(label, grid, rows[commands].to_numpy(float)[latest], sent, asked))
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
        raise InputError(
            f"{recording} has {plural(len(r.pressure_columns), 'chamber')}, and {chambers} would be driven;"
            " give the bench of the device that was diagnosed."
        )
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
        if self.out is not None:
            check_new(self.out, f"out={self.out}")
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
