"""What drives the model: pressures, time steps and conditions of a table of samples.

When the command switches between two samples.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pneutac_sim.effects.body_effect import REFERENCE_C
from pneutac_sim.errors import InputError
from pneutac_sim.features import CHAMBERS
from pneutac_sim.finger.quantities import observations
from pneutac_sim.finger.sent import sent_times

STEP_SHARE = 0.02  # of the range: a smaller change from sample to sample is no step
_UNSEEN = 3  # commands between two samples that are searched for, besides the logged one


def steps(pressure: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Rows before which a command (n, chambers) steps: a chamber's changes much there and little nearby.

    `first` (n,) is True where a trial begins.
    """
    change = np.abs(np.diff(pressure, axis=0, prepend=pressure[:1]))
    change[first] = 0.0
    none = np.zeros((1, change.shape[1]))
    beside = np.maximum(np.r_[none, change[:-1]], np.r_[change[1:], none])
    return np.flatnonzero(((change > STEP_SHARE * np.ptp(pressure)) & (change > 3 * beside)).any(axis=1))


def switches(samples, time: np.ndarray, pressure: np.ndarray, first: np.ndarray, switch):
    """Where the command switches between samples: arguments of `Inputs._with_switches`.

    By `time_sent_s` if the log has it, else those of ramps as their commands show it and steps by `switch`,
    see `Inputs.from_samples`; pressures (n, chambers) are those commanded, and `first` (n,) is True where a
    trial begins.
    """
    at, ramp = steps(pressure, first), _ramps(pressure, first)
    sent = np.full(len(time), math.nan)
    if logged := "time_sent_s" in samples:
        sent = np.asarray(samples["time_sent_s"], dtype=float)
    elif switch is not None:
        sent = sent_times(time, pressure, first)
    ramp &= np.isfinite(sent) & np.isfinite(np.roll(sent, 1))
    at = at[~ramp[at]]
    share = (sent[at] - time[at - 1]) / (time[at] - time[at - 1]) if logged else np.full(len(at), math.nan)
    if switch is not None and (np.ndim(switch) or not logged):
        given = np.broadcast_to(np.asarray(switch, dtype=float), len(time))[at]
        share = np.where(np.isfinite(given), given, share)
    at, share = at[np.isfinite(share)], share[np.isfinite(share)]
    of_steps = at, share, pressure[at - 1], pressure[at]
    of_ramps = _of_ramps(sent, time, pressure, np.flatnonzero(ramp))
    at, share, before, after = (np.concatenate(x) for x in zip(of_steps, of_ramps, strict=True))
    order = np.lexsort((share, at))
    return at[order], share[order], before[order], after[order]


def shares(samples, pressure: np.ndarray, first: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Between which shares (k,) and (k,) of the time from row to row each of `steps` may have come.

    The whole time, or where `time_sent_s` is logged, then. But a computer that is faster than the log and
    goes on sending may have stepped with a command before the one that the row has.
    """
    at = steps(pressure, first)
    if "time_sent_s" not in samples:
        return np.zeros(len(at)), np.ones(len(at))
    sent, time = (np.asarray(samples[c], dtype=float) for c in ("time_sent_s", "time_s"))
    ramp = _ramps(pressure, first)
    row = time[at] - time[at - 1]
    latest = np.clip((sent[at] - time[at - 1]) / row, 0, 1)
    following = np.minimum(at + 1, len(time) - 1)
    goes_on = (sent[following] != sent[at]) & ~first[following] & ~ramp[at]
    tick = _tick(sent, time, np.flatnonzero(ramp))
    unseen = np.floor((sent[at] - time[at - 1]) / tick - 1e-6)
    return latest - np.where(goes_on, np.maximum(unseen, 0), 0) * tick / row, latest


def held(pressure: np.ndarray, first: np.ndarray, share: np.ndarray) -> np.ndarray:
    """The command (n, chambers) at the samples of a ramp whose commands are held, each until the next one.

    A staircase that steps at a `share` (n,) of the time between two samples, is on average the straight line
    from sample to sample so much later as that is beyond one half, or earlier; NaN leaves a row as it is.
    """
    step = np.diff(pressure, axis=0, prepend=pressure[:1])
    step[first | np.isin(np.arange(len(first)), steps(pressure, first))] = 0.0
    late = np.nan_to_num(share - 0.5)[:, None]
    return pressure - np.maximum(late, 0) * step - np.minimum(late, 0) * np.r_[step[1:], 0.0 * step[:1]]


def _of_ramps(sent, time, pressure, ramp: np.ndarray):
    """Switches before the rows `ramp` (k,), from when each row's command was sent.

    A computer that is faster than the log sends commands that no row has; they lie between their neighbours,
    in time and height.
    """
    tick, parts = _tick(sent, time, ramp), []
    for back in range(_UNSEEN, -1, -1):
        instant = sent[ramp] - back * tick
        on = (instant > sent[ramp - 1] + tick / 2) & (instant > time[ramp - 1]) | (back == 0)
        i, instant = ramp[on], instant[on]

        def command(at, i=i):
            """Command (k, chambers) sent at these instants, (k,)."""
            share = 1 - (sent[i] - at) / (sent[i] - sent[i - 1])
            return pressure[i - 1] + np.clip(share, 0, 1)[:, None] * (pressure[i] - pressure[i - 1])

        earlier = instant - tick
        logged = earlier <= np.maximum(sent[i - 1] + tick / 2, time[i - 1])
        before = np.where(logged[:, None], pressure[i - 1], command(earlier))
        parts.append((i, (instant - time[i - 1]) / (time[i] - time[i - 1]), before, command(instant)))
    return [np.concatenate(x) for x in zip(*parts, strict=True)]


def _ramps(pressure: np.ndarray, first: np.ndarray) -> np.ndarray:
    """(n,) whether a chamber moves up to a row and moved up to the one before."""
    moves = np.diff(pressure, axis=0, prepend=pressure[:1]) != 0
    moves[first] = False
    return np.r_[False, (moves[1:] & moves[:-1]).any(axis=1)]


def _tick(sent: np.ndarray, time: np.ndarray, rows: np.ndarray) -> float:
    """Seconds from command to command: of a loop that logs each one, or of a separate computer.

    With a separate computer a sample finds the last command at any age up to that; in a loop all are of one
    age.
    """
    if not len(rows):
        return 1.0  # no ramp, so none unseen
    gap = sent[rows] - sent[rows - 1]
    low, high = np.quantile((time - sent)[rows], (0.02, 0.98))
    if high - low < 0.2 * np.median(gap):
        return float(np.median(gap))
    return float(np.median(gap / np.maximum(np.round(gap / (high - low)), 1)))


SOURCES = ("auto", "command", "measured")
STARTS = ("auto", "held", "vented")
SWITCH_S = 1e-4  # a step of the command takes this long


@dataclass(frozen=True)
class Inputs:
    """Everything the pipeline reads, one row a sample, m rows.

    A trial that starts vented has one row more, before its first sample, at zero pressure.
    """

    pressure_kpa: np.ndarray  # (m, chambers), commanded or measured
    dt_s: np.ndarray  # (m,) since the row before; infinite where a trial starts
    rows: np.ndarray  # (n,) which rows are samples
    columns: dict[str, np.ndarray]  # condition name to (m,)
    measured: bool  # True where `pressure_kpa` was measured, so that pneumatics are skipped
    pressure_range_kpa: float  # largest magnitude of the pressure; scales bounds and starting values
    _cache: dict = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def from_samples(
        cls,
        samples: Mapping,
        device: str = "finger",
        length_mm: float = 110.0,
        source: str = "auto",
        start: str | float | Sequence[float] = "auto",
        trials: Mapping[str, Mapping] | None = None,
        switch: float | np.ndarray | None = None,
    ) -> "Inputs":
        """Reads a table (a DataFrame or a dict of arrays) with the columns of a bench recording.

        Args:
            samples: `trial`, `time_s`, pressures and conditions, (n,) each.
            device: `finger` or `arm`.
            length_mm: of the device; offered to effects as a column.
            source: `command`, `measured`, or `auto`: measured where it was logged.
            start: what a trial came from: `held` at its first pressure for long, `vented` (at rest at zero),
                or `auto`: vented where the first poses do not differ although the first pressures do; or
                seconds, one for all or (trials,): it goes on from the trial before after so long at zero
                pressure.
            trials: what is known of how single trials begin, see `recording.json`; goes before `start`.
            switch: where in the time between two samples a step of the command happens, 0 to 1, one for all
                or (n,), NaN for a row before which there is none; in a ramp, where its commands are sent, see
                `held`, and NaN where it goes straight from sample to sample, as everywhere for None. With
                column `time_sent_s` every command, those of a ramp too, is held from then until the next;
                (n,) has the steps that came at another share, see `shares`.

        Raises InputError: a column is missing or time does not rise within a trial.
        """
        if source not in SOURCES or (isinstance(start, str) and start not in STARTS):
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
        vented = start == "vented" or (start == "auto" and _starts_vented(pressure, first, samples, device))
        default = start if not isinstance(start, str) else math.inf if vented else math.nan
        pauses = _pauses(trial[first], default, trials or {})
        largest = [np.abs(np.asarray(samples[c], dtype=float)).max() for c in command if c in samples]
        inputs = cls(
            pressure_kpa=pressure,
            dt_s=_time_steps(time, first),
            rows=np.arange(len(time)),
            columns=_conditions(samples, names, (*command, *measured))
            | {
                "session_time_s": _session_time(time, first, pauses),
                "length_mm": np.full(len(time), float(length_mm)),
            },
            measured=use_measured,
            pressure_range_kpa=float(max([*largest, np.abs(pressure).max(), 1e-3])),
        )
        if not use_measured:
            if np.ndim(switch) and "time_sent_s" not in samples:
                inputs = replace(inputs, pressure_kpa=held(pressure, first, np.asarray(switch, dtype=float)))
            inputs = inputs._with_switches(*switches(samples, time, pressure, first, switch))
        return inputs._with_pauses(pauses)

    def conditions(self, names: tuple[str, ...]) -> np.ndarray:
        """(m, k) condition columns in this order."""
        if names not in self._cache:
            parts = [self._condition(name) for name in names]
            self._cache[names] = np.stack(parts, axis=1) if parts else np.zeros((len(self.dt_s), 0))
        return self._cache[names]

    def _condition(self, name: str) -> np.ndarray:
        """(m,) of a column, or the laws' reference where no temperature was recorded."""
        if name == "temperature_c" and name not in self.columns:
            return np.full(len(self.dt_s), REFERENCE_C)
        return self.columns[name]

    def conditions_with(
        self, more: dict[str, np.ndarray], at_samples: bool
    ) -> Callable[[tuple[str, ...]], np.ndarray]:
        """Like `conditions`, with these further columns; (m,), or (n,), (n, k) where samples are wanted."""

        def conditions(names: tuple[str, ...]) -> np.ndarray:
            if any(name in more for name in names):
                rows = self.rows if at_samples else slice(None)
                parts = [more[name] if name in more else self._condition(name)[rows] for name in names]
                return np.stack(parts, axis=1)
            if not at_samples:
                return self.conditions(names)
            if ("samples", names) not in self._cache:
                self._cache["samples", names] = self.conditions(names)[self.rows]
            return self._cache["samples", names]

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

    def _with_pauses(self, pause_s: np.ndarray) -> "Inputs":
        """Trials that begin at zero pressure, after so long; NaN: long at their first pressure."""
        first = np.flatnonzero(np.isinf(self.dt_s))
        normal = np.median(self.dt_s[np.isfinite(self.dt_s)]) if np.isfinite(self.dt_s).any() else 1e-3
        pause_s = np.array(pause_s, dtype=float)
        if np.isfinite(pause_s[:1]).any():
            pause_s[0] = math.inf  # before the first trial nothing is known
        on = np.flatnonzero(~np.isnan(pause_s))
        dt = self.dt_s.copy()
        dt[first[on]] = normal
        zero = np.zeros((len(on), self.pressure_kpa.shape[1]))
        out = replace(self, dt_s=dt)._insert(first[on], zero, pause_s[on])
        going_on = np.flatnonzero(np.isfinite(pause_s[on]))  # these vent within one sample, then wait
        at = np.flatnonzero(np.isin(np.arange(len(out.dt_s)), first[on] + np.arange(len(on))))[going_on]
        return out._insert(at, zero[going_on], np.full(len(at), normal))

    def _with_switches(
        self, at: np.ndarray, share: np.ndarray, before: np.ndarray, after: np.ndarray
    ) -> "Inputs":
        """The command switches within the time before rows `at` (k,), at `share` (k,) of that time.

        Rows are in rising order. It is `before` (k, chambers) until then and `after` from then on; shares
        rise within one row's.
        """
        whole = self.dt_s[at]
        start = _switch_start(share, whole)
        apart = np.r_[True, (np.diff(at) > 0) | (np.diff(start) > 2 * SWITCH_S)][: len(at)]
        at, whole, start, before, after = (x[apart] for x in (at, whole, start, before, after))
        again = np.r_[False, np.diff(at) == 0][: len(at)]
        until = start - np.where(again, np.roll(start, 1) + SWITCH_S, 0.0)
        dt = self.dt_s.copy()
        dt[at] = whole - start - SWITCH_S  # of the last one before each row
        both = np.stack([before, after], axis=1)
        steps = np.stack([until, np.full(len(at), SWITCH_S)], axis=1)
        return replace(self, dt_s=dt)._insert(
            np.repeat(at, 2), both.reshape(2 * len(at), self.pressure_kpa.shape[1]), steps.ravel()
        )

    def switched_at(self, last: np.ndarray, share: float | np.ndarray) -> "Inputs":
        """The same inputs with the command's steps at other shares (one or k) of the time between samples.

        `last` (k,) are the rows before which the command steps; the two rows before each are the step.
        """
        dt = self.dt_s.copy()
        whole = dt[last - 2] + dt[last - 1] + dt[last]
        dt[last - 2] = _switch_start(share, whole)
        dt[last] = whole - dt[last - 2] - SWITCH_S
        return replace(self, dt_s=dt)

    def paused(self, at: np.ndarray, pause_s: np.ndarray) -> "Inputs":
        """The same inputs with other pauses (k,) before trials; rows `at` (k,) are those at zero pressure.

        The session's time moves along, unless one clock goes on from trial to trial.
        """
        dt, t = self.dt_s.copy(), self.columns["session_time_s"]
        dt[at] = pause_s
        anew = np.abs(t[at] - t[at - 2] - self.dt_s[at]) < 1e-6
        later = np.zeros(len(t))
        later[at - 1] = np.where(anew, pause_s - self.dt_s[at], 0.0)
        columns = self.columns | {"session_time_s": t + np.cumsum(later)}
        return replace(self, dt_s=dt, columns=columns, _cache={})

    def _insert(self, before: np.ndarray, pressure_kpa: np.ndarray, dt_s: np.ndarray) -> "Inputs":
        """With further rows (k,) before these, in rising order, that are no samples."""
        if not len(before):
            return self
        return replace(
            self,
            pressure_kpa=np.insert(self.pressure_kpa, before, pressure_kpa, axis=0),
            dt_s=np.insert(self.dt_s, before, dt_s),
            rows=self.rows + np.searchsorted(before, self.rows, side="right"),
            columns={k: np.insert(v, before, v[before]) for k, v in self.columns.items()},
            _cache={},
        )


def _switch_start(share: float | np.ndarray, whole: np.ndarray) -> np.ndarray:
    return np.clip(np.clip(share, 0, 1) * whole, SWITCH_S, whole - 2 * SWITCH_S)


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
    """(n,) seconds since the sample before, infinite at the first of a trial.

    To the nanosecond, so that equal steps are equal numbers: laws work out what follows from a step once.
    """
    dt = np.where(first, np.inf, np.round(np.diff(time, prepend=time[:1]), 9))
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


def _session_time(time: np.ndarray, first: np.ndarray, pause_s: np.ndarray) -> np.ndarray:
    """(n,) s since the first sample; a clock that starts anew goes on after the pause (trials,) before it."""
    shift, out = -time[0], np.empty_like(time)
    starts = np.flatnonzero(first)
    for a, b, pause in zip(starts, np.r_[starts[1:], len(time)], pause_s, strict=True):
        if a and time[a] + shift < out[a - 1]:
            shift = out[a - 1] - time[a] + (pause if math.isfinite(pause) else 0.0)
        out[a:b] = time[a:b] + shift
    return out


def _pauses(trials: np.ndarray, default, known: Mapping[str, Mapping]) -> np.ndarray:
    """(trials,) seconds at zero pressure before each; infinite: rested; NaN: held at its first pressure.

    `default` is of those that are not `known`, one for all or (trials,).
    """
    out = np.array(np.broadcast_to(np.asarray(default, dtype=float), len(trials)))
    for i, trial in enumerate(trials):
        stated = known.get(str(trial), {})
        if stated.get("start") == "rested":
            out[i] = math.inf
        elif stated.get("start") == "continues":
            out[i] = float(stated.get("pause_s", out[i] if math.isfinite(out[i]) else 0.0))
    return out


def _starts_vented(pressure: np.ndarray, first: np.ndarray, samples: Mapping, device: str) -> bool:
    """Whether trials start at rest although their first pressure is not zero.

    Trials that begin with a constant pressure show it: if they start from rest, their first poses agree and
    only their later poses follow the pressure.
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
