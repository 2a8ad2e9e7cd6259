"""What other systems log, before it is a bench recording: moving markers, and numbers over time."""

import difflib
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from pneutac_sim.errors import InputError


@dataclass(frozen=True)
class Track:
    """A marker, or a body of several, over time.

    Attributes:
        time_s: (n,) rising.
        position_mm: (n, 3) in the frame of the measuring system; NaN where it was not seen.
        rotation: (n, 3, 3) of a body in that frame, or None of a single marker.
    """

    time_s: np.ndarray
    position_mm: np.ndarray
    rotation: np.ndarray | None = None


@dataclass
class Source:
    """What a file holds.

    Attributes:
        file: for messages.
        tracks: by name.
        columns: numbers over time by name: times (n,) in s and values (n,).
    """

    file: Path
    tracks: dict[str, Track] = field(default_factory=dict)
    columns: dict[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)

    def track(self, name: str, option: str) -> Track:
        """A track; raises InputError with the names that there are, and the nearest."""
        if name not in self.tracks:
            raise InputError(
                f"{self.file} has no marker '{name}'{_near(name, self.tracks)}; give --{option}."
            )
        return self.tracks[name]

    def table(self, names: dict[str, str]) -> pd.DataFrame:
        """Columns of a bench recording on the times of the first; commands hold, the rest is interpolated.

        Args:
            names: name in the file to column of the recording.

        Raises:
            InputError: one is missing.
        """
        missing = [n for n in names if n not in self.columns]
        if missing:
            raise InputError(f"{self.file} has no '{missing[0]}'{_near(missing[0], self.columns)}.")
        times = self.columns[next(iter(names))][0]
        table = {"time_s": times}
        table |= {column: resampled(*self.columns[name], times, column) for name, column in names.items()}
        return pd.DataFrame(table)


def resampled(time_s: np.ndarray, values: np.ndarray, at_s: np.ndarray, column: str) -> np.ndarray:
    """Values (n,) of a column at other times (m,); what is commanded or counted holds until the next.

    Raises:
        InputError: the times go back.
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
    from scipy.spatial.transform import Rotation

    R = np.full((len(quaternion_xyzw), 3, 3), np.nan)
    seen = np.isfinite(quaternion_xyzw).all(1) & (np.linalg.norm(quaternion_xyzw, axis=1) > 0.5)
    if seen.any():
        R[seen] = Rotation.from_quat(quaternion_xyzw[seen]).as_matrix()
    return R
