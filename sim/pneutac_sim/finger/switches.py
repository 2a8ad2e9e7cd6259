"""When the command switches between two samples."""

import math

import numpy as np

STEP_SHARE = 0.02  # of the range: a smaller change from sample to sample is no step
_UNSEEN = 3  # commands between two samples that are searched for, besides the logged one


def steps(pressure: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Rows before which a pressure (n, chambers) steps: it changes much there and little nearby.

    Args:
        pressure: commanded.
        first: (n,) True where a trial begins.
    """
    change = np.abs(np.diff(pressure, axis=0, prepend=pressure[:1])).max(axis=1)
    change[first] = 0.0
    beside = np.maximum(np.r_[0.0, change[:-1]], np.r_[change[1:], 0.0])
    return np.flatnonzero((change > STEP_SHARE * np.ptp(pressure)) & (change > 3 * beside))


def switches(samples, time: np.ndarray, pressure: np.ndarray, first: np.ndarray, switch):
    """Where the command switches between samples: arguments of `Inputs._with_switches`.

    Args:
        samples: with `time_sent_s` if the log has it.
        time: (n,) of the samples.
        pressure: (n, chambers) commanded.
        first: (n,) True where a trial begins.
        switch: see `Inputs.from_samples`.
    """
    at = steps(pressure, first)
    if "time_sent_s" in samples:
        return _sent(np.asarray(samples["time_sent_s"], dtype=float), time, pressure, first, at)
    share = np.full(len(at), math.nan)
    if switch is not None:
        share = np.broadcast_to(np.asarray(switch, dtype=float), len(time))[at]
    at, share = at[np.isfinite(share)], share[np.isfinite(share)]
    return at, share, pressure[at - 1], pressure[at]


def _sent(sent, time, pressure, first, steps):
    """Switches, from when the log says each command was sent.

    In a ramp a computer that is faster than the log sends commands that no row has; they lie between their
    neighbours, in time and height.
    """
    change = np.abs(np.diff(pressure, axis=0, prepend=pressure[:1])).max(axis=1)
    change[first] = 0.0
    ramp = (change > 0) & (np.r_[0.0, change[:-1]] > 0)
    held = np.union1d(steps, np.flatnonzero(ramp))
    tick = _tick(sent, time, ramp)
    none = np.zeros((0, pressure.shape[1]))
    parts = [(np.zeros(0, int), np.zeros(0), none, none)]
    gap = sent[held] - sent[held - 1]
    for back in range(_UNSEEN, -1, -1):
        instant = sent[held] - back * tick
        seen = (instant > sent[held - 1] + tick / 2) & (instant > time[held - 1]) & ramp[held]
        on = np.flatnonzero(seen | (back == 0))
        i = held[on]

        def command(at, i=i, gap=gap[on]):
            """Command (k, chambers) sent at these instants, (k,)."""
            share = np.where(ramp[i], 1 - (sent[i] - at) / gap, 1.0)
            return pressure[i - 1] + np.clip(share, 0, 1)[:, None] * (pressure[i] - pressure[i - 1])

        earlier = instant[on] - tick
        logged = ~ramp[i] | (earlier <= np.maximum(sent[i - 1] + tick / 2, time[i - 1]))
        before = np.where(logged[:, None], pressure[i - 1], command(earlier))
        share = (instant[on] - time[i - 1]) / (time[i] - time[i - 1])
        parts.append((i, share, before, command(instant[on])))
    at, share, before, after = (np.concatenate(x) for x in zip(*parts, strict=True))
    order = np.lexsort((share, at))
    return at[order], share[order], before[order], after[order]


def _tick(sent: np.ndarray, time: np.ndarray, ramp: np.ndarray) -> float:
    """Seconds from command to command: of a loop that logs each one, or of a separate computer.

    With a separate computer a sample finds the last command at any age up to that; in a loop all are of one
    age.
    """
    if not ramp.any():
        return 1.0  # no ramp, so none unseen
    rows = np.flatnonzero(ramp)
    gap = sent[rows] - sent[rows - 1]
    low, high = np.quantile((time - sent)[rows], (0.02, 0.98))
    if high - low < 0.2 * np.median(gap):
        return float(np.median(gap))
    return float(np.median(gap / np.maximum(np.round(gap / (high - low)), 1)))
