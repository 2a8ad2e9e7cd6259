"""Sessions that were mounted differently: a twin has one base, so such trials are moved onto the first one.

Where, under equal conditions, the same pressure brings the device elsewhere from one trial on, the device was
perhaps turned and shifted between trials, which says nothing about its physics; perhaps it remembers (creep,
softening), which does. So data are moved only where one rigid motion of a session (turn and shift of points,
shift of anything else) significantly removes most of the error, over whole pieces of time, and where the
history of the pressure cannot explain it as well. Every verb that weighs a twin against a recording looks at
it through `align_mounts`.
"""

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from pneutac_datasets.recording.noise import STARTS, Memory, headline, history, regress, static_columns
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.finger import quantities
from pneutac_sim.finger.inputs import other_pressures

LEAST_TURN = 0.003  # of the points' own weight: what speaks for no turn


@dataclass(frozen=True)
class Motion:
    """A rigid motion, `points @ turn.T + shift`."""

    turn: np.ndarray  # (k, k), the identity for what is no point of space
    shift: np.ndarray  # (k,)

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Moves (n, k)."""
        return points @ self.turn.T + self.shift

    @property
    def angle_deg(self) -> float:
        k = len(self.shift)
        cosine = (np.trace(self.turn) - k + 2) / 2
        return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))

    def then(self, step: np.ndarray) -> "Motion":
        """Moved on by a shift and a small turn, see `small`."""
        k = len(self.shift)
        turn = np.eye(k)
        if len(step) > k:
            axis = step[k:] if k == 3 else [0.0, 0.0, step[k]]
            turn = Rotation.from_rotvec(axis).as_matrix()[:k, :k]
        return Motion(turn @ self.turn, turn @ self.shift + step[:k])

    @staticmethod
    def small(points: np.ndarray, rows: np.ndarray, turns: bool) -> np.ndarray:
        """What a unit of shift along each axis, and of turn, adds to some of the points (n, k), (n, k, m)."""
        k = points.shape[1]
        moves = [np.tile(np.eye(k), (len(points), 1, 1))]
        if turns and k == 3:
            moves.append(np.stack([np.cross(axis, points) for axis in np.eye(3)], -1))
        elif turns:
            moves.append((points @ [[0.0, 1.0], [-1.0, 0.0]])[..., None])
        return np.concatenate(moves, -1) * rows[:, None, None]

    @classmethod
    def fit(cls, points: np.ndarray, goal: np.ndarray, turns: bool) -> "Motion":
        """Least squares from points (n, k) to their goals (n, k) (Kabsch 1976)."""
        a, b, turn = points.mean(0), goal.mean(0), np.eye(points.shape[1])
        if turns:
            both = (points - a).T @ (goal - b)
            # points near a plane leave a turn about it open: of equal turns the least
            u, _, vt = np.linalg.svd(both + LEAST_TURN * np.linalg.norm(both) * turn)
            mirror = np.ones(len(a))
            mirror[-1] = np.sign(np.linalg.det(vt.T @ u.T))
            turn = (vt.T * mirror) @ u.T
        return cls(turn, b - turn @ a)


LEFT = 0.5  # of the error, which a motion may leave
PIECES, FINE = 8, 64  # of a trial: for the bootstrap, and to deal into two folds
ASTRAY = 3.0  # times the error of a static map that a motion may lie from that of the map
MOST_ROWS = 2000  # to fit memory by
DRAWS, SIGNIFICANCE = 400, 0.01

ROUNDS = 6  # of fitting map and motion in turn


class Bench:
    """What all cases of a recording share.

    Attributes:
        y: headline (n, k).
        p: pressures (n, inputs), also of neighbouring devices, of the order of 1.
        own: (inputs,) mask of the device's own chambers; a neighbour's push, but leave no memory in it.
        static: (n, m) columns of a static map.
        turns: whether `y` are points of space.
    """

    def __init__(self, recording: Recording, columns: list[str], train: np.ndarray):
        others = other_pressures(recording.samples, recording.device)  # another segment's
        p = np.c_[recording.pressures, recording.samples[others].to_numpy(float)]
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
    """One session, of trials perhaps mounted otherwise, against the `first` trials of the first mount.

    Attributes:
        error: distance from a map of the first mount, as measured and moved, on rows that were not used to
            fit the motion; after `moved_significantly`.
    """

    def __init__(self, bench: Bench, first: list[int], session: list[int]):
        self._bench = bench
        there, here = (self._rows(trials) for trials in (first, session))
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

    def moved_significantly(self) -> bool:
        """Whether a motion significantly removes most of the error, early and late, memory included."""
        if not self._enough:
            return False
        before, after = self._by_halves()
        self.error = tuple(float(np.sqrt(e[self._here].mean())) for e in (before, after))
        if not self._falls(before, after, self._here):
            return False
        return self._falls(*self._with_memory(), np.ones(len(self._y), bool))

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

    def _with_memory(self) -> tuple[np.ndarray, np.ndarray]:
        """Squared distance (n,) from a map of both mounts with memory, as measured and moved.

        A point of space that leaves its path was not moved by pressure; so besides memory a zero and a gain
        of the pressure that are the session's own may explain it. One coordinate cannot separate them from a
        mount.
        """
        before, after = np.empty(len(self._y)), np.empty(len(self._y))
        for fitted in (self._odd, ~self._odd):
            for out, moves in ((before, False), (after, True)):
                found = [self._learn(past, fitted, moves) for past in self._past()]
                if self._bench.turns:
                    found += [self._learn(self._own(past), fitted, moves) for past in self._past()]
                out[~fitted] = min(found, key=lambda f: f[0][fitted].mean())[0][~fitted]
        return before, after

    def _past(self) -> Iterator[np.ndarray]:
        return (past[:, self._rows_of] for past in self._bench.past)

    def _own(self, past: np.ndarray) -> np.ndarray:
        """With a zero and a gain of the session's own."""
        p = self._bench.p[self._rows_of]
        here = self._here[:, None] * self._bench.own + 0 * p
        return np.concatenate([past, [here, here * p]])

    def _learn(self, past: np.ndarray, fitted: np.ndarray, moves: bool) -> tuple[np.ndarray, Motion]:
        """Squared distance (n,) from a map with memory fitted to some rows, and the motion that it allows."""
        memory = Memory(self._bench.p[self._rows_of], past)
        motion = Motion.fit(self._y, self._y, False)
        if moves:
            motion = self._fit_motion(self._y, self._goal(fitted), self._here & fitted)
        for _ in range(ROUNDS):
            y = np.where(self._here[:, None], motion(self._y), self._y)
            small = motion.small(y, self._here, self._bench.turns)
            goal, step = memory.round(y, fitted, small if moves else small[..., :0])
            motion = motion.then(step) if moves else motion
        y = np.where(self._here[:, None], motion(self._y), self._y)
        return ((y - goal) ** 2).sum(1), motion

    def _falls(self, before: np.ndarray, after: np.ndarray, rows: np.ndarray) -> bool:
        """Whether the error at least halves, significantly: paired bootstrap over the pieces of trials."""
        here = self._here
        weight = np.where(here, 1 / here.sum(), 1 / (~here).sum())  # one mount counts as much as the other
        return _halves((weight * before)[rows], (weight * after)[rows], self._piece[rows])


def _halves(before: np.ndarray, after: np.ndarray, piece: np.ndarray) -> bool:
    """Whether an error (n,) at least halves, significantly: squared errors, drawn by pieces of time."""
    at = np.unique(piece, return_inverse=True)[1]
    a, b = (np.bincount(at, e) for e in (before, after))
    draws = np.random.default_rng(0).integers(len(a), size=(DRAWS, len(a)))
    significant = np.quantile((a - b)[draws].sum(1), SIGNIFICANCE) > 0
    return bool(significant and b.sum() <= LEFT**2 * a.sum())


FAR = 0.05  # of the device's length: the least distance that is looked into
FAR_OF_MODEL = 0.025  # the same where a fitted model says so: it leaves less than half of what a map leaves
TURNED_DEG = 45.0
SWEEP = 0.3  # of the whole pressure range that a trial must cover to fit its rest and direction
CONDITIONS = {"gravity_x": 0.1, "gravity_y": 0.1, "gravity_z": 0.1, "temperature_c": 2.0, "payload_g": 0.1}


def align_mounts(
    recording: Recording, length_mm: float, train: np.ndarray | None = None
) -> tuple[Recording, list[str]]:
    """Moves trials of a finger or arm with a significantly different mount onto the mount of the first one.

    Of tip coordinates the motion turns and shifts; angles, curvatures and a single coordinate are shifted.
    Samples of the mask `train` (n,), by default all, are judged and fitted by; the others are moved too.

    Returns:
        The recording, as it is where it has a single mount, and a sentence for each session that was moved.
    """
    columns, unit = headline(recording)
    train = np.ones(len(recording), bool) if train is None else train
    sweeps = _sweeps(recording, columns, train)
    far = FAR * length_mm / quantities.weight(unit, "mm", length_mm)
    order = list(sweeps)
    different = [t for t in order if _mounted_differently(sweeps[order[0]], sweeps[t], far)]
    if not different:
        return recording, []
    bench = Bench(recording, columns, train)
    first = order[: order.index(different[0])]  # later ones may be of any mount
    begun = _begun(recording)
    others = [t for t in bench.trials if t not in first and _same(begun, first[0], t)]
    motions: dict[int, Motion] = {}
    sentences = []
    for session in _runs(sweeps, order, different, far):
        case = Case(bench, first, [t for t in session if t not in motions])
        if case.moved_significantly():
            rough, motion = case.motions()
            opposite = _opposite(sweeps[order[0]], sweeps[session[0]])
            free = [t for t in others if t not in motions]
            free = [t for t in free if t not in sweeps or _opposite(sweeps[order[0]], sweeps[t]) == opposite]
            joined = [t for t in free if Case(bench, first, [t]).halves(rough)]
            motions |= dict.fromkeys(joined, motion)
            sentences += [_sentence(case, motion, first, joined, unit)] if joined else []
    return (moved(recording, columns, motions), sentences) if motions else (recording, [])


@dataclass(frozen=True)
class Remounted:
    """A trial's motion onto where a model places it, and how far that brings its samples."""

    motion: Motion
    reach: float


def remounted(
    recording: Recording,
    predicted: np.ndarray,
    own: np.ndarray,
    rows: np.ndarray,
    length_mm: float,
    known: Collection[int],
) -> dict[int, Remounted]:
    """Trials that were mounted elsewhere than a fitted model places them, with their motions onto it.

    Of a trial that is known to have been mounted differently the motion is fitted again. Any other must lie
    `FAR_OF_MODEL` away, under the conditions of the first one, and the motion that is fitted to its early
    half must significantly halve the error of its late half, and vice versa, although the trial may have a
    zero, a gain and a clock of its own.

    Args:
        recording: cleaned, of a finger or an arm.
        predicted: (n, D) of the model, the headline first.
        own: the same with the zero, the gain and the clock of each trial.
        rows: (n,) mask of samples to judge and fit by.
        length_mm: of the device.
        known: trials that were moved before.
    """
    columns, unit = headline(recording)
    turns = columns[0].startswith("tip_") and len(columns) > 1
    far = FAR_OF_MODEL * length_mm / quantities.weight(unit, "mm", length_mm)
    y, goal = recording.samples[columns].to_numpy(float), predicted[:, : len(columns)]
    begun, out = _begun(recording), {}
    for trial, at in recording.trials().items():
        mine = np.arange(at.start, at.stop)[rows[at]]
        if len(mine) < FINE or not _same(begun, next(iter(begun)), trial):
            continue
        a, b, of_own = y[mine], goal[mine], own[mine, : len(columns)]
        piece = np.arange(len(mine)) * PIECES // len(mine)
        late, before = piece >= PIECES // 2, ((a - of_own) ** 2).sum(1)
        after = {}  # by whether it turns: what a hold shows of a turn may be wrong elsewhere
        for turned in {False, turns}:
            after[turned] = before.copy()
            for half in (late, ~late):
                motion = Motion.fit(a[half], of_own[half], turned)
                after[turned][~half] = ((motion(a[~half]) - of_own[~half]) ** 2).sum(1)
        turned = min(after, key=lambda t: after[t].sum())
        motion = Motion.fit(a, b, turned)
        reach = float(np.sqrt(((motion(a) - a) ** 2).sum(1).mean()))
        if trial not in known and (reach < far or not _halves(before, after[turned], piece)):
            continue
        out[trial] = Remounted(motion, reach)
    return out


def moved(recording: Recording, columns: list[str], motions: dict[int, Motion]) -> Recording:
    """A recording with these columns of each of these trials moved."""
    samples, trials = recording.samples.copy(), recording.trials()
    for trial, motion in motions.items():
        rows = samples.index[trials[trial]]
        samples.loc[rows, columns] = motion(samples.loc[rows, columns].to_numpy(float))
    return replace(recording, samples=samples)


def _sweeps(recording: Recording, columns: list[str], train: np.ndarray) -> dict[int, np.ndarray]:
    """Trial to what a straight line in the pressures makes of it (1 + chambers, k): at rest, and per kPa.

    Of trials that cover enough of the pressures and have the conditions of the first such trial.
    """
    p = recording.pressures
    lowest, reach = p.min(0), np.ptp(p, axis=0).max()
    y = recording.samples[columns].to_numpy(float)
    found: dict[int, np.ndarray] = {}
    begun = _begun(recording)
    for trial, at in recording.trials().items() if columns else ():
        rows = np.arange(at.start, at.stop)[train[at]]
        if len(rows) < 2 or not np.ptp(p[rows], axis=0).max() > SWEEP * reach > 0:
            continue
        if _same(begun, next(iter(found), trial), trial):
            design = np.c_[np.ones(len(rows)), p[rows] - lowest]
            found[trial] = np.linalg.lstsq(design, y[rows], rcond=None)[0]
    return found


def _begun(recording: Recording) -> dict[int, np.ndarray]:
    """Trial to the conditions under which it began, in units of what still counts as equal."""
    names = [c for c in CONDITIONS if recording.has(c)]
    tolerances = np.array([CONDITIONS[c] for c in names])
    trials = recording.trials()
    rows = recording.samples[names].iloc[[at.start for at in trials.values()]].to_numpy(float)
    return dict(zip(trials, rows / tolerances, strict=True))


def _same(begun: dict[int, np.ndarray], a: int, b: int) -> bool:
    return bool((np.abs(begun[a] - begun[b]) <= 1 + 1e-12).all())


def _mounted_differently(a: np.ndarray, b: np.ndarray, far: float) -> bool:
    """Whether two trials lie far from each other at rest, or bend in other directions."""
    if np.linalg.norm(a[0] - b[0]) >= far:
        return True
    if a.shape[1] != 3:
        return False
    (ay, az), (by, bz) = a[1:, 1:].T, b[1:, 1:].T  # the straight finger lies along x
    if min((ay**2 + az**2).sum() / (a[1:] ** 2).sum(), (by**2 + bz**2).sum() / (b[1:] ** 2).sum()) < 0.25:
        return False
    roll = np.arctan2((ay * bz - az * by).sum(), (ay * by + az * bz).sum())
    return bool(abs(np.degrees(roll)) >= TURNED_DEG)


def _opposite(a: np.ndarray, b: np.ndarray) -> bool:
    return bool((a[1:] * b[1:]).sum() < 0)


def _runs(
    sweeps: dict[int, np.ndarray], order: list[int], different: list[int], far: float
) -> list[list[int]]:
    """Trials that differ from the first one, in runs whose trials are similar."""
    runs: list[list[int]] = []
    for before, trial in zip([None, *order], order, strict=False):
        if trial in different:
            if before not in different or _mounted_differently(sweeps[runs[-1][0]], sweeps[trial], far):
                runs.append([])
            runs[-1].append(trial)
    return runs


def _sentence(case: Case, motion: Motion, first: list[int], again: list[int], unit: str) -> str:
    turns = len(motion.shift) > 1 and unit == "mm"
    how = f"turned by {motion.angle_deg:.0f} degrees and shifted" if turns else "shifted"
    far, (before, after) = case.reach(motion), case.error
    return (
        f"The device was mounted differently in {trials_named(again)}: at equal pressures it is {far:.3g} "
        f"{unit} away from {trials_named(first)}, early and late in a trial, and no memory effect explains "
        f"that. Data of {trials_named(again)} are {how} onto the first mount. On rows that were not used to "
        f"fit the motion this reduces the distance from {before:.3g} to {after:.3g} {unit}."
    )


def trials_named(numbers: list[int]) -> str:
    """Names of trials: `trial 3`, `trials 3 to 5 and 8`."""
    runs = np.split(numbers, np.flatnonzero(np.diff(numbers) != 1) + 1)
    items = [x for r in runs for x in ([f"{r[0]} to {r[-1]}"] if len(r) > 2 else map(str, r))]
    *first, last = items
    return f"trial{'s' * (len(numbers) > 1)} {', '.join(first)}{' and ' * bool(first)}{last}"
