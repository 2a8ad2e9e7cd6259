"""A controller made of the demonstrations themselves: it can start anywhere, with the object anywhere.

On a free path it follows one of the demonstrations and is led back to it. When touch comes, the next contact
of that demonstration follows, relative to where the touch came. Where touch does not come, is lost, or the
demonstration is over, the controller jumps to the nearest free frame of any demonstration that still
searches. A touch elsewhere on the gel than demonstrated, or more of it, is answered as they answer it.
"""

from dataclasses import dataclass, replace

import numpy as np

from pneutac_datasets.demonstrations.augment.reference import FIRM, Reference, frames_at
from pneutac_datasets.demonstrations.replay.replaying import follow
from pneutac_sim.features import MAX_PRESSURE_KPA, PRESSURES

TOUCH = 0.0007  # area from which it is a touch: some 50 pixels of 76,800
# Frames of the paper's rate, see `reference.frames_at`.
LONG = 6  # from which a contact is one of those that are to come
EARLY, HOLD = 16, 30  # by which a contact may end before the demonstrated release, and after it
GONE, LOST = 2, 12  # without touch until a contact is over near its release, and lost before it
WAIT = 8  # by which touch may come too late
SEARCHING, LEFT = 4, 12  # free frames ahead of where a jump may land: after a contact, and where none came
# Distances that count 1 where frames are compared.
NEAR_M, NEAR_HEIGHT_M, NEAR_KPA, NEAR_AREA, NEAR_MM = 0.012, 0.006, 1.5, 0.05, 3.0
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
        seen, moved = [np.empty((0, 3))], [np.empty((0, 3))]
        for r in references:
            if r.centre_mm is None:
                continue
            for first, end in r.contacts:
                t = np.arange(first + lag, min(end, len(r)))
                t = t[np.isfinite(r.centre_mm[t - lag, 0])]
                seen.append(np.column_stack([1e-3 * r.centre_mm[t - lag], r.area[t - lag]]))
                moved.append(r.action[t, :3])
        x, y = np.concatenate(seen), np.concatenate(moved)
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


@dataclass
class Library:
    """The demonstrations, prepared once.

    Attributes:
        contacts: of each reference, first and last frame of those that are to come.
        at: (F, 2) reference and frame of all frames.
        free: (F,) whether a frame is outside of contacts.
        ahead: (F,) frames until the next contact, or the end.
        flange_m, pressure_kpa, area, centre_mm: (F, ...) at all frames.
    """

    references: list[Reference]  # without pauses
    answers: np.ndarray  # see `lagged_answers`
    width_kpa: float  # of the pressure range

    @classmethod
    def of(cls, references: list[Reference], width_kpa: float) -> "Library":
        """Of recorded demonstrations; answers are estimated before pauses are left out."""
        return cls([regular(r) for r in references], lagged_answers(references)[0], width_kpa)

    def __post_init__(self):
        self.contacts, at, free, ahead, pressure, centre = [], [], [], [], [], []
        for i, r in enumerate(self.references):
            contacts = [c for c in r.contacts if c[1] - c[0] >= r.frames(LONG)]
            self.contacts.append(contacts)
            outside = np.ones(len(r), bool)
            for first, end in r.contacts:
                outside[first:end] = False
            firsts, t = np.array([c[0] for c in contacts] + [len(r)]), np.arange(len(r))
            next_first = firsts[np.minimum(np.searchsorted(firsts, t, "right"), len(firsts) - 1)]
            at.append(np.column_stack([np.full(len(r), i), t]))
            free.append(outside)
            ahead.append(next_first - t)
            pressure.append(r.action[np.maximum(t - 1, 0), PRESSURES])
            centre.append(np.full((len(r), 2), np.nan) if r.centre_mm is None else r.centre_mm)
        self.at, self.free, self.ahead = map(np.concatenate, (at, free, ahead))
        self.pressure_kpa, self.centre_mm = np.concatenate(pressure), np.concatenate(centre)
        self.flange_m = np.concatenate([r.flange_m for r in self.references])
        self.area = np.concatenate([r.area for r in self.references])

    def kpa_away(self, pressure_kpa: np.ndarray, most: float) -> np.ndarray:
        """(F,) squared distance of pressures, at most so many units."""
        unit = NEAR_KPA * self.width_kpa / MAX_PRESSURE_KPA
        away = np.abs(self.pressure_kpa - pressure_kpa).max(1) / unit
        return np.minimum(away, most) ** 2


class Follower:
    """One run of a library; `action` is asked once a control step.

    Args:
        library: of demonstrations.
        rng: draws the first demonstration among the nearest.
        flange_m: (3,) where the run starts.

    Attributes:
        path: (frame of the run, reference, its frame) wherever another piece begins.
    """

    def __init__(self, library: Library, rng: np.random.Generator, flange_m: np.ndarray):
        self._library, self.path, self._step = library, [], 0
        self._dt_s = 1 / library.references[0].control_hz
        starts = np.array([r.flange_m[0] for r in library.references])
        far = np.linalg.norm((starts - flange_m) / START_M, axis=1)
        self._go(int(rng.choice(np.argsort(far)[:NEAREST])), -1)

    def action(
        self, area: float, centre_mm: np.ndarray, flange_m: np.ndarray, pressure_kpa: np.ndarray
    ) -> np.ndarray | None:
        """The next action (3 + C,); None where no demonstration goes on from here.

        Args:
            area: contact area that the gel feels.
            centre_mm: (2,) middle of the imprint; NaN without touch.
            flange_m: (3,) where the flange is.
            pressure_kpa: (C,) commanded last.
        """
        self._step += 1
        if not self._advance(area, centre_mm, flange_m, pressure_kpa):
            return None
        r = self._reference
        t = min(self._frame, len(r) - 1)
        answer = self._answer(t, area, centre_mm)
        self._offset_m = self._offset_m + answer * self._dt_s
        action = r.action[t].copy()
        if self._contact is not None or not self._waited:
            action = follow(action[None], flange_m, r.flange_m[t] + self._offset_m, self._dt_s)[0]
        action[:3] += answer
        return action

    # ---------------------------------------------------------------- which frame comes next

    def _go(self, reference: int, frame: int) -> None:
        self._number, self._reference, self._frame = reference, self._library.references[reference], frame
        self._contact, self._offset_m = None, np.zeros(3)
        self._waited = self._lost = 0
        self._largest = 0.0
        self.path.append((self._step, self._reference.source, max(frame, 0)))

    def _jump(self, flange_m: np.ndarray, pressure_kpa: np.ndarray, ahead: int) -> bool:
        """To the nearest free frame with free frames ahead; False where none is near."""
        lib = self._library
        away = (((lib.flange_m - flange_m) / NEAR_M) ** 2).sum(1) + lib.kpa_away(pressure_kpa, 2.5)
        away[~(lib.free & (lib.ahead >= self._frames(ahead)))] = np.inf
        nearest = int(np.argmin(away))
        if not away[nearest] <= FARTHEST:
            return False
        self._go(*map(int, lib.at[nearest]))
        return True

    def _into_contact(
        self, area: float, centre_mm: np.ndarray, flange_m: np.ndarray, pressure_kpa: np.ndarray
    ) -> bool:
        """Into the middle of whichever contact is nearest."""
        lib = self._library
        if lib.free.all():
            return False
        away = ((lib.flange_m[:, 2] - flange_m[2]) / NEAR_HEIGHT_M) ** 2 + lib.kpa_away(pressure_kpa, 5.0)
        away += ((lib.area - area) / NEAR_AREA) ** 2
        if np.isfinite(centre_mm).all():
            away += np.nan_to_num((((lib.centre_mm - centre_mm) / NEAR_MM) ** 2).sum(1), nan=4.0)
        away[lib.free] = np.inf
        number, frame = map(int, lib.at[int(np.argmin(away))])
        self._go(number, frame)
        contact = next(c for c in self._reference.contacts if c[0] <= frame < c[1])
        self._touched(contact, flange_m, frame)
        return True

    def _touched(self, contact: tuple[int, int], flange_m: np.ndarray, frame: int) -> None:
        self._contact, self._frame = contact, frame
        self._waited = self._lost = 0
        self._largest = 0.0
        self._offset_m = flange_m - self._reference.flange_m[frame]
        self.path.append((self._step, self._reference.source, frame))

    def _advance(self, area: float, centre_mm, flange_m, pressure_kpa) -> bool:
        """Goes on by a frame; False where it is at a loss."""
        self._frame += 1
        if self._contact is not None:
            return self._in_contact(area, flange_m, pressure_kpa)
        left = [c for c in self._library.contacts[self._number] if c[1] > self._frame]
        if area > TOUCH:
            if left:
                self._touched(left[0], flange_m, left[0][0])
                return True
            return self._into_contact(area, centre_mm, flange_m, pressure_kpa)
        if left and self._frame >= left[0][0]:
            self._waited += 1
            self._frame = max(left[0][0] - 1, 0)
            late = self._waited > self._frames(WAIT) and not self._jump(flange_m, pressure_kpa, LEFT)
            return not late or self._waited < 3 * self._frames(WAIT)
        if self._frame >= len(self._reference):
            return self._jump(flange_m, pressure_kpa, LEFT)
        return True

    def _in_contact(self, area: float, flange_m: np.ndarray, pressure_kpa: np.ndarray) -> bool:
        r, (first, end) = self._reference, self._contact
        lasts, gone = end >= len(r), self._frames(GONE)
        self._largest = max(self._largest, area)
        firm = area > TOUCH and area >= FIRM * self._largest
        self._lost = 0 if firm else self._lost + 1
        if self._lost >= gone and end - self._frame <= self._frames(EARLY) and not lasts:
            self._frame = end
        elif self._lost > self._frames(LOST):
            return self._jump(flange_m, pressure_kpa, SEARCHING)
        elif self._frame >= end and (self._lost < gone or lasts):
            self._waited += 1
            if self._waited > self._frames(HOLD):
                return False
            onward_m = (r.flange_m[end - 1] - r.flange_m[first]) / max(end - 1 - first, 1)
            self._offset_m = self._offset_m + onward_m
            self._frame = end - 1
        if self._frame >= end:
            far = np.linalg.norm(self._offset_m) > FAR_M
            self._contact, self._waited, self._offset_m = None, 0, np.zeros(3)
            if far and not self._jump(flange_m, pressure_kpa, SEARCHING):
                return False
            if self._frame >= len(self._reference):
                return self._jump(flange_m, pressure_kpa, LEFT)
        return True

    def _answer(self, frame: int, area: float, centre_mm: np.ndarray) -> np.ndarray:
        """(3,) m/s, by how the touch differs from the demonstrated one."""
        r = self._reference
        if self._contact is None or r.centre_mm is None or not np.isfinite(centre_mm).all():
            return np.zeros(3)
        then = r.centre_mm[frame]
        if not np.isfinite(then).all():
            seen = r.centre_mm[slice(*self._contact)]
            seen = seen[np.isfinite(seen[:, 0])]
            if not len(seen):
                return np.zeros(3)
            then = seen[0]
        felt = np.append(1e-3 * (centre_mm - then), area - r.area[frame])
        return np.clip(self._library.answers @ felt, -LARGEST_ANSWER_M_S, LARGEST_ANSWER_M_S)

    def _frames(self, paper: int) -> int:
        return frames_at(self._reference.control_hz, paper)


def start_spread_m(references: list[Reference]) -> tuple[float, float, float]:
    """Half widths of new starts about the recorded ones: their standard deviation, 4 mm at least."""
    spread = np.std([r.flange_m[0] for r in references], axis=0, ddof=1)
    return tuple(np.maximum(spread, LEAST_START_M).tolist())
