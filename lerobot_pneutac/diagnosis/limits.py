"""What a program may do, and where programs have been: levels, paces, rests and conditions."""

from dataclasses import dataclass

import numpy as np

from pneutac_datasets.recording.mounts import CONDITIONS
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError

LEVELS = 8  # of pressure
PACES = (0.02, 0.2, 1.0)  # of the range a second
STILL_S = (2.0, 10.0)  # that the command has stood


@dataclass(frozen=True)
class Limits:
    """What a program may do.

    Attributes:
        low_kpa: lowest set-point.
        high_kpa: highest one.
        hz: samples a second.
        seconds: most that is left.
        length_s: of the programs that are no law's own; all their times scale with it.
    """

    low_kpa: float
    high_kpa: float
    hz: float = 20.0
    seconds: float = 600.0
    length_s: float = 60.0

    def __post_init__(self):
        if not self.low_kpa < self.high_kpa:
            raise InputError(
                f"No program fits between {self.low_kpa:g} and {self.high_kpa:g} kPa; give a wider range."
            )

    @property
    def rest_kpa(self) -> float:
        """Where programs begin: without pressure, as far as the limits allow."""
        return min(max(0.0, self.low_kpa), self.high_kpa)

    @property
    def far_kpa(self) -> float:
        """To where common programs go: the highest set-point, or vacuum where there is none above rest."""
        return self.high_kpa if self.high_kpa > self.rest_kpa else self.low_kpa


def visited(recording: Recording, limits: Limits) -> dict[tuple, float]:
    """Cell of conditions, level, direction and pace, or of level and time at rest, to seconds spent in it."""
    cells: dict[tuple, float] = {}
    span, scale = limits.far_kpa - limits.rest_kpa, limits.length_s / 60.0
    command, clock = recording.column(recording.pressure_columns[0]), recording.column("time_s")
    names = [c for c in CONDITIONS if c != "temperature_c" and recording.has(c)]  # that one is never still
    conditions = [np.round(recording.column(c) / CONDITIONS[c]) for c in names]
    for rows in recording.trials().values():
        t, p, held = clock[rows], command[rows], tuple(c[rows][0] for c in conditions)
        dt = np.diff(t, append=t[-1] + (t[-1] - t[-2] if len(t) > 1 else 0.1))
        share = (p - limits.rest_kpa) / span
        rate = np.gradient(share, t) if len(t) > 1 else np.zeros(1)
        since, still = 0.0, []
        for moving, step in zip(np.abs(rate) > 1e-3, dt, strict=True):
            since = 0.0 if moving else since + step
            still.append(since)
        level = np.clip((LEVELS * share).astype(int), 0, LEVELS - 1)
        pace = np.digitize(np.abs(rate) * scale, PACES)
        rest = np.digitize(np.array(still) / scale, STILL_S)
        for i in range(len(t)):
            moves = abs(rate[i]) > 1e-3
            cell = (held, level[i], *((np.sign(rate[i]), pace[i]) if moves else (0, 10 + rest[i])))
            cells[cell] = cells.get(cell, 0.0) + float(dt[i])
    return cells
