"""What `time_s` of a recording must satisfy."""

import re
from pathlib import Path

import numpy as np
import pandas as pd

from pneutac_datasets.recording.wording import plural, row_name
from pneutac_sim.errors import InputError

DAY_S = 86400.0
MAX_DUPLICATES = 0.01  # share of rows with a doubled stamp that a logger's rounding explains
ROUNDED_S = 1e-3  # by which stamps of two columns may disagree


def check_time(samples: pd.DataFrame, file: Path, warnings: list[str]) -> pd.DataFrame:
    """The samples without doubled stamps; a clock that goes back or counts milliseconds is refused."""
    time, trial = samples["time_s"].to_numpy(), samples["trial"].to_numpy()
    step = np.r_[np.inf, np.where(trial[1:] == trial[:-1], np.diff(time), np.inf)]
    if (step < 0).any():
        row = int(np.argmax(step < 0))
        raise InputError(
            f"{file}: column 'time_s', {row_name(row, file)} goes back from {time[row - 1]:g} to "
            f"{time[row]:g} s in trial {trial[row]}; sort the trial by time, or start a new trial "
            "where the clock was reset."
        )
    doubled = step == 0
    if doubled.any():
        row, n = int(np.argmax(doubled)), int(doubled.sum())
        where = (
            f"{file}: column 'time_s', {row_name(row, file)} repeats the stamp {time[row]:g} s of trial "
            f"{trial[row]} ({plural(n, 'such row')})"
        )
        if n > MAX_DUPLICATES * len(samples) and n > 1:
            raise InputError(f"{where}; write time_s with more digits, or delete those rows.")
        warnings.append(f"{where}; {'it is' if n == 1 else 'they are'} left out.")
        samples = samples[~doubled]
    normal = np.median(step[np.isfinite(step)]) if np.isfinite(step).any() else 0.0
    if 5 <= normal <= 1000 and _in_milliseconds(samples):
        raise InputError(
            f"{file}: column 'time_s' has one sample every {normal:g} s for {_length(samples) / DAY_S:.1f} "
            "days while the pressure ramps from row to row, which can only be milliseconds; divide it by "
            "1000."
        )
    if normal >= 5 and len(samples) > 100:
        warnings.append(
            f"{file}: column 'time_s' has one sample every {normal:g} s; if the clock counts milliseconds, "
            "divide it by 1000."
        )
    return samples


def check_sent(samples: pd.DataFrame, file: Path) -> None:
    """Raises InputError where `time_sent_s` cannot be when the commands of the rows were sent.

    A command stands in the first row that knows of it: a logger that commands and then measures sends it
    between the stamps of the row before and of its own, one that measures and then commands before the stamp
    of the next row. A row that repeats the stamp of the row before repeats its command, which still stands.
    """
    if "time_sent_s" not in samples:
        return
    sent, time = (samples[c].to_numpy(float) for c in ("time_sent_s", "time_s"))
    trial = samples["trial"].to_numpy()
    command = samples[[c for c in samples if re.fullmatch(r"pressure_cmd_(\d+_)?kpa", c)]].to_numpy(float)
    follows = np.r_[False, trial[1:] == trial[:-1]]
    step = np.r_[0.0, np.diff(sent)]
    before = np.where(follows, np.r_[-np.inf, time[:-1]], -np.inf)
    after = np.where(np.r_[follows[1:], False], np.r_[time[1:], np.inf], np.inf)
    new = ~follows | (step != 0)
    changed = np.r_[False, (np.diff(command, axis=0) != 0).any(1)]
    clock = "give it on the clock of time_s"
    faults = (
        (follows & (step < 0), lambda i: f"goes back from {sent[i - 1]:g} to {sent[i]:g} s; sort the rows"),
        (
            follows & ~new & changed,
            lambda i: (
                f"is {sent[i]:g} s as in the row before, though the command is another; give each "
                "command its own time"
            ),
        ),
        (
            sent > after + ROUNDED_S,
            lambda i: f"is {sent[i]:g} s, later than the time {after[i]:g} s of the next row; {clock}",
        ),
        (
            new & (sent < before - ROUNDED_S),
            lambda i: (
                f"is {sent[i]:g} s, earlier than the time {before[i]:g} s of the row before; {clock}, "
                "and repeat it exactly where no new command was sent"
            ),
        ),
    )
    found = [(int(np.argmax(wrong)), fault) for wrong, fault in faults if wrong.any()]
    if found:
        i, fault = min(found, key=lambda f: f[0])
        raise InputError(
            f"{file}: column 'time_sent_s', {row_name(int(samples.index[i]), file)} (trial {trial[i]}) "
            f"{fault(i)}."
        )


def _length(samples: pd.DataFrame) -> float:
    """Total recorded time, s."""
    time = samples.groupby("trial")["time_s"]
    return float((time.max() - time.min()).sum())


def _in_milliseconds(samples: pd.DataFrame) -> bool:
    """Whether a clock with steps of 5 to 1000 certainly counts milliseconds.

    Its stamps are whole numbers, make more than a day, and the commanded pressure follows ramps. A recording
    that is truly so slow holds its pressures (creep) or jumps between them from row to row (fatigue).
    """
    time = samples["time_s"].to_numpy()
    if _length(samples) < DAY_S or (np.abs(time - np.round(time)) > 1e-3).any():
        return False
    p = samples[[c for c in samples if re.fullmatch(r"pressure_cmd_(\d+_)?kpa", c)]].to_numpy(float)
    move = np.abs(np.diff(p, axis=0)).max(1) / max(float(np.ptp(p)), 1e-9)
    moving = move > 1e-4
    return bool(moving.mean() > 0.1 and np.median(move[moving]) < 0.1)
