"""What a program may do, and where programs have been: levels, paces, rests and conditions."""

from dataclasses import dataclass

import numpy as np

from pneutac_datasets.recording.mounts import CONDITIONS
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError

LEVELS = 8  # of pressure
PACES = (0.02, 0.2, 1.0)  # of the range a second
STILL_S = (2.0, 10.0)  # that the command has stood
PRESSED = 1 / 16  # of the range: from there on a chamber counts as one that is under pressure


@dataclass(frozen=True, eq=False)
class Limits:
    """What a program may do.

    Attributes:
        low_kpa: lowest set-point of each chamber (chambers,); a number where all have one.
        high_kpa: highest one, likewise.
        hz: samples a second.
        seconds: most that is left.
        length_s: of the programs that are no law's own; all their times scale with it.
    """

    low_kpa: np.ndarray
    high_kpa: np.ndarray
    hz: float = 20.0
    seconds: float = 600.0
    length_s: float = 60.0

    def __post_init__(self):
        low, high = np.broadcast_arrays(
            *(np.atleast_1d(x).astype(float) for x in (self.low_kpa, self.high_kpa))
        )
        object.__setattr__(self, "low_kpa", low)
        object.__setattr__(self, "high_kpa", high)
        for i in np.flatnonzero(~(low < high)):
            where = f" in chamber {i + 1}" if len(low) > 1 else ""
            raise InputError(
                f"No program fits between {low[i]:g} and {high[i]:g} kPa{where}; give a wider range."
            )

    @property
    def chambers(self) -> int:
        """How many are commanded."""
        return len(self.low_kpa)

    @property
    def rest_kpa(self) -> np.ndarray:
        """(chambers,) where programs begin: without pressure, as far as the limits allow."""
        return np.minimum(np.maximum(0.0, self.low_kpa), self.high_kpa)

    @property
    def far_kpa(self) -> np.ndarray:
        """(chambers,) to where common programs go: the highest set-point, or vacuum where rest is that."""
        return np.where(self.high_kpa > self.rest_kpa, self.high_kpa, self.low_kpa)

    def pressure_kpa(self, share: np.ndarray) -> np.ndarray:
        """Set-points (n, chambers) of shares (n, chambers) of the way from rest to there."""
        return self.rest_kpa + (self.far_kpa - self.rest_kpa) * share


def visited(recording: Recording, limits: Limits) -> dict[tuple, float]:
    """Cell of conditions, level, direction and pace, or of level and time at rest, to seconds spent in it.

    Each chamber has cells of its own, one set for each choice of others that are under pressure meanwhile.
    """
    cells: dict[tuple, float] = {}
    span, scale = limits.far_kpa - limits.rest_kpa, limits.length_s / 60.0
    clock = recording.column("time_s")
    command = recording.samples[recording.pressure_columns].to_numpy(float)
    names = [c for c in CONDITIONS if c != "temperature_c" and recording.has(c)]  # that one is never still
    conditions = [np.round(recording.column(c) / CONDITIONS[c]) for c in names]
    for rows in recording.trials().values():
        t, held = clock[rows], tuple(c[rows][0] for c in conditions)
        dt = np.diff(t, append=t[-1] + (t[-1] - t[-2] if len(t) > 1 else 0.1))
        shares = (command[rows] - limits.rest_kpa) / span
        pressed = shares > PRESSED
        for chamber, share in enumerate(shares.T):
            rate = np.gradient(share, t) if len(t) > 1 else np.zeros(1)
            since, still = 0.0, []
            for moving, step in zip(np.abs(rate) > 1e-3, dt, strict=True):
                since = 0.0 if moving else since + step
                still.append(since)
            level = np.clip((LEVELS * share).astype(int), 0, LEVELS - 1)
            pace = np.digitize(np.abs(rate) * scale, PACES)
            rest = np.digitize(np.array(still) / scale, STILL_S)
            beside = np.delete(pressed, chamber, axis=1)
            for i in range(len(t)):
                moves = abs(rate[i]) > 1e-3
                motion = (np.sign(rate[i]), pace[i]) if moves else (0, 10 + rest[i])
                cell = (held, level[i], *motion, chamber, *beside[i])
                cells[cell] = cells.get(cell, 0.0) + float(dt[i])
    return cells
