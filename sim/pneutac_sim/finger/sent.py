"""When a computer that is faster than the log sent its commands, read off the commands themselves.

It sends at a pace of its own, so a row has a command of any age up to that. Where the command moves smoothly,
its values, row by row, are smooth at the instants of sending alone: at the times of the rows they jump by one
or two commands in turns. Pace and phase are those that make the third divided differences least.
"""

from functools import lru_cache

import numpy as np

ROWS, LEAST_ROWS = 60, 20  # of a window that has a phase of its own, and of the shortest one
MOST = 4.0  # commands a row, to which paces are tried
WINDOWS = 8  # by which the pace is found
PHASES = np.linspace(0, 1, 40, endpoint=False)
SMOOTHEST = 1e-4  # third differences, of the range, below which nothing is smoother,
LEVELS = 8  # or of the command's resolution: rounding alone makes up to four
BEATS = 2  # jumps of the age that a window must have
# Mean decimal logarithm by which third differences must shrink where every row has a jump, in all windows and
# in one that is read so
SURE, SURE_OF_WINDOW = -0.15, -0.05


def sent_times(time: np.ndarray, pressure: np.ndarray, first: np.ndarray) -> np.ndarray:
    """When the command of each row was sent, (n,) s; NaN where that cannot be read off.

    Args:
        time: of the rows, (n,) s.
        pressure: commanded, (n, chambers).
        first: (n,) True where a trial begins.
    """
    arrays = (np.ascontiguousarray(a).tobytes() for a in (time, pressure, first))
    return _sent_times(*arrays, pressure.shape[1])


@lru_cache(maxsize=16)
def _sent_times(time: bytes, pressure: bytes, first: bytes, chambers: int) -> np.ndarray:
    t, begins = np.frombuffer(time), np.flatnonzero(np.frombuffer(first, dtype=bool))
    p = np.frombuffer(pressure).reshape(len(t), chambers)
    out, span = np.full(len(t), np.nan), max(float(np.ptp(p)), 1e-12)
    windows = [
        slice(a, min(a + ROWS, end))
        for start, end in zip(begins, [*begins[1:], len(t)], strict=True)
        for a in range(start, end - LEAST_ROWS, ROWS)
    ]
    moves = lambda w: np.abs(np.diff(p[w], axis=0)) > 1e-9 * span  # noqa: E731 - more than rounding
    windows = [w for w in windows if moves(w).any(axis=1).mean() > 0.5]
    if len(windows) < WINDOWS:
        return out
    resolution = min(np.abs(np.diff(p[w], axis=0))[moves(w)].min() for w in windows)
    least = max(SMOOTHEST, LEVELS * resolution / span)
    row = float(np.median([(t[w][-1] - t[w][0]) / (len(t[w]) - 1) for w in windows]))
    travel = [np.ptp(p[w], axis=0).max() for w in windows]
    best = [windows[i] for i in np.argsort(travel)[len(windows) // 2 :]]
    best = [best[i] for i in np.linspace(0, len(best) - 1, WINDOWS).astype(int)]

    def gains(ticks: np.ndarray, phases: np.ndarray, w: slice) -> np.ndarray:
        """(ticks, phases) logarithm of what third differences become, read so.

        Of those at the rows' own times, or at even ones, as where a loop computes its commands.
        """
        own = t[w] - t[w.start]
        sent, even = _last(own, ticks[:, None, None], phases[:, None]), row * np.arange(len(own))
        moving = [c for c in p[w].T if np.ptp(c) > 0]
        rough = lambda x, c: np.log10(_third(x, c) * row**3 / span + least).mean(axis=-1)  # noqa: E731
        return np.mean([rough(sent, c) - min(rough(own, c), rough(even, c)) for c in moving], axis=0)

    def smoothest(a_row: np.ndarray, phases: np.ndarray) -> tuple[float, float]:
        """The best number of commands a row, and its gain."""
        gain = np.mean([gains(row / a_row, phases, w).min(axis=1) for w in best], axis=0)
        return float(a_row[gain.argmin()]), float(gain.min())

    apart = 0.2 / ROWS  # of a window's commands, a fifth of one at its end
    tried = np.arange(1, MOST, apart)
    beat = np.abs(tried - np.round(tried)) * ROWS  # jumps of the age in a window
    rough = smoothest(tried[beat > BEATS], PHASES[::2])[0]
    a_row, gain = smoothest(rough + apart * np.linspace(-1, 1, 11), PHASES)
    jumped = min(1.0, 4 * (a_row - 1))  # four rows see a jump
    if gain > SURE * jumped or abs(a_row - round(a_row)) * ROWS < BEATS + 2 * apart:  # or it is slower
        return out
    for w in windows:
        of_phase = gains(np.array([row / a_row]), PHASES, w)[0]
        if of_phase.min() < SURE_OF_WINDOW * jumped:
            out[w] = t[w.start] + _last(t[w] - t[w.start], row / a_row, PHASES[of_phase.argmin()])
    out.flags.writeable = False  # it is cached
    return out


def _last(time: np.ndarray, tick, phase) -> np.ndarray:
    """The last command at these times, of a computer that sends at `phase` of every tick."""
    return (np.floor(time / tick - phase + 1e-7) + phase) * tick


def _third(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Size of third divided differences along the last axis."""
    for k in (1, 2, 3):
        y = np.diff(y, axis=-1) / np.maximum(x[..., k:] - x[..., :-k], 1e-9)
    return np.abs(y)
