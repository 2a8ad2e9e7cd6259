"""Was a session mounted differently? Asked of the error itself, over whole pieces of time."""

from collections.abc import Iterator
from functools import cached_property

import numpy as np

from pneutac_datasets.recording.memory import STARTS, Memory, history, regress, static_columns
from pneutac_datasets.recording.motion import Motion
from pneutac_datasets.recording.recording import Recording

LEFT = 0.5  # of the error, which a motion may leave
PIECES, FINE = 8, 64  # of a trial: for the bootstrap, and to deal into two folds
ASTRAY = 3.0  # times the error of a static map that a motion may lie from that of the map
MOST_ROWS = 2000  # to fit memory by
DRAWS, SURE = 400, 0.01
AGAINST = 0.25  # of the first mount's slope: the least by which one that is turned round moves the other way
ROUNDS = 6  # of fitting map and motion in turn


def pressure(recording: Recording) -> np.ndarray:
    """(n, chambers) kPa, measured where it was logged."""
    measured = [c.replace("cmd_", "") for c in recording.pressure_columns]
    names = measured if all(map(recording.has, measured)) else recording.pressure_columns
    return recording.samples[names].to_numpy(float)


class Bench:
    """What all cases of a recording share.

    Attributes:
        y: headline (n, k).
        p: pressures (n, inputs), also of neighbouring devices, of the order of 1.
        own: (inputs,) mask of the device's own chambers; a neighbour's push, but leave no memory in it.
        static: (n, m) columns of a static map.
        trials: trial number to rows.
        train: (n,) mask.
        turns: whether `y` are points of space.
    """

    def __init__(self, recording: Recording, columns: list[str], train: np.ndarray):
        own = {*recording.pressure_columns, *(c.replace("cmd_", "") for c in recording.pressure_columns)}
        others = [c for c in recording.samples if c.endswith("_kpa") and c not in own]  # another segment's
        p = np.c_[pressure(recording), recording.samples[others].to_numpy(float)]
        self.own = np.arange(p.shape[1]) < p.shape[1] - len(others)
        self.p = p / max(float(np.abs(p).max()), 1e-9)
        self.y = recording.samples[columns].to_numpy(float)
        self.static, self.trials, self.train = static_columns(self.p), recording.trials(), train
        self.turns = columns[0].startswith("tip_") and len(columns) > 1
        self._recording = recording

    @cached_property
    def past(self) -> list[np.ndarray]:
        """(j, n, chambers) for each way in which trials may begin."""
        return [history(self._recording, self.p, start) * self.own for start in STARTS]


class Case:
    """One session against trials of the first mount.

    Args:
        bench: the recording.
        alike: trials of the first mount.
        session: trials that were perhaps mounted otherwise.

    Attributes:
        error: distance from a map of the first mount, as measured and moved, on rows that were not used to
            fit the motion; after `sure`.
    """

    def __init__(self, bench: Bench, alike: list[int], session: list[int]):
        self._bench = bench
        there, here = (self._rows(trials) for trials in (alike, session))
        low, high = (f(bench.p[there], axis=0, initial=w) for f, w in ((np.min, np.inf), (np.max, -np.inf)))
        here = here[((bench.p[here] >= low) & (bench.p[here] <= high)).all(1)]
        few = 3 * bench.static.shape[1]
        self._enough = min(len(here), len(there)) >= few
        every = max(1, (len(here) + len(there)) // MOST_ROWS)
        self._rows_of = np.r_[there[::every], here[::every]]
        self._here = np.arange(len(self._rows_of)) >= len(there[::every])
        self._y, self._static = bench.y[self._rows_of], bench.static[self._rows_of]
        piece = self._pieces()
        self._piece = piece // (FINE // PIECES)
        self._late, self._odd = piece % FINE >= FINE // 2, piece % 2 == 1
        self.error = (np.nan, np.nan)

    def sure(self) -> bool:
        """Whether a motion significantly removes most of the error, early and late, memory included.

        No memory turns the way round in which pressure bends a device.
        """
        if not self._enough:
            return False
        before, after = self._by_halves()
        self.error = tuple(float(np.sqrt(e[self._here].mean())) for e in (before, after))
        if not self._falls(before, after, self._here):
            return False
        return self._reversed() or self._falls(*self._beside_memory(), np.ones(len(self._y), bool))

    def _reversed(self) -> bool:
        """Whether its own pressures move it against the first mount's way, early and late in its trials."""

        def slope(rows: np.ndarray) -> np.ndarray:
            design = np.c_[np.ones(rows.sum()), self._bench.p[self._rows_of][rows]]
            kept = np.r_[True, np.ptp(design[:, 1:], axis=0) > 0]
            out = np.zeros((design.shape[1], self._y.shape[1]))
            out[kept] = np.linalg.lstsq(design[:, kept], self._y[rows], rcond=None)[0]
            return out[1:][self._bench.own]

        there = slope(~self._here)
        return all(
            (there * slope(self._here & half)).sum() < -AGAINST * (there**2).sum()
            for half in (self._late, ~self._late)
        )

    def motions(self) -> tuple[Motion, Motion]:
        """Motions onto the first mount: by the static map, and one with memory where that is significant."""
        everything, goal = np.ones(len(self._y), bool), self._goal()
        static = self._fit_motion(self._y, goal, self._here)
        y = np.where(self._here[:, None], static(self._y), self._y)
        error = ((y - goal) ** 2).sum(1)
        found = (self._learn(past, everything, True) for past in self._past())
        left, motion = min(found, key=lambda f: f[0].mean())
        away = ((motion(self._y) - y)[self._here] ** 2).sum(1).mean()
        # memory may excuse no more than it explains
        near = away < ASTRAY**2 * max(error[self._here].mean(), error[~self._here].mean())
        return static, motion if near and self._falls(error, left, everything) else static

    def halves(self, motion: Motion) -> bool:
        """Whether a motion significantly halves the distance from the first mount, or more."""
        if not self._enough:
            return False
        goal = self._goal()
        before, after = (((y - goal) ** 2).sum(1) for y in (self._y, motion(self._y)))
        return self._falls(before, after, self._here)

    def reach(self, motion: Motion) -> float:
        """How far a motion brings the session's samples, root mean square."""
        p = self._y[self._here]
        return float(np.sqrt(((motion(p) - p) ** 2).sum(1).mean()))

    def _rows(self, trials: list[int]) -> np.ndarray:
        """Numbers of the training rows of these trials."""
        rows = [np.arange(r.start, r.stop) for t, r in self._bench.trials.items() if t in trials]
        rows = np.concatenate([np.zeros(0, int), *rows])
        return rows[self._bench.train[rows]]

    def _pieces(self) -> np.ndarray:
        """Number of a piece for each row; every trial is cut into `FINE` in order."""
        fine = np.zeros(len(self._rows_of), int)
        for i, at in enumerate(self._bench.trials.values()):
            chosen = (self._rows_of >= at.start) & (self._rows_of < at.stop)
            fine[chosen] = FINE * i + FINE * np.arange(chosen.sum()) // max(chosen.sum(), 1)
        return fine

    def _goal(self, rows: np.ndarray | None = None) -> np.ndarray:
        """Where the pressures bring the device on the first mount (n, k), by a smooth map of its rows."""
        there = ~self._here if rows is None else ~self._here & rows
        return self._static @ regress(self._static[there], self._y[there])

    def _fit_motion(self, y: np.ndarray, goal: np.ndarray, rows: np.ndarray) -> Motion:
        return Motion.fit(y[rows], goal[rows], self._bench.turns)

    def _by_halves(self) -> tuple[np.ndarray, np.ndarray]:
        """Squared distance (n,) from the map of the other trials, as measured and moved.

        The early halves of the trials are moved by the fit to their late halves, and vice versa: what
        fades within a trial is not the mount.
        """
        goal = self._goal()
        before = ((self._y - goal) ** 2).sum(1)
        after = before.copy()
        for half in (self._late, ~self._late):
            motion = self._fit_motion(self._y, goal, self._here & half)
            judged = self._here & ~half
            after[judged] = ((motion(self._y) - goal) ** 2).sum(1)[judged]
        return before, after

    def _beside_memory(self) -> tuple[np.ndarray, np.ndarray]:
        """Squared distance (n,) from a map of both mounts with memory, as measured and moved.

        A point of space that leaves its path was not moved by pressure; so besides memory a zero and a gain
        of the pressure that are the session's own may explain it. One coordinate cannot separate them from a
        mount.
        """
        before, after = np.empty(len(self._y)), np.empty(len(self._y))
        for told in (self._odd, ~self._odd):
            for out, moves in ((before, False), (after, True)):
                found = [self._learn(past, told, moves) for past in self._past()]
                if self._bench.turns:
                    found += [self._learn(self._own(past), told, moves) for past in self._past()]
                out[~told] = min(found, key=lambda f: f[0][told].mean())[0][~told]
        return before, after

    def _past(self) -> Iterator[np.ndarray]:
        return (past[:, self._rows_of] for past in self._bench.past)

    def _own(self, past: np.ndarray) -> np.ndarray:
        """With a zero and a gain of the session's own."""
        p = self._bench.p[self._rows_of]
        here = self._here[:, None] * self._bench.own + 0 * p
        return np.concatenate([past, [here, here * p]])

    def _learn(self, past: np.ndarray, told: np.ndarray, moves: bool) -> tuple[np.ndarray, Motion]:
        """Squared distance (n,) from a map with memory fitted to some rows, and the motion that it allows."""
        memory = Memory(self._bench.p[self._rows_of], past)
        motion = Motion.fit(self._y, self._y, False)
        if moves:
            motion = self._fit_motion(self._y, self._goal(told), self._here & told)
        for _ in range(ROUNDS):
            y = np.where(self._here[:, None], motion(self._y), self._y)
            small = motion.small(y, self._here, self._bench.turns)
            goal, step = memory.round(y, told, small if moves else small[..., :0])
            motion = motion.then(step) if moves else motion
        y = np.where(self._here[:, None], motion(self._y), self._y)
        return ((y - goal) ** 2).sum(1), motion

    def _falls(self, before: np.ndarray, after: np.ndarray, rows: np.ndarray) -> bool:
        """Whether the error at least halves, significantly: paired bootstrap over the pieces of trials."""
        here = self._here
        weight = np.where(here, 1 / here.sum(), 1 / (~here).sum())  # one mount counts as much as the other
        at = np.unique(self._piece[rows], return_inverse=True)[1]
        a, b = (np.bincount(at, (weight * e)[rows]) for e in (before, after))
        draws = np.random.default_rng(0).integers(len(a), size=(DRAWS, len(a)))
        sure = np.quantile((a - b)[draws].sum(1), SURE) > 0
        return bool(sure and b.sum() <= LEFT**2 * a.sum())
