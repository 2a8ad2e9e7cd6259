"""Markers and a log of pressures, each on its clock, as one bench recording in the frame of the base."""

import dataclasses
import difflib
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError


@dataclass(frozen=True)
class Track:
    """A marker, or a body of several, over time."""

    time_s: np.ndarray  # (n,) rising
    position_mm: np.ndarray  # (n, 3) in the frame of the measuring system; NaN where it was not seen
    rotation: np.ndarray | None = None  # (n, 3, 3) of a body in that frame, or None of a single marker


@dataclass
class Source:
    """What a file holds."""

    file: Path  # for messages
    tracks: dict[str, Track] = field(default_factory=dict)  # by name
    # numbers over time by name: times (n,) in s and values (n,)
    columns: dict[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)

    def track(self, name: str, option: str) -> Track:
        """A track; raises InputError with the names that there are, and the nearest."""
        if name not in self.tracks:
            raise InputError(
                f"{self.file} has no marker '{name}'{_near(name, self.tracks)}; give --{option}."
            )
        return self.tracks[name]

    def need(self, names: Iterable[str]) -> None:
        """Raises InputError where one of these columns is missing."""
        if missing := [n for n in names if n not in self.columns]:
            raise InputError(f"{self.file} has no '{missing[0]}'{_near(missing[0], self.columns)}.")

    def recording(self, names: dict[str, str], meta: dict) -> Recording:
        """A recording of columns alone, on the times of the first; commands hold, the rest is interpolated.

        `names`: name in the file to column of the recording. Raises InputError where one is missing.
        """
        self.need(names)
        times = self.columns[next(iter(names))][0]
        table = {"trial": 0, "time_s": times}
        table |= {column: resampled(*self.columns[name], times, column) for name, column in names.items()}
        device = "finger" if COMMAND in table else "arm"
        return Recording(Path(), meta, pd.DataFrame(table), device)


def resampled(time_s: np.ndarray, values: np.ndarray, at_s: np.ndarray, column: str) -> np.ndarray:
    """Values (n,) of a column at other times (m,); what is commanded or counted holds until the next.

    Raises InputError: the times go back.
    """
    if np.array_equal(time_s, at_s):  # a clock may start again with each trial
        return values
    if (np.diff(time_s) < 0).any():
        raise InputError(f"The times of '{column}' go back; give a log with one clock that rises throughout.")
    if column == "trial" or "_cmd_" in column or values.dtype.kind not in "fiu":
        return values[np.clip(np.searchsorted(time_s, at_s, side="right") - 1, 0, len(values) - 1)]
    return np.interp(at_s, time_s, values.astype(float))


def _near(name: str, names: Iterable[str]) -> str:
    names = list(names)
    close = difflib.get_close_matches(name, names, n=1)
    return f"; is '{close[0]}' meant?" if close else f"; it has {', '.join(names[:20]) or 'none'}"


def rotations(quaternion_xyzw: np.ndarray) -> np.ndarray:
    """Rotations (n, 3, 3) of quaternions (n, 4) x, y, z, w; NaN where these are."""
    R = np.full((len(quaternion_xyzw), 3, 3), np.nan)
    seen = np.isfinite(quaternion_xyzw).all(1) & (np.linalg.norm(quaternion_xyzw, axis=1) > 0.5)
    if seen.any():
        R[seen] = Rotation.from_quat(quaternion_xyzw[seen]).as_matrix()
    return R


REST_SHARE = 0.05  # of the samples: those of the least pressure, at which the tip rests
LEAST_MOVE_MM = 2.0  # that the tip must move to find the bending plane
SIGNS = ("", 1), ("+", 1), ("-", -1)
AXES = {f"{sign}{a}": s * np.eye(3)[i] for i, a in enumerate("xyz") for sign, s in SIGNS}


@dataclass(frozen=True)
class BaseFrame:
    """The base frame as seen by the measuring system."""

    rotation: np.ndarray  # (3, 3), its columns the base's axes
    origin_mm: np.ndarray  # (3,)

    def of(self, position_mm: np.ndarray) -> np.ndarray:
        """Positions (n, 3) in the base frame, mm."""
        return (position_mm - self.origin_mm) @ self.rotation


def axes_of(x: str, z: str) -> np.ndarray:
    """Axes of the base (3, 3), its columns, in a frame of which `x` and `z` name axes, such as `-y`.

    Raises InputError: they are none, or not at right angles.
    """
    if x not in AXES or z not in AXES or AXES[x] @ AXES[z] != 0:
        raise InputError(f"base_x is '{x}' and base_z '{z}'; give two different ones of x, y, z, -x, -y, -z.")
    return np.stack([AXES[x], np.cross(AXES[z], AXES[x]), AXES[z]], 1)


def of_body(base: Track, x: str, z: str, offset_mm: np.ndarray) -> BaseFrame:
    """The base frame of a tracked body that stands still at the base.

    `x` and `z` are axes of the body along the straight finger and in the bending direction, such as `-y`; the
    offset goes from its origin to the finger's base, in the base frame. Raises InputError where they are
    none, or not at right angles, or the body is never seen.
    """
    axes = axes_of(x, z)
    assert base.rotation is not None
    seen = np.isfinite(base.position_mm).all(1) & np.isfinite(base.rotation).all((1, 2))
    if not seen.any():
        raise InputError("The base body is never seen; choose another --base.")
    rotation = Rotation.from_matrix(base.rotation[seen]).mean().as_matrix() @ axes
    return BaseFrame(rotation, np.median(base.position_mm[seen], 0) + rotation @ offset_mm)


def of_motion(base_mm: np.ndarray, tip_mm: np.ndarray, pressure_kpa: np.ndarray) -> BaseFrame:
    """The base frame where the base has a marker only: x to where the tip rests, z the way that it bends.

    Of places of the base's marker (3,) and the tip (n, 3), and commanded pressures (n,). Raises InputError
    where the tip hardly moves, or is never seen.
    """
    seen = np.isfinite(tip_mm).all(1)
    tip, kpa = tip_mm[seen], np.abs(pressure_kpa[seen])
    if not len(tip):
        raise InputError("The tip is never seen; choose another --tip.")
    rest = np.median(tip[kpa <= np.quantile(kpa, REST_SHARE)], 0)
    x = (rest - base_mm) / np.linalg.norm(rest - base_mm)
    away = tip - rest
    across = away - np.outer(away @ x, x)
    if np.linalg.norm(across, axis=1).max() < LEAST_MOVE_MM:
        raise InputError(
            f"The tip moves less than {LEAST_MOVE_MM:g} mm, too little to find the bending direction."
        )
    z = np.linalg.svd(across, full_matrices=False)[2][0]
    z = (z - (z @ x) * x) / np.linalg.norm(z - (z @ x) * x)
    # Positive pressure bends towards +z.
    z *= np.sign((across @ z) @ (pressure_kpa[seen])) or 1.0
    return BaseFrame(np.stack([x, np.cross(z, x), z], 1), base_mm)


COMMAND = "pressure_cmd_kpa"
LEAST_ROWS = 20
LEAST_SHARE = 0.9  # of markers and log that both run, below which it is reported


def shifted(log: Source, offset_s: float) -> Source:
    """The log on the clock of the markers, of which its zero is `offset_s`."""
    columns = {name: (times + offset_s, values) for name, (times, values) in log.columns.items()}
    return dataclasses.replace(log, columns=columns)


def commanded(tip: Track, log: Source, columns: dict[str, str]) -> np.ndarray:
    """Commanded pressures (n,), kPa, at the times of a track; raises InputError where the log has none."""
    name = next((n for n, column in columns.items() if column == COMMAND), None)
    if name is None or name not in log.columns:
        raise InputError(
            f"{log.file} has no column for {COMMAND}; it has {', '.join(log.columns)}. Name it by"
            f" --columns='NAME: {COMMAND} [kPa]'."
        )
    return resampled(*log.columns[name], tip.time_s, COMMAND)


def joined(tip: Track, frame: BaseFrame, log: Source, columns: dict[str, str], length_mm: float) -> Recording:
    """A recording with a row for each time at which the tip was seen while the log, on the same clock, ran.

    `columns`: name in the log to column of the recording. Raises InputError where the two hardly overlap, or
    the log lacks a column.
    """
    log.need(columns)
    begin = max(log.columns[n][0][0] for n in columns)
    end = min(log.columns[n][0][-1] for n in columns)
    seen = np.isfinite(tip.position_mm).all(1) & (tip.time_s >= begin) & (tip.time_s <= end)
    if seen.sum() < LEAST_ROWS:
        raise InputError(
            f"The tip is seen in {seen.sum()} frames while {log.file} runs ({begin:.4g} to {end:.4g} s on the"
            f" markers' clock, which runs {tip.time_s[0]:.4g} to {tip.time_s[-1]:.4g} s); give --offset_s."
        )
    at = tip.time_s[seen]
    table = {"trial": np.zeros(len(at), int), "time_s": at - at[0]}
    table |= {column: resampled(*log.columns[name], at, column) for name, column in columns.items()}
    place = frame.of(tip.position_mm[seen])
    table |= {f"tip_{a}_mm": place[:, i] for i, a in enumerate("xyz")}
    recording = Recording(Path(), {"length_mm": length_mm}, pd.DataFrame(table), "finger")
    ran = {"the markers": tip.time_s[-1] - tip.time_s[0], f"{log.file}": end - begin}
    used = at[-1] - at[0]
    if used < LEAST_SHARE * max(ran.values()):
        lasted = " and ".join(f"{name} {seconds:.3g} s" for name, seconds in ran.items())
        recording.warnings.append(
            f"{used:.3g} s are used, in which both ran: {lasted}. If that is too little, give --offset_s, or"
            " export a film at the rate at which it was taken."
        )
    return recording
