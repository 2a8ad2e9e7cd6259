"""Pressure commands for a wanted bend, and how well the finger followed them."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np
import pandas as pd

from lerobot_pneutac.cli.terminal import Terminal
from lerobot_pneutac.reports.figures import stacked
from lerobot_pneutac.reports.page import HELDOUT, MEASURED, MODEL, TRAIN, Report
from lerobot_pneutac.study.pair import same_body
from lerobot_pneutac.verbs.result import Result, drive_command
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError, check_between
from pneutac_sim.finger.control import BendController, bend_angle, bend_is_by, pressure_for
from pneutac_sim.finger.online import refuse_unused
from pneutac_sim.finger.quantities import root_mean
from pneutac_sim.twin import Twin

SHAPES = ("steps", "sine", "loops")
PERIOD_S = 24.0
INSIDE = 0.15  # share of the quick reach that the shapes leave free at each end
QUICK_S, RAMP_S = 3.0, 1.0
TARGET, COMMAND = "bend_angle_rad", "pressure_cmd_kpa"


@dataclass(frozen=True, repr=False)
class Control(Result):
    """A bend that was asked for, the program that brings it, and what became of it."""

    twin: Twin  # that was inverted
    time_s: np.ndarray  # (n,) of the commands
    target_rad: np.ndarray  # (n,) bend asked for
    pressure_kpa: np.ndarray  # (n,) command sent at each of them
    predicted_rad: np.ndarray  # (n,) bend that the twin expects
    reach_rad: tuple[float, float]  # smallest and largest bend of the finger
    recording: Recording | None = None  # in which the program was driven; None where there is none yet
    measured_s: np.ndarray | None = None  # (m,) times of its samples, from the start of each trial
    measured_rad: np.ndarray | None = None  # (m,) bend measured then

    heading = "Bend as commanded"
    caption = "Root mean square of the bend against what was asked for."
    keys = ("reach_rad", "expected_error_rad", "error_rad")

    @property
    def expected_error_rad(self) -> float:
        return root_mean((self.predicted_rad - self.target_rad) ** 2)

    @property
    def error_rad(self) -> float | None:
        """Root mean square of target and measured bend; None without a recording."""
        if self.measured_s is None or self.measured_rad is None:
            return None
        wanted = np.interp(self.measured_s, self.time_s, self.target_rad)
        return root_mean((self.measured_rad - wanted) ** 2)

    @property
    def sentence(self) -> str:
        error = self.expected_error_rad if self.error_rad is None else self.error_rad
        within = f"{1e3 * error:.1f} mrad, {100 * error / np.ptp(self.target_rad):.1f} %"
        if self.error_rad is None:
            who = "By its twin the finger follows the bend within"
            return f"{who} {within} of what is asked for. Drive program.csv and compare."
        expected = f"the twin expected {1e3 * self.expected_error_rad:.1f}"
        return f"The finger followed the bend within {within} of what was asked for; {expected}."

    def rows(self) -> list[dict]:
        kinds = (("by the twin", self.expected_error_rad), ("measured", self.error_rad))
        return [{"bend": n, "error, mrad": f"{1e3 * e:.1f}"} for n, e in kinds if e is not None]

    def next_after(self, out: Path | None) -> str:
        return "" if self.recording else drive_command(out)

    def page(self) -> Report:
        page = super().page()
        lines = (
            (1, "asked for", self.time_s, self.target_rad, {"color": MEASURED}),
            (1, "by the twin", self.time_s, self.predicted_rad, {"color": MODEL}),
            (2, "command", self.time_s, self.pressure_kpa, {"shape": "hv", "color": HELDOUT}),
        )
        figure = stacked(("bend, rad", "pressure, kPa"), (0.7, 0.3), lines=lines)
        if self.measured_rad is not None:
            dots = {"mode": "markers", "marker": {"size": 4, "color": TRAIN}}
            figure.add_scatter(x=self.measured_s, y=self.measured_rad, name="measured", **dots, row=1, col=1)
        page.figure(figure, "Above the bend, below the pressure that was commanded for it.", 520)
        return page

    def tables(self) -> dict[str, dict]:
        columns = {"time_s": self.time_s, COMMAND: self.pressure_kpa, TARGET: self.target_rad}
        return {"program.csv": columns}

    def content(self) -> dict:
        out = super().content() | {"samples": len(self.time_s), "duration_s": self.time_s[-1]}
        return out | {"bend_by": bend_is_by(self.twin), "largest_pressure_kpa": self.pressure_kpa.max()}


def control(
    twin: Twin,
    bend: str | Path | np.ndarray = "sine",
    hz: float = 20.0,
    conditions: dict[str, float] | None = None,
    recording: Recording | None = None,
) -> Control:
    """Inverts the twin: which pressures give the wanted bend, with all its effects compensated.

    Args:
        twin: a finger of one chamber, calibrated.
        bend: a shape of `SHAPES` inside the finger's reach, a CSV with `time_s` and `bend_angle_rad`, or the
            bend itself (n,) in rad, at each control step. A twin that was calibrated by tips means the
            circular arc from the base to the tip, 2 atan2(z, x).
        hz: control steps a second.
        conditions: what the twin's effects ask for, such as {temperature_c: 22}.
        recording: in which `program.csv` was driven, each trial once through; shows how well it followed.

    Raises:
        InputError: the bend is out of reach or cannot be read, or the recording does not show a bend.
    """
    check_between(1, 1000, "control steps a second", hz=hz)
    refuse_unused(twin, conditions or {})
    rested = BendController(twin, 1 / hz, conditions)
    start, reach, wanted = rested.predicted_rad, rested.reach_rad, bend
    if str(bend) in SHAPES:
        for _ in range(round(QUICK_S * hz)):
            rested.follow(twin.pressure_range_kpa[1])
        wanted = _shape(str(bend), hz, start, rested.predicted_rad)
    elif not isinstance(bend, np.ndarray):
        wanted = _table(Path(bend), hz)
    # A command brings the bend at the end of its step, so the first target is that of the second row.
    pressure, after = pressure_for(twin, np.append(wanted[1:], wanted[-1]), 1 / hz, conditions)
    time_s = np.arange(len(wanted)) / hz
    seen = () if recording is None else (recording, *_measured(recording, twin, time_s[-1]))
    return Control(twin, time_s, wanted, pressure, np.append(start, after[:-1]), reach, *seen)


def _shape(name: str, hz: float, rest: float, most: float) -> np.ndarray:
    """A shape from the bend at rest to that after `QUICK_S` at the highest pressure; begins at rest."""
    low, high = rest + INSIDE * (most - rest), most - INSIDE * (most - rest)
    t = np.arange(round((PERIOD_S + RAMP_S) * hz) + 1) / hz - RAMP_S
    if name == "steps":
        levels = np.array([0.0, 0.6, 0.3, 1.0, 0.1, 0.5, 0.9, 0.3])
        share = levels[np.clip(t // 3, 0, 7).astype(int)]
    elif name == "sine":
        share = 0.5 * (1 - np.cos(2 * np.pi * np.maximum(t, 0) / 12))
    else:
        knots, levels = [0, 3, 5, 8, 10, 13, 15, 18, 20, 24], [0, 0.9, 0.4, 1, 0.2, 0.7, 0.05, 0.6, 0.35, 1]
        share = np.interp(t, knots, levels)
    return np.where(t < 0, rest + (low - rest) * (1 + t / RAMP_S), low + (high - low) * share)


def _table(path: Path, hz: float) -> np.ndarray:
    if path.suffix != ".csv" or not path.is_file():
        raise InputError(f"bend={path} is neither a CSV file nor one of {', '.join(SHAPES)}.")
    try:
        table = pd.read_csv(path)
        time_s, bend = (table[c].to_numpy(float) for c in ("time_s", TARGET))
    except (KeyError, ValueError, OSError) as e:
        why = f"it has no column {e}" if isinstance(e, KeyError) else " ".join(str(e).split()).rstrip(".")
        raise InputError(f"{path} must be a table of numbers with columns time_s and {TARGET}: {why}.") from e
    if len(bend) < 2 or not np.isfinite([time_s, bend]).all() or (np.diff(time_s) <= 0).any():
        raise InputError(f"{path}: time_s must rise over two rows at least, all of finite numbers.")
    return np.interp(np.arange(round((time_s[-1] - time_s[0]) * hz) + 1) / hz + time_s[0], time_s, bend)


def _measured(recording: Recording, twin: Twin, end_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Times (m,) since the start of each trial, and the bend (m,) then, as the twin means it."""
    by = bend_is_by(twin)
    columns = [TARGET] if by == "angle" else ["tip_x_mm", "tip_z_mm"]
    if missing := ", ".join(c for c in columns if c not in recording.observations):
        raise InputError(f"{recording.folder} has no column {missing}, by which the twin was calibrated.")
    values = [recording.column(c) for c in columns]
    bend = values[0] if by == "angle" else bend_angle(np.stack([values[0], 0 * values[0], values[1]], -1))
    time_s = recording.column("time_s").copy()
    for rows in recording.trials().values():
        time_s[rows] -= time_s[rows][0]
    driven = time_s <= end_s
    return time_s[driven], bend[driven]


@dataclass
class ControlConfig:
    """Options of `pneutac control`."""

    described_by: ClassVar = control

    twin: Path  # folder of a finger's calibrated twin
    bend: str = "sine"  # `steps`, `sine` or `loops` within reach, or a CSV with `time_s`, `bend_angle_rad`
    hz: float = 20.0
    conditions: dict[str, float] = field(default_factory=dict)
    recording: Path | None = None  # recording of the driven program; shows how well the finger followed
    # folder for `program.csv`, `result.json` and `report.html`; nothing is written without it
    out: Path | None = None


def command(cfg: ControlConfig, terminal: Terminal) -> None:
    twin = Twin.load(cfg.twin)
    recording = Recording.load(cfg.recording) if cfg.recording else None
    if recording is not None:
        same_body(twin, recording, "control")
    terminal.finish(control(twin, cfg.bend, cfg.hz, cfg.conditions, recording), cfg.out)
