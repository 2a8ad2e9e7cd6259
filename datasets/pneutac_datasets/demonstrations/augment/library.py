"""A controller made of the demonstrations themselves: it can start anywhere, with the object anywhere.

On a free path it follows one of the demonstrations and is led back to it. When touch comes, the next contact
of that demonstration follows, relative to where the touch came. Where touch does not come, is lost, or the
demonstration is over, the controller jumps to the nearest free frame of any demonstration that still
searches. A touch elsewhere on the gel than demonstrated, or more of it, is answered as they answer it.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numba import njit

from pneutac_datasets.demonstrations.augment.reference import FIRM, Reference, felt_and_done
from pneutac_datasets.demonstrations.replaying import FEEDBACK_HZ
from pneutac_sim.features import CONTROL_HZ, MAX_PRESSURE_KPA, MAX_SPEED_M_S, PRESSURES

TOUCH = 0.0007  # area from which it is a touch: some 50 pixels of 76,800
# Frames of the paper's rate, see `reference.frames_at`.
LONG = 6  # from which a contact is one of those that are to come
EARLY, HOLD = 16, 30  # by which a contact may end before the demonstrated release, and after it
GONE, LOST = 2, 12  # without touch until a contact is over near its release, and lost before it
WAIT = 8  # by which touch may come too late
SEARCHING, LEFT = 4, 12  # free frames ahead of where a jump may land: after a contact, and where none came
# Distances that count 1 where frames are compared.
NEAR_M, NEAR_HEIGHT_M, NEAR_KPA, NEAR_AREA, NEAR_MM = 0.012, 0.006, 1.5, 0.05, 3.0
UNSEEN = 4.0  # squared distance of a touch from a frame whose imprint's middle was not seen
FARTHEST = 40.0  # squared distance beyond which no frame is near
FAR_M = 0.02  # displacement at a release from which the demonstration is not gone on with
START_M = (0.02, 0.01, 0.02)  # distances that count 1 where starts are compared
NEAREST = 3  # starts of which one is drawn
PAUSE_M_S = 0.012  # slower is a pause on a free way
SMOOTH = 5  # frames over which free velocities are averaged
LAGS = 8  # frames by which a hand may answer late
LEAST_SEEN = 40  # frames in contact from which answers are estimated
EXPLAINED = 0.2  # share of a velocity that the touch must explain to count as an answer to it
RIDGE = 0.05  # of the touch's variance
LARGEST_ANSWER_M_S = 0.02
LEAST_START_M = 0.004  # half width of new starts, at least


def lagged_answers(references: list[Reference]) -> tuple[np.ndarray, int]:
    """How velocities follow the touch some frames before.

    By ridge regression over all frames in contact, with the lag that explains most: a person answers 0.2 to
    0.4 s late, and a regression on the same frame finds nothing.

    Returns:
        (3, 3) 1/s, 1/s and m/s: change of the velocity with the imprint's middle across and along the
        finger, metres, and with its area; rows that explain less than `EXPLAINED` are zero. And the lag in
        frames; 0 where too little was seen.
    """
    best, gain, best_lag = 0.0, np.zeros((3, 3)), 0
    for lag in range(references[0].frames(LAGS)):
        x, y = felt_and_done(references, lag, lag)
        if len(x) < LEAST_SEEN:
            continue
        x, y = x - x.mean(0), y - y.mean(0)
        normal = x.T @ x + np.diag(RIDGE * (x**2).sum(0) + 1e-12)
        found = np.linalg.solve(normal, x.T @ y).T
        left, all_of_it = ((y - x @ found.T) ** 2).sum(0), np.maximum((y**2).sum(0), 1e-12)
        share = 1 - left.sum() / all_of_it.sum()
        if share > best:
            explains = 1 - left / all_of_it > EXPLAINED
            best, gain, best_lag = share, np.where(explains[:, None], found, 0.0), lag
    return gain, best_lag


def regular(r: Reference) -> Reference:
    """A demonstration without the pauses of its free ways, whose velocities are smoothed."""
    free = np.ones(len(r), bool)
    for first, end in r.contacts:
        free[max(first - 2, 0) : end + 2] = False
    width = 2 * (r.frames(SMOOTH) // 2) + 1
    padded = np.pad(r.action[:, :3], ((width // 2, width // 2), (0, 0)), "edge")
    soft = np.stack([np.convolve(v, np.full(width, 1 / width), "valid") for v in padded.T], 1)
    action = r.action.copy()
    action[free, :3] = soft[free]
    keep = ~(free & (np.linalg.norm(soft, axis=1) < PAUSE_M_S))
    keep[0] = True
    centre = None if r.centre_mm is None else r.centre_mm[keep]
    return replace(r, flange_m=r.flange_m[keep], area=r.area[keep], action=action[keep], centre_mm=centre)


class Library(NamedTuple):
    """The demonstrations, prepared once: R references, whose F frames follow one another.

    Attributes:
        begins: (R + 1,) first frame of each reference, and F.
        sources: (R,) their episodes.
        contacts: (R, K, 2) first frame of each contact that is to come and that of its release, counted from
            the reference's first frame; -1 where it has fewer.
        within: (F, 2) the same of the contact in which a frame lies; -1 outside of contacts.
        ahead: (F,) frames until the next contact, or the end.
        flange_m, area, action, centre_mm: (F, ...) as in `Reference`.
        felt_mm: (F, 2) as `centre_mm`; that of its contact's first one where it was not seen.
        pressure_kpa: (F, C) commanded before each frame.
        answers: (3, 3) see `lagged_answers`.
        unit_kpa: difference of pressures that counts 1.
        control_hz: rate of the frames.
    """

    begins: np.ndarray
    sources: np.ndarray
    contacts: np.ndarray
    within: np.ndarray
    ahead: np.ndarray
    flange_m: np.ndarray
    area: np.ndarray
    action: np.ndarray
    centre_mm: np.ndarray
    felt_mm: np.ndarray
    pressure_kpa: np.ndarray
    answers: np.ndarray
    unit_kpa: float
    control_hz: int

    @classmethod
    def of(cls, references: list[Reference], answers: np.ndarray, width_kpa: float) -> "Library":
        """Of demonstrations without pauses, see `regular`, for a pressure range of that width."""
        begins = np.cumsum([0] + [len(r) for r in references])
        coming = [[c for c in r.contacts if c[1] - c[0] >= r.frames(LONG)] for r in references]
        contacts = np.full((len(references), max(map(len, coming)) + 1, 2), -1)
        within, columns = np.full((begins[-1], 2), -1), []
        for i, (r, to_come) in enumerate(zip(references, coming, strict=True)):
            contacts[i, : len(to_come)] = np.reshape(to_come, (-1, 2))
            t, firsts = np.arange(len(r)), np.array([c[0] for c in to_come] + [len(r)])
            next_first = firsts[np.minimum(np.searchsorted(firsts, t, "right"), len(firsts) - 1)]
            centre = np.full((len(r), 2), np.nan) if r.centre_mm is None else r.centre_mm
            felt = centre.copy()
            for first, end in r.contacts:
                within[begins[i] + first : begins[i] + end] = first, end
                seen, part = np.isfinite(centre[first:end, 0]), felt[first:end]
                part[~seen] = part[seen][0] if seen.any() else np.nan
            before = r.action[np.maximum(t - 1, 0), PRESSURES]
            columns.append((next_first - t, r.flange_m, r.area, r.action, centre, felt, before))
        joined = (np.concatenate(column) for column in zip(*columns, strict=True))
        sources, unit = np.array([r.source for r in references]), NEAR_KPA * width_kpa / MAX_PRESSURE_KPA
        hz = references[0].control_hz
        return cls(begins, sources, contacts, within, *joined, np.array(answers), unit, hz)


RUN = np.dtype(
    [
        ("reference", np.int64),
        ("frame", np.int64),  # of the reference
        ("first", np.int64),  # of the contact that has come, and its release; -1 for none
        ("end", np.int64),
        ("waited", np.int64),  # frames
        ("lost", np.int64),
        ("largest", np.float64),  # area in this contact
        ("offset_m", np.float64, 3),  # of the reference's path
        ("step", np.int64),
        ("begun", np.int64),  # pieces in this step
        ("pieces", np.int64, (4, 2)),  # reference and frame with which they begin
    ]
)


class Followers:
    """Runs of a library, side by side; `actions` is asked once a control step of them all.

    Args:
        library: of demonstrations.
        limits: lowest and highest action (3 + C,).
        runs: their number N.

    Attributes:
        paths: (frame of the run, reference, its frame) wherever another piece begins, a list for each run.
    """

    def __init__(self, library: Library, limits: tuple[np.ndarray, np.ndarray], runs: int = 1):
        self._library, self._limits, self._runs = library, limits, np.zeros(runs, RUN)
        self._pressure_kpa = np.zeros((runs, library.pressure_kpa.shape[1]))  # commanded last
        self.paths: list[list[tuple[int, int, int]]] = [[] for _ in range(runs)]

    def begin(self, k: int, rng: np.random.Generator, flange_m: np.ndarray) -> None:
        """Begins run `k` at (3,); `rng` draws its first demonstration among the nearest."""
        starts = self._library.flange_m[self._library.begins[:-1]]
        far = np.linalg.norm((starts - flange_m) / START_M, axis=1)
        self._runs[k], self.paths[k] = np.zeros((), RUN), []
        self._pressure_kpa[k] = self._library.pressure_kpa[0]
        _go(self._runs[k], int(rng.choice(np.argsort(far)[:NEAREST])), -1)
        self._note(k)

    def actions(
        self, which: np.ndarray, area: np.ndarray, centre_mm: np.ndarray, flange_m: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The next actions of some runs within the limits; arrays are float64.

        Args:
            which: (K,) numbers of the runs.
            area: (K,) contact areas that the gels feel.
            centre_mm: (K, 2) middles of the imprints; NaN without touch.
            flange_m: (K, 3) where the flanges are.

        Returns:
            (K, 3 + C), of no use where no demonstration goes on from here, and (K,) whether one does.
        """
        actions = np.zeros((len(which), self._library.action.shape[1]))
        felt = (area, centre_mm, flange_m, self._pressure_kpa[which])
        goes_on = _actions(self._library, self._runs, which, *felt, actions)
        actions = np.clip(actions, *self._limits)
        self._pressure_kpa[which] = actions[:, PRESSURES]
        for k in which[self._runs["begun"][which] > 0]:
            self._note(k)
        return actions, goes_on

    def _note(self, k: int) -> None:
        run = self._runs[k]
        for reference, frame in run["pieces"][: run["begun"]].tolist():
            self.paths[k].append((int(run["step"]), int(self._library.sources[reference]), frame))
        run["begun"] = 0


# ---------------------------------------------------------------- one run, compiled


@njit(cache=True)
def _actions(library, runs, which, area, centre_mm, flange_m, pressure_kpa, actions):
    goes_on = np.zeros(len(which), np.bool_)
    for i, k in enumerate(which):
        if _advance(library, runs[k], area[i], centre_mm[i], flange_m[i], pressure_kpa[i]):
            goes_on[i] = True
            _act(library, runs[k], area[i], centre_mm[i], flange_m[i], actions[i])
    return goes_on


@njit(cache=True)
def _act(library, run, area, centre_mm, flange_m, action):
    """As the demonstration's frame, led back to its path and answering the touch, see `replaying.follow`."""
    begin, end = library.begins[run.reference], library.begins[run.reference + 1]
    t = begin + min(run.frame, end - begin - 1)
    action[:] = library.action[t]
    led = run.first >= 0 or not run.waited
    known = run.first >= 0 and np.isfinite(centre_mm[0]) and np.isfinite(library.felt_mm[t, 0])
    for i in range(3):
        answer = 0.0
        if known:
            for j in range(2):
                answer += library.answers[i, j] * (1e-3 * (centre_mm[j] - library.felt_mm[t, j]))
            answer += library.answers[i, 2] * (area - library.area[t])
            answer = min(max(answer, -LARGEST_ANSWER_M_S), LARGEST_ANSWER_M_S)
        run.offset_m[i] += answer * (1 / library.control_hz)
        if led:
            back = library.flange_m[t, i] + run.offset_m[i] - flange_m[i]
            action[i] = min(max(action[i] + FEEDBACK_HZ * back, -MAX_SPEED_M_S), MAX_SPEED_M_S)
        action[i] += answer


@njit(cache=True)
def _frames(library, paper):
    return max(1, round(paper * library.control_hz / CONTROL_HZ))


@njit(cache=True)
def _go(run, reference, frame):
    run.reference, run.frame = reference, frame
    run.first = run.end = -1
    run.offset_m[:] = 0.0
    run.waited = run.lost = 0
    run.largest = 0.0
    _begins(run)


@njit(cache=True)
def _begins(run):
    run.pieces[run.begun, 0], run.pieces[run.begun, 1] = run.reference, max(run.frame, 0)
    run.begun += 1


@njit(cache=True)
def _touched(library, run, first, end, flange_m, frame):
    run.first, run.end, run.frame = first, end, frame
    run.waited = run.lost = 0
    run.largest = 0.0
    for i in range(3):
        run.offset_m[i] = flange_m[i] - library.flange_m[library.begins[run.reference] + frame, i]
    _begins(run)


@njit(cache=True)
def _kpa_away(library, t, pressure_kpa, most):
    """Squared distance of pressures from those of a frame, at most so many units."""
    away = 0.0
    for c in range(len(pressure_kpa)):
        away = max(away, abs(library.pressure_kpa[t, c] - pressure_kpa[c]))
    return min(away / library.unit_kpa, most) ** 2


@njit(cache=True)
def _at(library, t):
    """Reference and frame of one of all frames."""
    reference = np.searchsorted(library.begins, t, "right") - 1
    return reference, t - library.begins[reference]


@njit(cache=True)
def _jump(library, run, flange_m, pressure_kpa, paper):
    """To the nearest free frame with free frames ahead; False where none is near."""
    ahead, nearest, least = _frames(library, paper), -1, np.inf
    for t in range(len(library.ahead)):
        if library.within[t, 0] >= 0 or library.ahead[t] < ahead:
            continue
        away = 0.0
        for i in range(3):
            away += ((library.flange_m[t, i] - flange_m[i]) / NEAR_M) ** 2
        if away < least:  # saves the rest
            away += _kpa_away(library, t, pressure_kpa, 2.5)
            if away < least:
                nearest, least = t, away
    if not least <= FARTHEST:
        return False
    _go(run, *_at(library, nearest))
    return True


@njit(cache=True)
def _into_contact(library, run, area, centre_mm, flange_m, pressure_kpa):
    """Into the middle of whichever contact is nearest; False where no demonstration has one."""
    nearest, least = -1, np.inf
    for t in range(len(library.ahead)):
        if library.within[t, 0] < 0:
            continue
        away = ((library.flange_m[t, 2] - flange_m[2]) / NEAR_HEIGHT_M) ** 2
        away += _kpa_away(library, t, pressure_kpa, 5.0)
        away += ((library.area[t] - area) / NEAR_AREA) ** 2
        if np.isfinite(centre_mm[0]):
            x = (library.centre_mm[t, 0] - centre_mm[0]) / NEAR_MM
            y = (library.centre_mm[t, 1] - centre_mm[1]) / NEAR_MM
            away += UNSEEN if np.isnan(x) else x**2 + y**2
        if away < least:
            nearest, least = t, away
    if nearest < 0:
        return False
    reference, frame = _at(library, nearest)
    _go(run, reference, frame)
    _touched(library, run, library.within[nearest, 0], library.within[nearest, 1], flange_m, frame)
    return True


@njit(cache=True)
def _advance(library, run, area, centre_mm, flange_m, pressure_kpa):
    """Goes on by a frame; False where it is at a loss."""
    run.step += 1
    run.frame += 1
    if run.first >= 0:
        return _in_contact(library, run, area, flange_m, pressure_kpa)
    first = end = -1  # of the next contact
    for c in library.contacts[run.reference]:
        if c[1] > run.frame:
            first, end = c
            break
    if area > TOUCH:
        if first >= 0:
            _touched(library, run, first, end, flange_m, first)
            return True
        return _into_contact(library, run, area, centre_mm, flange_m, pressure_kpa)
    if first >= 0 and run.frame >= first:
        run.waited += 1
        run.frame = max(first - 1, 0)
        wait = _frames(library, WAIT)
        late = run.waited > wait and not _jump(library, run, flange_m, pressure_kpa, LEFT)
        return not late or run.waited < 3 * wait
    if run.frame >= library.begins[run.reference + 1] - library.begins[run.reference]:
        return _jump(library, run, flange_m, pressure_kpa, LEFT)
    return True


@njit(cache=True)
def _in_contact(library, run, area, flange_m, pressure_kpa):
    begin, first, end = library.begins[run.reference], run.first, run.end
    length = library.begins[run.reference + 1] - begin
    lasts, gone = end >= length, _frames(library, GONE)
    run.largest = max(run.largest, area)
    run.lost = 0 if area > TOUCH and area >= FIRM * run.largest else run.lost + 1
    if run.lost >= gone and end - run.frame <= _frames(library, EARLY) and not lasts:
        run.frame = end
    elif run.lost > _frames(library, LOST):
        return _jump(library, run, flange_m, pressure_kpa, SEARCHING)
    elif run.frame >= end and (run.lost < gone or lasts):
        run.waited += 1
        if run.waited > _frames(library, HOLD):
            return False
        for i in range(3):
            onward_m = library.flange_m[begin + end - 1, i] - library.flange_m[begin + first, i]
            run.offset_m[i] += onward_m / max(end - 1 - first, 1)
        run.frame = end - 1
    if run.frame >= end:
        far = np.sqrt(run.offset_m[0] ** 2 + run.offset_m[1] ** 2 + run.offset_m[2] ** 2) > FAR_M
        run.first = run.end = -1
        run.waited = 0
        run.offset_m[:] = 0.0
        if far and not _jump(library, run, flange_m, pressure_kpa, SEARCHING):
            return False
        if run.frame >= library.begins[run.reference + 1] - library.begins[run.reference]:
            return _jump(library, run, flange_m, pressure_kpa, LEFT)
    return True


def start_spread_m(references: list[Reference]) -> tuple[float, float, float]:
    """Half widths of new starts about the recorded ones: their standard deviation, 4 mm at least."""
    spread = np.std([r.flange_m[0] for r in references], axis=0, ddof=min(len(references) - 1, 1))
    return tuple(np.maximum(spread, LEAST_START_M).tolist())
