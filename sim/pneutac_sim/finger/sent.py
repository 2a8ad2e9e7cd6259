"""When a computer that is faster than the log sent its commands, read off the commands themselves.

It sends at a pace of its own, so a row has a command of any age up to that. Where the command moves smoothly,
its values, row by row, are smooth at the instants of sending alone: at the times of the rows they jump by one
or two commands in turns. Pace and phase are those that make the third divided differences least. A pace that
is nearly that of the rows, or twice it, shows in few rows, but these come at equal distances.
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
COHERENT = 0.9  # mean length of the phases' vectors, above which a trial has one phase
# Rows from jump to jump of a pace that is nearly a whole number of commands a row, which are tried; how many
# jumps must shrink a decimal logarithm by how much, and how many times as much as any other distance does
SELDOM, LEAST_JUMPS, SPEAKS, CLEAR = (28.0, 300.0), 10, 0.2, 1.3
_NEAR = 20  # tried distances that are nearly the same
_WHOLE = (
    (1, 2.0),
    (2, 1.5),
    (2, 0.5),
)  # commands a row, and the time of a row with one more or less, in rows


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
    out.flags.writeable = False  # it is cached
    trials = [slice(a, b) for a, b in zip(begins, [*begins[1:], len(t)], strict=True)]
    moves = lambda w: np.abs(np.diff(p[w], axis=0)) > 1e-9 * span  # noqa: E731 - more than rounding
    in_motion = lambda parts: [w for w in parts if moves(w).any(axis=1).mean() > 0.5]  # noqa: E731
    windows = in_motion(
        slice(a, min(a + ROWS, w.stop)) for w in trials for a in range(w.start, w.stop - LEAST_ROWS, ROWS)
    )
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
    jumped, phases = min(1.0, 4 * (a_row - 1)), PHASES  # four rows see a jump
    nearer = apart * np.linspace(-1, 1, 201)
    if gain > SURE * jumped or abs(a_row - round(a_row)) * ROWS < BEATS + 2 * apart:
        windows = in_motion(w for w in trials if w.stop - w.start > LEAST_ROWS)
        a_row = _nearly_whole([p[w] / span for w in windows], least) if windows else None
        if a_row is None:
            return out  # or it is slower
        seldom = abs(a_row - round(a_row))
        jumped, phases, nearer = 4 * seldom, np.arange(0, 1, seldom / 2), np.zeros(1)  # jumps to half a row
    read = []  # windows, an instant of a command near their middle, and how much they show it
    for w in windows:
        of_phase = gains(np.array([row / a_row]), phases, w)[0]
        if of_phase.min() < SURE_OF_WINDOW * jumped:
            middle = np.round((t[w][-1] - t[w.start]) / 2 * a_row / row)
            at = t[w.start] + (middle + phases[of_phase.argmin()]) * row / a_row
            read.append((w, at, -of_phase.min()))
    if len(read) < len(windows) / 2:
        return out
    together = [[r for r in read if trial.start <= r[0].start < trial.stop] for trial in trials]
    ticks = row / (a_row + nearer)
    tick = ticks[sum(abs(_sum(r, ticks)) for r in together).argmax()]
    out = out.copy()
    for trial, r in zip(trials, together, strict=True):
        total = _sum(r, tick)
        if r and abs(total) > COHERENT * sum(weight for *_, weight in r):
            r = [(trial, np.angle(total) / (2 * np.pi) * tick, 0)]
        for w, at, _ in r:
            out[w] = at + np.floor((t[w] - at) / tick + 1e-7) * tick
    out.flags.writeable = False
    return out


def _sum(read: list, tick: np.ndarray) -> np.ndarray:
    """Sums of vectors whose angles are the phases of instants, for each tick."""
    return sum((weight * np.exp(2j * np.pi * at / tick) for _, at, weight in read), np.zeros(np.shape(tick)))


def _nearly_whole(commands: list[np.ndarray], least: float) -> float | None:
    """Commands a row where that is nearly one or two, of parts (rows, chambers); None where it is not.

    Every so many rows one has a command more, or less, than all others.
    """
    shows = [np.stack([_of_jump(c, spacing, least) for _, spacing in _WHOLE]) for c in commands]
    step = 0.4 / max(s.shape[1] for s in shows)  # half a row at the end
    tried = np.exp(np.arange(*np.log(SELDOM), step))
    seen = [np.concatenate([_most(s, apart) for s in shows], axis=1) for apart in tried]
    total = np.array([s.sum(axis=1) for s in seen])  # (tried, kinds)
    best, kind = np.unravel_index(total.argmin(), total.shape)
    others = np.delete(total, slice(max(best - _NEAR, 0), best + _NEAR + 1), axis=0)
    speak = (seen[best][kind] < -SPEAKS).sum()
    if speak < LEAST_JUMPS or total[best, kind] > CLEAR * others.min():
        return None
    whole, spacing = _WHOLE[kind]
    return float(whole + np.sign(spacing - 1) / tried[best])


def _of_jump(command: np.ndarray, spacing: float, least: float) -> np.ndarray:
    """(rows,) logarithm of what third differences become if so much time, in rows, passed before one row."""
    out, even = np.zeros(len(command)), np.arange(4.0)
    for c in command.T:
        four = np.lib.stride_tricks.sliding_window_view(c, 4)
        rough = lambda x, four=four: np.log10(_third(x, four)[:, 0] + least)  # noqa: E731
        for k in (1, 2, 3):
            out[k : len(out) - 3 + k] += rough(even + (spacing - 1) * (even >= k)) - rough(even)
    return out / max((np.ptp(command, axis=0) > 0).sum(), 1)


def _most(shows: np.ndarray, apart: float) -> np.ndarray:
    """(kinds, jumps) of rows so far apart, those that show most."""
    n = shows.shape[1]
    rows = (np.arange(int(apart))[:, None] + np.arange(n / apart) * apart).astype(int)
    seen = np.where(rows < n, shows[:, np.minimum(rows, n - 1)], 0.0)
    best = seen.sum(axis=2).argmin(axis=1)
    return seen[np.arange(len(shows)), best]


def _last(time: np.ndarray, tick, phase) -> np.ndarray:
    """The last command at these times, of a computer that sends at `phase` of every tick."""
    return (np.floor(time / tick - phase + 1e-7) + phase) * tick


def _third(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Size of third divided differences along the last axis."""
    for k in (1, 2, 3):
        y = np.diff(y, axis=-1) / np.maximum(x[..., k:] - x[..., :-k], 1e-9)
    return np.abs(y)
