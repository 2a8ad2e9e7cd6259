"""What drives the model: pressures, time steps and conditions of a table of samples."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from pneutac_sim.errors import InputError
from pneutac_sim.finger.quantities import observations

CHAMBERS = {"finger": 1, "arm": 3}
SOURCES = ("auto", "command", "measured")
STARTS = ("auto", "held", "vented")


@dataclass(frozen=True)
class Inputs:
    """Everything the pipeline reads, one row a sample, m rows.

    A trial that starts vented has one row more, before its first sample, at zero pressure.

    Attributes:
        pressure_kpa: (m, chambers), commanded or measured.
        dt_s: (m,) since the row before; infinite where a trial starts.
        rows: (n,) which rows are samples.
        columns: condition name to (m,).
        measured: True where `pressure_kpa` was measured, so that pneumatics are skipped.
        pressure_range_kpa: largest magnitude of the pressure; scales bounds and starting values.
    """

    pressure_kpa: np.ndarray
    dt_s: np.ndarray
    rows: np.ndarray
    columns: dict[str, np.ndarray]
    measured: bool
    pressure_range_kpa: float
    _cache: dict = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def from_samples(
        cls,
        samples: Mapping,
        device: str = "finger",
        length_mm: float = 110.0,
        source: str = "auto",
        start: str = "auto",
    ) -> "Inputs":
        """Reads a table (a DataFrame or a dict of arrays) with the columns of a bench recording.

        Args:
            samples: `trial`, `time_s`, pressures and conditions, (n,) each.
            device: `finger` or `arm`.
            length_mm: of the device; offered to effects as a column.
            source: `command`, `measured`, or `auto`: measured where it was logged.
            start: what a trial came from: `held` at its first pressure for long, `vented` (at rest at zero),
                or `auto`: vented where the first poses do not differ although the first pressures do.

        Raises:
            InputError: a column is missing or time does not rise within a trial.
        """
        if source not in SOURCES or start not in STARTS:
            raise InputError(
                f"source is '{source}' and start '{start}'; they must be one of {', '.join(SOURCES)} and of "
                f"{', '.join(STARTS)}."
            )
        command, measured = pressure_columns(device)
        use_measured = source == "measured" or (source == "auto" and all(c in samples for c in measured))
        names = measured if use_measured else command
        for name in ("time_s", *names):
            if name not in samples:
                raise InputError(f"The samples have no column '{name}'; a {device} needs it.")
        pressure = np.stack([np.asarray(samples[c], dtype=float) for c in names], axis=1)
        time = np.asarray(samples["time_s"], dtype=float)
        trial = np.asarray(samples["trial"]) if "trial" in samples else np.zeros(len(time), int)
        first = np.r_[True, trial[1:] != trial[:-1]]
        largest = [np.abs(np.asarray(samples[c], dtype=float)).max() for c in command if c in samples]
        inputs = cls(
            pressure_kpa=pressure,
            dt_s=_time_steps(time, first),
            rows=np.arange(len(time)),
            columns=_conditions(samples, names, (*command, *measured))
            | {
                "session_time_s": _session_time(time, first),
                "length_mm": np.full(len(time), float(length_mm)),
            },
            measured=use_measured,
            pressure_range_kpa=float(max([*largest, np.abs(pressure).max(), 1e-3])),
        )
        if start == "vented" or (start == "auto" and _starts_vented(pressure, first, samples, device)):
            return inputs._with_vented_rows()
        return inputs

    def conditions(self, names: tuple[str, ...]) -> np.ndarray:
        """(m, k) condition columns in this order."""
        if names not in self._cache:
            parts = [self.columns[name] for name in names]
            self._cache[names] = np.stack(parts, axis=1) if parts else np.zeros((len(self.dt_s), 0))
        return self._cache[names]

    def at_samples(self, more: dict[str, np.ndarray]) -> Callable[[tuple[str, ...]], np.ndarray]:
        """Like `conditions`, (n, k) at the samples, and with these further columns (m,)."""

        def conditions(names: tuple[str, ...]) -> np.ndarray:
            if not any(name in more for name in names):
                return self.conditions(names)[self.rows]
            return np.stack([(more | self.columns)[name][self.rows] for name in names], axis=1)

        return conditions

    @property
    def sample_dt_s(self) -> np.ndarray:
        """(n,) time since the sample before; infinite at the first sample of a trial."""
        if "dt" not in self._cache:
            begins = np.isinf(self.dt_s)
            clock = np.cumsum(np.where(begins, 0.0, self.dt_s))[self.rows]
            trial = np.cumsum(begins)[self.rows]
            new = np.diff(trial, prepend=0) != 0
            self._cache["dt"] = np.where(new, np.inf, np.diff(clock, prepend=0.0))
        return self._cache["dt"]

    def thin(self, samples: np.ndarray) -> "Inputs":
        """The same inputs, observed at these samples (indices, (k,)); what happens between stays exact."""
        return replace(self, rows=self.rows[samples], _cache={})

    def _with_vented_rows(self) -> "Inputs":
        first = np.flatnonzero(np.isinf(self.dt_s))
        normal = np.median(self.dt_s[np.isfinite(self.dt_s)]) if np.isfinite(self.dt_s).any() else 1e-3
        dt = self.dt_s.copy()
        dt[first] = normal
        insert = {k: np.insert(v, first, v[first]) for k, v in self.columns.items()}
        at = self.rows + np.searchsorted(first, self.rows, side="right")
        return replace(
            self,
            pressure_kpa=np.insert(self.pressure_kpa, first, 0.0, axis=0),
            dt_s=np.insert(dt, first, np.inf),
            rows=at,
            columns=insert,
            _cache={},
        )


def pressure_columns(device: str) -> tuple[list[str], list[str]]:
    """Names of the commanded and of the measured pressures of a device."""
    if device not in CHAMBERS:
        raise InputError(f"A '{device}' has no pressure chambers; it must be one of {', '.join(CHAMBERS)}.")
    if device == "finger":
        return ["pressure_cmd_kpa"], ["pressure_kpa"]
    chambers = range(1, CHAMBERS[device] + 1)
    return [f"pressure_cmd_{i}_kpa" for i in chambers], [f"pressure_{i}_kpa" for i in chambers]


def other_pressures(samples: Mapping, device: str) -> list[str]:
    """Pressures of other chambers that a recording has as conditions."""
    own = sum(pressure_columns(device), [])
    return [str(c) for c in samples if str(c).endswith("_kpa") and c not in own]


def conditions_of(samples: Mapping, device: str) -> set[str]:
    """Columns that effects may ask for, recorded or computed."""
    computed = {"session_time_s", "length_mm", "bending_pressure_kpa"}
    if other_pressures(samples, device):
        computed |= {"other_1_kpa", "other_2_kpa", "other_3_kpa"}
    return computed | {str(c) for c in samples}


def _time_steps(time: np.ndarray, first: np.ndarray) -> np.ndarray:
    """(n,) seconds since the sample before, infinite at the first of a trial."""
    dt = np.where(first, np.inf, np.diff(time, prepend=time[:1]))
    if not (dt > 0).all():
        row = int(np.argmax(~(dt > 0)))
        raise InputError(f"Column 'time_s', row {row + 1} does not rise within its trial; sort by time.")
    return dt


def _conditions(samples: Mapping, drive: list[str], own: tuple[str, ...]) -> dict[str, np.ndarray]:
    """All numeric columns but those that drive the model; pressures of other chambers also by number."""
    columns = {
        str(name): np.asarray(samples[name], dtype=float)
        for name in samples
        if np.asarray(samples[name]).dtype.kind in "fiub" and name not in drive
    }
    others = [c for c in columns if c.endswith("_kpa") and c not in own]
    if others:
        zero = np.zeros(len(columns[others[0]]))
        columns |= {f"other_{i + 1}_kpa": columns[others[i]] if i < len(others) else zero for i in range(3)}
    return columns


def _session_time(time: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Seconds since the recording began; a trial whose clock restarts follows right after the one before."""
    shift, out = -time[0], np.empty_like(time)
    starts = np.flatnonzero(first)
    for a, b in zip(starts, np.r_[starts[1:], len(time)], strict=True):
        if a and time[a] + shift < out[a - 1]:
            shift = out[a - 1] - time[a]
        out[a:b] = time[a:b] + shift
    return out


def _starts_vented(pressure: np.ndarray, first: np.ndarray, samples: Mapping, device: str) -> bool:
    """Whether trials start at rest although their first pressure is not zero.

    Trials that begin with a constant pressure tell: if they start from rest, their first poses agree and only
    their later poses follow the pressure.
    """
    poses = observations(samples, device)
    if not poses:
        return False
    span = np.ptp(pressure)
    begin, settled, level = [], [], []
    starts = np.flatnonzero(first)
    for a, b in zip(starts, np.r_[starts[1:], len(first)], strict=True):
        moved = np.abs(pressure[a:b] - pressure[a]).max(axis=1) > 0.02 * span
        hold = a + (int(np.argmax(moved)) if moved.any() else b - a)
        if hold - a >= 10:
            begin.append(a)
            settled.append(hold - 1)
            level.append(pressure[a])
    if len(level) < 3:
        return False
    design = np.array(level) - np.mean(level, axis=0)
    if np.ptp(design) < 0.2 * span:
        return False
    y = np.stack([np.asarray(samples[c], dtype=float) for c in poses], axis=1)

    def slope(rows):
        return np.linalg.norm(np.linalg.lstsq(design, y[rows] - y[rows].mean(axis=0), rcond=None)[0])

    return bool(slope(begin) < 0.3 * slope(settled))
