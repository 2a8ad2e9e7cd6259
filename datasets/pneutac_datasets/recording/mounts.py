"""Sessions that were mounted differently: a twin has one base, so such trials are moved onto the first one.

Where, under equal conditions, the same pressure brings the device elsewhere from one trial on, the device was
perhaps turned and shifted between trials, which says nothing about its physics; perhaps it remembers (creep,
softening), which does. So data are moved only where one rigid motion (turn and shift of points, shift of
anything else), fitted to one half of each trial, significantly removes most of the error of the other half,
and more than the history of the pressure explains. Every verb that weighs a twin against a recording looks at
it through `align_mounts`; a fitted model places trials by the same test, see `remounted`.
"""

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from pneutac_datasets.recording.noise import headline, regress, static_columns
from pneutac_datasets.recording.recording import GRAVITY, Recording
from pneutac_sim.finger import quantities
from pneutac_sim.finger.inputs import other_pressures

FAR = 0.05  # of the device's length: the least distance that is looked into
FAR_OF_MODEL = 0.025  # the same where a fitted model says so: it leaves less than half of what a map leaves
LEAST_TURN = 0.003  # of the points' own weight: what speaks for no turn
LEFT = 0.5  # of the error, which a motion may leave
LEFT_OF_MEMORY = 0.7  # of the error that memory leaves
PIECES, FINE = 8, 64  # of a trial's rows: for its halves and the bootstrap, and to deal into two folds
DRAWS, SIGNIFICANCE = 400, 0.01
EQUAL = 0.05  # of the largest pressure: pressures that differ by less are compared
LEAST_ROWS = 64  # of a trial, to place it by a model
MOST_ROWS = 2000  # to fit memory by
CONDITIONS = dict.fromkeys(GRAVITY, 0.1) | {"temperature_c": 2.0, "payload_g": 0.1}


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
    def small(points: np.ndarray, turns: bool) -> np.ndarray:
        """What a unit of shift along each axis, and of turn, adds to points (n, k): (n, k, m)."""
        n, k = points.shape
        moves = [np.tile(np.eye(k), (n, 1, 1))]
        if turns and k == 3:
            moves.append(np.stack([np.cross(axis, points) for axis in np.eye(3)], -1))
        elif turns:
            moves.append((points @ [[0.0, 1.0], [-1.0, 0.0]])[..., None])
        return np.concatenate(moves, -1)

    def reach(self, points: np.ndarray) -> float:
        """How far it brings points (n, k), root mean square."""
        return float(np.sqrt(((self(points) - points) ** 2).sum(1).mean()))

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


def moved_error(points: np.ndarray, goal: np.ndarray, late: np.ndarray, turns: bool) -> np.ndarray:
    """Squared distances (n,) of points from their goals (n, k), each half moved as the other half asks.

    What fades within a trial is not the mount: `late` (n,) is the second half of each.
    """
    out = ((points - goal) ** 2).sum(1)
    for half in (late, ~late):
        if half.any():
            motion = Motion.fit(points[half], goal[half], turns)
            out[~half] = ((motion(points[~half]) - goal[~half]) ** 2).sum(1)
    return out


def falls(before: np.ndarray, after: np.ndarray, piece: np.ndarray, left: float = LEFT) -> bool:
    """Whether an error falls significantly, to a share `left` of it or less.

    Squared errors (n,) are drawn by pieces of time (n,).
    """
    at = np.unique(piece, return_inverse=True)[1]
    a, b = (np.bincount(at, e) for e in (before, after))
    draws = np.random.default_rng(0).integers(len(a), size=(DRAWS, len(a)))
    significant = np.quantile((a - b)[draws].sum(1), SIGNIFICANCE) > 0
    return bool(significant and b.sum() <= left**2 * a.sum())


# ---------------------------------------------------------------- memory

TIMES_S = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0)
STARTS = ("held", "vented", "carried")
WEIGHTS = (-0.5, 2.0)  # of a history besides the pressure itself; creep beyond twice its start is unheard of
DAMPING, TINY = 1e-4, 1e-4
ROUNDS = 6  # of Gauss and Newton


def history(recording: Recording, p: np.ndarray, start: str) -> np.ndarray:
    """(j, n, chambers): lags of the pressure over 0.1 s to minutes, its largest value yet, and drift.

    Trials start `held` at their first pressure for ever, `vented` for ever, or `carried` on from where the
    trial before ended, after its pause where that is known.
    """
    time, begun = recording.column("time_s"), recording.starts
    tau = np.array(TIMES_S)[:, None]
    lags, state = np.empty((len(tau), *p.shape)), np.zeros((len(tau), p.shape[1]))
    for trial, rows in recording.trials().items():
        if start == "carried":
            state = state * np.exp(-(begun[trial].pause_s or 0.0) / tau)
        else:
            state = np.zeros_like(state) + (p[rows.start] if start == "held" else 0.0)
        keep = np.exp(-np.diff(time[rows], prepend=time[rows.start])[:, None, None] / tau)
        for i, k in enumerate(keep, rows.start):
            state = k * state + (1 - k) * p[i]
            lags[:, i] = state
    done = np.linspace(0, 1, len(p))[:, None] + 0 * p
    return np.stack([*lags, np.maximum.accumulate(p), done, done * p])


def remembered(
    p: np.ndarray,
    past: np.ndarray,
    y: np.ndarray,
    fitted: np.ndarray,
    motion: Motion | None = None,
    new: slice = slice(0),
    turns: bool = False,
) -> tuple[np.ndarray, Motion | None]:
    """Squared distances (n,) of points y (n, k) from what pressure and its history explain of them.

    That is f(u), u = p + sum_j w_j past_j, with a polynomial f and `past` (j, n, chambers), by the rows
    `fitted` (n,). Creep, slow air, softening and a drifting gauge all move the device along the path on which
    pressure moves it, and so does this model; a mount that was turned need not. Of the rows `new` a motion is
    fitted along where one is given, by Gauss and Newton's steps.
    """
    weight, given = np.zeros(len(past)), y
    for turn in range(ROUNDS + 1):
        if motion:
            y = np.concatenate([given[: new.start], motion(given[new])])
        u = p + np.tensordot(weight, past, 1)
        columns = static_columns(u)
        bend = regress(columns[fitted], y[fitted])
        left = y - columns @ bend
        if turn == ROUNDS:
            break
        slopes = [(static_columns(u + TINY * h) - columns) @ bend / TINY for h in past]
        if motion:
            moves = Motion.small(y, turns)
            moves[: new.start] = 0
            slopes += list(np.moveaxis(-moves, -1, 0))
        slopes = np.stack(slopes, -1)[fitted]
        # the map gives way to weights and moves, so what it takes of them is taken off
        basis = np.linalg.qr(columns[fitted])[0]
        slopes -= np.einsum("nb,bkm->nkm", basis, np.einsum("nb,nkm->bkm", basis, slopes))
        a, b = slopes.reshape(-1, slopes.shape[-1]), left[fitted].ravel()
        gram = a.T @ a
        step = np.linalg.solve(gram + np.diag(DAMPING * gram.diagonal() + 1e-9), a.T @ b)
        weight = np.clip(weight + step[: len(past)], *WEIGHTS)
        motion = motion and motion.then(step[len(past) :])
    return (left**2).sum(1), motion


# ---------------------------------------------------------------- by a map of the pressure


class Bench:
    """A recording whose trials are compared by a smooth map of the pressure; `train` (n,) are its rows."""

    def __init__(self, recording: Recording, columns: list[str], train: np.ndarray):
        others = other_pressures(recording.samples, recording.device)  # another segment's
        p = np.c_[recording.pressures, recording.samples[others].to_numpy(float)]
        self._own = np.arange(p.shape[1]) < p.shape[1] - len(others)  # a neighbour's push leaves no memory
        self._p = p / max(float(np.abs(p).max()), 1e-9)
        self._y = recording.samples[columns].to_numpy(float)
        self._static, self._recording, self._train = static_columns(self._p), recording, train
        self._turns = columns[0].startswith("tip_") and len(columns) > 1
        self._trial = recording.column("trial")

    def _pieces(self, rows: np.ndarray, pieces: int = PIECES) -> np.ndarray:
        """Numbers (m,) of pieces of time; of each trial these rows (m,) are cut into `pieces`."""
        _, trial, n = np.unique(self._trial[rows], return_inverse=True, return_counts=True)
        within = np.empty(len(rows), int)
        within[np.argsort(trial, kind="stable")] = np.concatenate([np.arange(k) for k in n])
        return pieces * trial + pieces * within // n[trial]

    @cached_property
    def _past(self) -> list[np.ndarray]:
        """(j, n, chambers) for each way in which trials may begin."""
        return [history(self._recording, self._p, start) * self._own for start in STARTS]

    def far_away(self, first: list[int], trial: int, far: float) -> Motion | None:
        """The motion of a trial onto a map of the first ones, where that brings it as far as this."""
        here, goal = self._compared(first, [trial])[1:]
        motion = Motion.fit(self._y[here], goal, self._turns) if len(here) else None
        return motion if motion and motion.reach(self._y[here]) >= far else None

    def is_of(self, motion: Motion, first: list[int], trial: int) -> bool:
        """Whether the motion of another session significantly halves the distance of a trial, too."""
        here, goal = self._compared(first, [trial])[1:]
        y = self._y[here]
        before, after = (((points - goal) ** 2).sum(1) for points in (y, motion(y)))
        return len(here) > 0 and falls(before, after, self._pieces(here))

    def sentence(self, motion: Motion, first: list[int], session: list[int], unit: str) -> str:
        here, goal = self._compared(first, session)[1:]
        before, after = (float(np.sqrt(e.mean())) for e in self._errors(here, goal))
        again, far = trials_named(session), motion.reach(self._y[here])
        turns = self._turns and unit == "mm"
        how = f"turned by {motion.angle_deg:.0f} degrees and shifted" if turns else "shifted"
        return (
            f"The device was mounted differently in {again}: at equal pressures it is {far:.3g} {unit} away "
            f"from {trials_named(first)}, early and late in a trial, and no memory effect explains that. "
            f"Data of {again} are {how} onto the first mount. On rows that were not used to fit the motion "
            f"this reduces the distance from {before:.3g} to {after:.3g} {unit}."
        )

    def _errors(self, rows: np.ndarray, goal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Squared distances (m,) of rows (m,) from their goals (m, k), as measured and moved."""
        y, late = self._y[rows], self._pieces(rows) % PIECES >= PIECES // 2
        return ((y - goal) ** 2).sum(1), moved_error(y, goal, late, self._turns)

    def _compared(self, first: list[int], session: list[int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rows of both, the session's at pressures of the first, and where the first would be there.

        Few holds of several pressures leave most of the range between them open, where the map is anything.
        None of the session's where there are too few to compare.
        """
        there, here = (np.flatnonzero(np.isin(self._trial, t) & self._train) for t in (first, session))
        seen = KDTree(np.unique(self._p[there], axis=0))
        here = here[seen.query(self._p[here], p=np.inf)[0] <= EQUAL]
        if min(len(here), len(there)) < 3 * self._static.shape[1]:
            return there, here[:0], self._y[:0]
        return there, here, self._static[here] @ regress(self._static[there], self._y[there])

    def mounted(self, first: list[int], session: list[int]) -> Motion | None:
        """The motion of a session, where it halves the distance and explains more than memory without it.

        A point of space that leaves its path was not moved by pressure; so without it also a gain and a zero
        of the pressure that are the session's own may explain it. One coordinate cannot separate a zero from
        a mount.
        """
        there, here, goal = self._compared(first, session)
        if not len(here) or not falls(*self._errors(here, goal), self._pieces(here)):
            return None
        every = max(1, (len(there) + len(here)) // MOST_ROWS)
        rows, new = np.r_[there[::every], here[::every]], slice(len(there[::every]), None)
        p, y, static, moves = self._p[rows], self._y[rows], self._static[rows], np.isin(rows, here)
        mine = self._own * moves[:, None]
        own = [mine * p, mine + 0 * p][: 1 + self._turns]
        pasts = [x[:, rows] for x in self._past]
        unmoved = [*pasts, *(np.concatenate([x, own]) for x in pasts)]

        def best(fitted: np.ndarray) -> tuple[np.ndarray, np.ndarray, Motion | None]:
            """Squared distances (n,) unmoved and moved, and the motion, of what fits these rows best."""
            old, again = fitted & ~moves, fitted & moves
            motion = Motion.fit(y[again], static[again] @ regress(static[old], y[old]), self._turns)
            less = min((remembered(p, x, y, fitted)[0] for x in unmoved), key=lambda e: e[fitted].mean())
            found = (remembered(p, x, y, fitted, motion, new, self._turns) for x in pasts)
            more, motion = min(found, key=lambda f: f[0][fitted].mean())
            return less, more, motion

        odd = self._pieces(rows, FINE) % 2 == 1
        before, after = np.where(odd, best(~odd)[:2], best(odd)[:2])  # each fold by what fits the other
        weight = np.where(moves, 1 / moves.sum(), 1 / new.start)  # one mount counts as much as the other
        if falls(weight * before, weight * after, self._pieces(rows), LEFT_OF_MEMORY):
            return best(np.ones(len(rows), bool))[2]
        return None


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
    if not columns:
        return recording, []
    bench = Bench(recording, columns, np.ones(len(recording), bool) if train is None else train)
    far = FAR * length_mm / quantities.weight(unit, "mm", length_mm)
    begun = _begun(recording)
    start, *trials = (t for t in begun if _same(begun, next(iter(begun)), t))
    first, others = [start], []
    for trial in trials:  # from the first that lies far away on they may be of any mount
        (others if others or bench.far_away(first, trial, far) else first).append(trial)
    motions: dict[int, Motion] = {}
    sentences = []
    for trial in others:
        rough = None if trial in motions else bench.far_away(first, trial, far)
        if rough is None:
            continue
        session = [t for t in others if t not in motions and (t == trial or bench.is_of(rough, first, t))]
        if motion := bench.mounted(first, session):
            motions |= dict.fromkeys(session, motion)
            sentences.append(bench.sentence(motion, first, session, unit))
    return (moved(recording, columns, motions), sentences) if motions else (recording, [])


# ---------------------------------------------------------------- by a fitted model


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
        if len(mine) < LEAST_ROWS or not _same(begun, next(iter(begun)), trial):
            continue
        a, of_own = y[mine], own[mine, : len(columns)]
        piece = np.arange(len(mine)) * PIECES // len(mine)
        # by whether it turns: what a hold shows of a turn may be wrong elsewhere
        after = {t: moved_error(a, of_own, piece >= PIECES // 2, t) for t in {False, turns}}
        turned = min(after, key=lambda t: after[t].sum())
        motion = Motion.fit(a, goal[mine], turned)
        reach = motion.reach(a)
        if trial in known or reach >= far and falls(((a - of_own) ** 2).sum(1), after[turned], piece):
            out[trial] = Remounted(motion, reach)
    return out


def moved(recording: Recording, columns: list[str], motions: dict[int, Motion]) -> Recording:
    """A recording with these columns of each of these trials moved."""
    samples, trials = recording.samples.copy(), recording.trials()
    for trial, motion in motions.items():
        rows = samples.index[trials[trial]]
        samples.loc[rows, columns] = motion(samples.loc[rows, columns].to_numpy(float))
    return replace(recording, samples=samples)


def _begun(recording: Recording) -> dict[int, np.ndarray]:
    """Trial to the conditions under which it began, in units of what still counts as equal."""
    names = [c for c in CONDITIONS if recording.has(c)]
    tolerances = np.array([CONDITIONS[c] for c in names])
    trials = recording.trials()
    rows = recording.samples[names].iloc[[at.start for at in trials.values()]].to_numpy(float)
    return dict(zip(trials, rows / tolerances, strict=True))


def _same(begun: dict[int, np.ndarray], a: int, b: int) -> bool:
    return bool((np.abs(begun[a] - begun[b]) <= 1 + 1e-12).all())


def trials_named(numbers: list[int]) -> str:
    """Names of trials: `trial 3`, `trials 3 to 5 and 8`."""
    runs = np.split(numbers, np.flatnonzero(np.diff(numbers) != 1) + 1)
    items = [x for r in runs for x in ([f"{r[0]} to {r[-1]}"] if len(r) > 2 else map(str, r))]
    *first, last = items
    return f"trial{'s' * (len(numbers) > 1)} {', '.join(first)}{' and ' * bool(first)}{last}"
