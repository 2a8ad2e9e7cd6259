"""How well a measurement repeats: the error below which no model can be distinguished from the true one.

Three sources, in this order: repeats of a program, what `recording.json` declares, and local contrasts.

Repeats: half the variance of the difference between two equal runs is the variance of one of them. Slow
differences (creep left over, drift of the session) are physics that a model may yet explain, so the floor is
the fast part; the whole difference is reported as `session`.

Local contrasts need neither repeats nor quiet holds. Over rows i - s, i, i + s of one trial,

    c_i = (y_i - w y_(i-s) - (1 - w) y_(i+s)) / sqrt(1 + w^2 + (1 - w)^2)
    w = (t_(i+s) - t_i) / (t_(i+s) - t_(i-s))

removes what is a straight line in time over 2 s rows; white noise of deviation sigma gives contrasts of that
deviation. The same contrasts of what usual responses to the commanded pressure are made of (powers, delays,
lags, plays) are regressed out. With the hat matrix H and the known correlation C C' of the contrasts (C makes
them from y), sigma^2 = |(I - H) c|^2 / tr((I - H) C C').
"""

from dataclasses import dataclass
from itertools import accumulate, combinations, pairwise
from pathlib import Path

import numpy as np
from scipy.signal import detrend, lfilter
from scipy.sparse import csr_array

from pneutac_datasets.recording.recording import GRAVITY, Recording
from pneutac_datasets.recording.rules import recorded_s
from pneutac_datasets.recording.wording import plural
from pneutac_sim.errors import InputError
from pneutac_sim.finger import quantities

RIDGE = 1e-5


def static_columns(u: np.ndarray) -> np.ndarray:
    """(n, m): a constant first, powers up to the fourth, and products of two chambers.

    Pressures or drives `u` (n, chambers) are of the order of 1.
    """
    products = [(u[:, i] * u[:, j])[:, None] for i, j in combinations(range(u.shape[1]), 2)]
    return np.hstack([np.ones((len(u), 1)), u, u**2, u**3, u**4, *products])


def regress(design: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Coefficients (m, k) by ridge regression on standardised columns; the first column is a constant."""
    mean, scale = design[:, 1:].mean(0), design[:, 1:].std(0)
    scale = np.where(scale > 1e-9, scale, np.inf)  # a constant column has no information
    z = (design[:, 1:] - mean) / scale
    slope = np.linalg.solve(z.T @ z + RIDGE * len(z) * np.eye(z.shape[1]), z.T @ (y - y.mean(0)))
    slope /= scale[:, None]
    return np.vstack([y.mean(0) - mean @ slope, slope])


WINDOW_S = 0.4
MAX_PAIRS = 12
EARLIER_ROWS = 2  # at most, by which a step of an equal run comes earlier or later
SETTLED_S = 1.0  # after steps that came at other times, until runs are alike again
LAGS_ROWS = (0.7, 1.5, 3.0, 6.0, 12.0, 25.0)  # of the responses that are regressed out
DELAYS_ROWS = (1, 2, 3)
PLAY_WIDTHS = (0.03, 0.1, 0.25, 0.5)  # share of the command's range
QUIET_S = 0.0, 0.15, 0.3, 0.6, 1.2, 2.4  # after a step, at one of which responses without a feature are over
WIDE_S, WIDE_ROWS = 0.2, 3  # half of the window in which noise correlated from row to row is looked for
CORRELATED = 1.25  # ratio of the wide to the narrow contrast from which on noise counts as correlated
REST = 0.02  # of the largest command: below, a device is at rest
SWINGS = 1.5  # noise over that at rest from which on it is no noise of the sensor, which knows no pressure
OUTLIER = 6.0  # robust standard deviations beyond which a contrast is a jump of the marker, not noise
EXACT = 1e-9  # of a column's range: smaller noise is rounding of computed numbers
LEAST_DOF = 40  # degrees of freedom of an estimate
LEAST_ROWS = 120  # in fewer an estimate by contrasts is not within 20 %
LEAST_REPEATED = 240  # rows of pairs; fewer give no noise within 20 %
MOST_ROWS, PIECE_ROWS = 20_000, 2_000  # of a longer recording so many are used, in pieces
LONG_S = 120.0  # of a recording whose neighbouring rows mostly show its noise
MAD = 1.4826  # standard deviation of a normal distribution over its median absolute deviation


@dataclass
class NoiseFloor:
    """Noise of the headline measurement."""

    # root mean square Euclidean distance caused by noise alone, in `unit`; None where this recording cannot
    # determine it
    value: float | None
    session: float | None  # the same including slow differences between repeats, None without repeats
    unit: str  # `mm`, `rad` or `1/m`
    how: str  # how it was found, or what to record to find it
    # standard deviation of each observed column; those that cannot be determined are left out
    by_column: dict[str, float]
    known: bool = True  # whether it was declared or measured by repeats, not estimated by local contrasts

    @property
    def floor(self) -> float:
        """`value`, or 0 where it is unknown: then the whole error counts as avoidable."""
        return self.value or 0.0

    def needed(self, folder: str | Path) -> float:
        """`value`, for what cannot do without it; raises InputError where it is unknown."""
        if self.value is None:
            raise InputError(f"{folder}: the noise {self.how}.")
        return self.value


def headline(recording: Recording) -> tuple[list[str], str]:
    """The columns whose Euclidean distance is the error, and its unit; see `finger.quantities`."""
    return quantities.headline(recording.observations, recording.device)


def noise_floor(recording: Recording) -> NoiseFloor:
    """Estimates the noise from repeats, else from what the file declares, else from local contrasts."""
    (columns, unit), numeric = headline(recording), recording.poses
    pairs, declared = repeats(recording), recording.meta.get("noise") or {}
    rows = sum(len(first) for first, *_ in pairs)
    stated = all(c in declared for c in columns)
    session, calm = None, contrasts(recording, numeric, at_rest=True)
    if repeated := rows >= LEAST_REPEATED:
        by, whole = {}, {}
        for c in numeric:
            x, apart, fast = recording.column(c), [], []
            for first, second, window in pairs:
                apart.append(x[first] - x[second])
                for piece in np.split(apart[-1], _gaps(first)):
                    n = min(window, len(piece))  # straight lines are taken off window by window
                    piece = piece[: len(piece) // n * n].reshape(-1, n)
                    # scaled for the two degrees of freedom that each line costs
                    fast.append((detrend(piece, axis=1) * np.sqrt(n / max(n - 2, 1))).ravel())
            size = np.abs(np.concatenate(fast))
            usual = size[size <= OUTLIER * MAD * np.median(size)]  # without jumps of the marker
            by[c], whole[c] = (float(np.sqrt(np.mean(d**2) / 2)) for d in (usual, np.concatenate(apart)))
        session = _norm(whole, columns)
        pair = plural(len(pairs), "pair")
        how = f"the difference between equal runs ({pair}), without slow drift"
    elif stated:
        by = {c: float(declared[c]) for c in numeric if c in declared}
        how, calm = "stated in recording.json", {}  # what is stated is not judged by an estimate
    else:
        by = contrasts(recording, numeric)
        how = "what neighbouring rows and the commanded pressure do not predict"
    least = {c: EXACT * float(np.ptp(recording.column(c))) for c in numeric}
    swings = {c: by[c] / v for c, v in calm.items() if v > least[c] and by.get(c, 0.0) > SWINGS * v}
    if in_headline := [swings[c] for c in columns if c in swings]:
        by |= {c: calm[c] for c in swings}
        how = (
            "the difference between neighbouring rows at rest; under pressure rows or equal runs differ "
            f"{max(in_headline):.1f} times as much, which is the device or its air and not the sensor"
        )
    exact = [c for c in by if by[c] <= least[c]]
    by = {c: sigma for c, sigma in by.items() if c not in exact}
    value = _norm(by, columns) if columns and all(c in by for c in columns) else None
    if value is None and exact:
        how = (
            f"cannot be determined: column '{exact[0]}' repeats to the last digit, as computed numbers "
            "do; declare 'noise' in recording.json"
        )
    elif value is None:
        longer = "" if recorded_s(recording.samples) >= LONG_S else "record two minutes or more, "
        twice = f" for {LEAST_REPEATED} rows or more (not {rows})" if rows else ""
        how = f"cannot be determined from this recording; {longer}run one program twice{twice}, or declare"
        how += " 'noise' in recording.json"
    return NoiseFloor(value, session, unit, how, by, value is not None and (repeated or stated))


def noise_text(value: float | None) -> str:
    """A noise floor as tables show it."""
    return "unknown" if value is None else f"{value:.3g}"


def _norm(by: dict[str, float], columns: list[str]) -> float:
    return float(np.sqrt(sum(by[c] ** 2 for c in columns)))


def repeats(recording: Recording) -> list[tuple[np.ndarray, np.ndarray, int]]:
    """Pairs of stretches run under equal conditions.

    Row numbers of the first and of the second run, sample by sample, and the samples in one detrending
    window. Runs are compared from their start on: equal command, program, orientation, temperature (within 1
    K) and payload, at least three seconds of it.
    """
    s = recording.samples
    time, command = s["time_s"].to_numpy(), recording.commands
    tolerance = 0.01 * max(float(np.ptp(command)), 1e-9)
    found, runs = [], []  # first row and row after the last of each trial, cut also where the program changes
    for rows in recording.trials().values():
        cuts = []
        if recording.has("program"):
            program = s["program"].to_numpy()[rows]
            cuts = np.flatnonzero(program[1:] != program[:-1]) + 1 + rows.start
        runs += pairwise([rows.start, *(cuts if len(cuts) < 50 else ()), rows.stop])
    for (i0, i1), (j0, j1) in combinations(runs, 2):
        if len(found) == MAX_PAIRS:
            break
        if "program" in s and s["program"].iloc[i0] != s["program"].iloc[j0]:
            continue
        if any(abs(s[c].iloc[i0] - s[c].iloc[j0]) > tol for c, tol in _TOLERANCES.items() if c in s):
            continue
        a = np.arange(i0, i1)
        ta, tb = time[a] - time[i0], time[j0:j1] - time[j0]
        a = a[ta <= tb[-1]]
        b = j0 + np.round(np.interp(ta[: len(a)], tb, np.arange(len(tb)))).astype(int)  # the nearest
        equal = np.abs(command[a] - command[b]).max(1) <= tolerance
        steps = np.abs(np.diff(command[a], axis=0, prepend=command[a[:1]])).max(1) > tolerance
        n, use = _alike(equal, steps, ta[: len(a)])
        window = max(8, round(WINDOW_S * n / ta[n - 1])) if n > 1 else 8
        use = np.flatnonzero(use)
        pieces = np.split(use, _gaps(use))
        use = np.concatenate([piece for piece in pieces if len(piece) >= min(window, n)] or [use[:0]])
        if len(use) >= 20 and ta[n - 1] >= 3.0 and np.ptp(command[a[use]]) > tolerance:
            found.append((a[use], b[use], window))
    return found


def _alike(equal: np.ndarray, steps: np.ndarray, time: np.ndarray) -> tuple[int, np.ndarray]:
    """How many rows (n,) two runs have in common, and which of them show the noise.

    A timer that is not even steps between other rows, at times a row earlier or later: the rows after all its
    steps show more than noise.
    """
    edges = np.flatnonzero(np.diff(np.r_[True, equal, True]))
    first, end = edges[::2], edges[1::2]
    others = first[end - first > EARLIER_ROWS]
    n = int(others[0]) if len(others) else len(equal)
    if not len(first) or first[0] == n:
        return n, np.ones(n, bool)
    last = np.maximum.accumulate(np.where(steps | ~equal, time, -np.inf))
    return n, (time > last + SETTLED_S)[:n]


def _gaps(rows: np.ndarray) -> np.ndarray:
    """Where in rising row numbers (n,) rows are left out."""
    return 1 + np.flatnonzero(np.diff(rows) > 1)


_TOLERANCES = dict.fromkeys(GRAVITY, 0.1) | {"temperature_c": 1.0, "payload_g": 0.1}


# ---------------------------------------------------------------- local contrasts


def contrasts(recording: Recording, columns: list[str], at_rest: bool = False) -> dict[str, float]:
    """Standard deviation of the noise of a body's columns; those that cannot be determined are left out.

    `at_rest` by rows without pressure alone, in which no regulator hunts.
    """
    pieces = [np.arange(s.start, s.stop) for s in recording.trials().values()]
    if len(recording) > MOST_ROWS:
        pieces = [r[a : a + PIECE_ROWS] for r in pieces for a in range(0, len(r), PIECE_ROWS)]
        every = np.linspace(0, len(pieces) - 1, MOST_ROWS // PIECE_ROWS).astype(int)
        pieces = [pieces[i] for i in np.unique(every)]
    rows, piece = np.concatenate(pieces), np.repeat(np.arange(len(pieces)), [len(r) for r in pieces])
    if len(rows) < LEAST_ROWS or not columns:
        return {}
    t = recording.column("time_s")[rows].astype(float)
    first = np.r_[True, piece[1:] != piece[:-1]]
    step_s = np.diff(t)[~first[1:]]
    if len(step_s) < LEAST_ROWS // 2:
        return {}
    u = recording.commands[rows]
    Y = recording.samples[columns].to_numpy(float)[rows]
    F = np.concatenate([_responses(c, first) for c in u.T], axis=1)
    quiet = quiet_s(t, first, u)
    if at_rest:
        quiet[(np.abs(u) > REST * np.abs(u).max()).any(axis=1)] = np.nan  # no wait is over there
    wide = max(WIDE_ROWS, round(WIDE_S / float(np.median(step_s))))
    near, far = _Contrasts(t, piece, F, Y, 1), _Contrasts(t, piece, F, Y, wide)
    out = {}
    for k, name in enumerate(columns):
        sigma = near.deviation(k, quiet, QUIET_S if at_rest else (None, *QUIET_S))
        slow = far.deviation(k, quiet, QUIET_S)  # contrasts this wide need rows without steps
        if sigma is not None and slow is not None and slow > CORRELATED * sigma:
            sigma = slow
        if sigma is not None:
            out[name] = max(sigma, _resolution(np.abs(np.diff(Y[:, k]))[~first[1:]]) / np.sqrt(12))
    return out


def _responses(u: np.ndarray, first: np.ndarray) -> np.ndarray:
    """(n, f) what usual responses to a command u (n,) are made of; `first` (n,) marks where trials begin."""
    x, out = (u - u.min()) / max(float(np.ptp(u)), 1e-9), []
    for v in np.split(x, np.flatnonzero(first)[1:]):
        columns = [v, v**2, v**3]
        for k in DELAYS_ROWS:
            late = v[np.maximum(np.arange(len(v)) - k, 0)]
            columns += [late, late**2]
        for lag in LAGS_ROWS:
            g = 1 - np.exp(-1 / lag)
            columns += [lfilter([g], [1, g - 1], z, zi=[(1 - g) * z[0]])[0] for z in (v, v**2)]
        for width in PLAY_WIDTHS:
            play = accumulate(v, lambda s, w, h=width / 2: min(max(s, w - h), w + h), initial=v[0])
            columns.append(np.fromiter(play, float)[1:])
        out.append(np.stack(columns, axis=1))
    return np.concatenate(out)


def quiet_s(t: np.ndarray, first: np.ndarray, u: np.ndarray) -> np.ndarray:
    """(n,) seconds since a command last changed; 0 in the row of the change."""
    moved = np.r_[True, (np.abs(np.diff(u, axis=0)) > 1e-3 * max(float(np.ptp(u)), 1e-9)).any(axis=1)]
    last = np.maximum.accumulate(np.where(moved | first, np.arange(len(t)), 0))
    return t - t[last]


def _resolution(steps: np.ndarray) -> float:
    """Least of the steps (n,) of a column that often repeats itself and moves in such steps, else 0."""
    moves = steps[steps > 0]
    if not len(moves) or (steps == 0).mean() < 0.2:
        return 0.0
    counts = moves / moves.min()
    return float(moves.min()) if (np.abs(counts - np.round(counts)) < 0.02).mean() > 0.95 else 0.0


class _Contrasts:
    """Contrasts of columns Y (n, k) and responses F (n, f) over rows i - s, i, i + s of one trial."""

    def __init__(self, t, trial, F, Y, s: int):
        i = np.arange(s, len(t) - s)
        i = i[trial[i - s] == trial[i + s]]
        w = (t[i + s] - t[i]) / (t[i + s] - t[i - s])
        W = np.stack([-w, np.ones(len(i)), w - 1], axis=1)
        W /= np.linalg.norm(W, axis=1, keepdims=True)
        rows = np.repeat(np.arange(len(i)), 3), np.add.outer(i, (-s, 0, s)).ravel()
        self.C = csr_array((W.ravel(), rows), shape=(len(i), len(t)))
        self.X, self.c = self.C @ F, self.C @ Y
        self.before, self.after, self.lasts_s = i - s, i + s, t[i + s] - t[i - s]
        self._basis: dict[float | None, np.ndarray] = {}

    def deviation(self, k: int, quiet: np.ndarray, after_s: tuple[float | None, ...]) -> float | None:
        """Of the noise of column k, from all rows (None) or those so long after a step.

        A response that no feature follows can only enlarge an estimate, so the first of those that are not
        significantly above the least is taken. None where too few rows are left.
        """
        found, since_s = [], quiet[self.before]
        held = quiet[self.after] - since_s > 0.99 * self.lasts_s
        for wait in after_s:
            use = np.ones(len(held), bool) if wait is None else held & (since_s >= wait)
            if use.sum() >= LEAST_DOF and (estimate := self._estimate(k, use, wait)):
                found.append(estimate)
        upper = min((sigma * (1 + 2 / np.sqrt(dof)) for sigma, dof in found), default=0.0)
        return next((sigma for sigma, _ in found if sigma <= upper), None)

    def _estimate(self, k: int, use: np.ndarray, wait: float | None) -> tuple[float, float] | None:
        """Deviation and its degrees of freedom, tr((I - H) C C'); contrasts beyond `OUTLIER` go once."""
        at, first = np.flatnonzero(use), True
        if wait not in self._basis:
            self._basis[wait] = self._directions(at)
        Q = self._basis[wait]
        while True:
            c = self.c[at, k]
            left = c - Q @ (Q.T @ c)
            dof = len(at) - float(((self.C[at].T @ Q) ** 2).sum())  # contrasts that share rows are correlated
            if dof < LEAST_DOF:
                return None
            robust = MAD * float(np.median(np.abs(left))) * np.sqrt(len(at) / dof)
            usual = np.abs(left) < OUTLIER * robust
            if not first or robust <= 0 or usual.all():
                return float(np.sqrt((left @ left) / dof)), dof
            at, first = at[usual], False
            Q = self._directions(at)

    def _directions(self, at: np.ndarray) -> np.ndarray:
        """(m, r) orthonormal basis of the responses' contrasts in these rows."""
        size = np.linalg.norm(self.X, axis=0)
        X = self.X[at][:, size > 1e-9] / size[size > 1e-9]
        if not X.shape[1]:
            return np.zeros((len(at), 0))
        U, S, _ = np.linalg.svd(X, full_matrices=False)
        return U[:, S > 1e-6 * S[0]] if S[0] > 0 else U[:, :0]
