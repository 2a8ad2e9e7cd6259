"""Model-predictive control by the cross-entropy method (CEM), guided by a demonstration's touch.

At each replanning CEM draws sequences of H actions around a warm start, tries them on the world's gantry, and
moves mean and spread to the best of them. The cost is the paper's (eq. mpc-impl)

    L = sum_t [ w (c_t - c*_t)^2 + lambda |x_t - x*_t|^2 ] + mu sum_t |a_t - a_{t-1}|^2

with contact area c (a fraction of the image), flange position x (m), and action a in units of its limits.

Which frame of a demonstration comes next in a new scene, and where it lies there.

Before a touch nobody knows where the object is, so the demonstrated way is gone as it was, until the touch
comes: earlier, later, or more to one side of the gel. In contact the demonstrated way goes on from there, led
aside by as much as the demonstrations answer a touch elsewhere on the gel; along directions in which they do
not, it lies where the object is. It lasts until the touch is gone: whoever let go by the clock would teach
that to let go is not a matter of touch.
"""

from dataclasses import dataclass, replace

import numpy as np

from pneutac_datasets.demonstrations.augment.reference import FIRM, Reference, frames_at
from pneutac_sim.errors import InputError, check_least
from pneutac_sim.features import ACTION_HIGH, CONTROL_HZ, MAX_PRESSURE_KPA, PRESSURES
from pneutac_sim.world.gantry import Gantry

SMALLEST_SPREAD = 0.1  # of the first spread, so that later iterations still look around
MEMORY = 0.7  # correlation of the jitter over 1/15 s: hands do not shake so fast


@dataclass(frozen=True)
class PlannerConfig:
    """Options of the planner; control steps are of 1/15 s, at another rate their number is scaled."""

    horizon: int = 10  # number of control steps that a plan looks ahead, H
    samples: int = 10  # number of action sequences that an iteration tries
    elites: int = 3  # number of the best sequences, which make the next mean and spread
    iterations: int = 2  # number of iterations of CEM at a replanning
    replan: int = 5  # number of control steps after which it plans again
    area_weight: float = 1.0  # weight of the squared error of the contact area, w
    position_weight: float = 50.0  # weight of the squared error of the flange position, lambda, 1/m2
    smoothness_weight: float = 0.01  # weight of the squared change of the action, mu
    jitter_m_s: float = 0.006  # spread of the velocities tried, m/s
    # spread of the pressures tried with a finger of 0 to 15 kPa; with another it is as large a share of its
    # range
    jitter_kpa: float = 0.6

    def __post_init__(self):
        check_least(2, horizon=self.horizon, elites=self.elites)
        check_least(3, samples=self.samples)
        check_least(1, iterations=self.iterations, replan=self.replan)
        for name, limit in (("elites", "samples"), ("replan", "horizon")):
            if getattr(self, name) > getattr(self, limit):
                raise InputError(
                    f"{name} is {getattr(self, name)}; it must be at most {limit} ({getattr(self, limit)})."
                )
        for name in ("area_weight", "position_weight", "smoothness_weight", "jitter_m_s", "jitter_kpa"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) >= 0):
                raise InputError(f"{name} is {getattr(self, name)}; it must be a number from 0 on.")

    def at(self, control_hz: int) -> "PlannerConfig":
        """The same for a control rate: as many seconds, and a change of the action by as much a second."""
        return replace(
            self,
            horizon=max(2, frames_at(control_hz, self.horizon)),
            replan=frames_at(control_hz, self.replan),
            smoothness_weight=self.smoothness_weight * (control_hz / CONTROL_HZ) ** 2,
        )


def demonstration_cost(
    area: np.ndarray,
    area_goal: np.ndarray,
    position_m: np.ndarray,
    position_goal_m: np.ndarray,
    actions: np.ndarray,
    previous: np.ndarray,
    config: PlannerConfig,
    scale: np.ndarray = ACTION_HIGH,
) -> np.ndarray:
    """Cost L (...,) of trajectories of H steps against the demonstrated one.

    Args:
        area: (..., H) contact areas c.
        area_goal: (H,) demonstrated ones c*; NaN where none is demonstrated, and touch costs nothing.
        position_m: (..., H, 3) flange positions x.
        position_goal_m: (H, 3) demonstrated ones x*.
        actions: (..., H, 3 + C) as `features.action_names`.
        previous: (3 + C,) the action before them.
        config: the weights.
        scale: (3 + C,) the largest action, by which changes are divided.
    """
    before = np.broadcast_to(previous, (*actions.shape[:-2], 1, actions.shape[-1]))
    change = np.diff(actions, axis=-2, prepend=before) / scale
    return (
        config.area_weight * np.nansum((area - area_goal) ** 2, -1)
        + config.position_weight * np.sum((position_m - position_goal_m) ** 2, (-2, -1))
        + config.smoothness_weight * np.sum(change**2, (-2, -1))
    )


class CemPlanner:
    """Plans on a gantry, whose `mirror` sets where a plan starts; `config` is for its control rate.

    `solve` tries the sequences on the gantry. Whoever tries those of many plans together calls `begin`, and
    then `draw` and `learn` once for each iteration.

    Attributes:
        best: (H, 3 + C) the last plan.
        cost: of it.
    """

    def __init__(
        self, gantry: Gantry, config: PlannerConfig, rng: np.random.Generator, control_hz: int = CONTROL_HZ
    ):
        self._gantry, self._config, self._rng = gantry, config, rng
        self.best = np.empty((0, len(gantry.action_limits[0])))
        self._memory = MEMORY ** (CONTROL_HZ / control_hz)
        self._low, self._high = gantry.action_limits
        widths_kpa = (self._high - self._low)[PRESSURES] / MAX_PRESSURE_KPA
        self._first = np.append([config.jitter_m_s] * 3, config.jitter_kpa * widths_kpa)
        self.cost = 0.0

    def solve(self) -> np.ndarray:
        """All iterations of the plan that was begun, on the gantry; returns `best`."""
        for _ in range(self._config.iterations):
            self.learn(*self._gantry.rollouts(self.draw()))
        return self.best

    def begin(
        self, warm: np.ndarray, previous: np.ndarray, area_goal: np.ndarray, position_goal_m: np.ndarray
    ) -> None:
        """Begins a plan, whose first iteration tries both the warm start and what is left of the last plan.

        Args:
            warm: (H, 3 + C) actions to start from.
            previous: (3 + C,) the last action that was carried out.
            area_goal: (H,) demonstrated contact areas after each action, see `demonstration_cost`.
            position_goal_m: (H, 3) demonstrated flange positions after each action.
        """
        rest = self.best[self._config.replan :][: len(warm)]
        self._warm, self._mean = warm, np.concatenate([rest, warm[len(rest) :]])
        self._spread = np.tile(self._first, (len(warm), 1))
        self._goals = previous, area_goal, position_goal_m
        self._tried, self._costs = np.empty((0, *warm.shape)), np.empty(0)

    def draw(self) -> np.ndarray:
        """Sequences (S, H, 3 + C) that an iteration tries."""
        batch = self._mean + self._spread * self._noise(self._config.samples, self._warm.shape)
        if not len(self._tried):
            batch[0], batch[1] = self._warm, self._mean
        self._batch = np.clip(batch, self._low, self._high)
        return self._batch

    def learn(self, position_m: np.ndarray, area: np.ndarray) -> None:
        """Moves mean and spread to the best of all that were tried.

        Args:
            position_m: (S, H, 3) flange positions to which the drawn sequences lead.
            area: (S, H) contact areas.
        """
        c, (previous, area_goal, position_goal_m) = self._config, self._goals
        goals, largest = (area_goal, position_m, position_goal_m), np.maximum(-self._low, self._high)
        cost = demonstration_cost(area, *goals, self._batch, previous, c, largest)
        self._tried = np.concatenate([self._tried, self._batch])
        self._costs = np.concatenate([self._costs, cost])
        order = np.argsort(self._costs, kind="stable")
        elites = self._tried[order[: c.elites]]
        self._mean, self._spread = elites.mean(0), np.maximum(elites.std(0), SMALLEST_SPREAD * self._first)
        self.best, self.cost = self._tried[order[0]], float(self._costs[order[0]])

    def _noise(self, samples: int, shape: tuple[int, ...]) -> np.ndarray:
        """Unit normal noise (samples, steps, 3 + C), correlated in time."""
        noise, memory = self._rng.standard_normal((samples, *shape)), self._memory
        for t in range(1, shape[0]):
            noise[:, t] = memory * noise[:, t - 1] + np.sqrt(1 - memory**2) * noise[:, t]
        return noise


# Frames of the paper's rate, see `reference.frames_at`.
EARLY = 16  # by which a touch may go before the demonstrated one
LATE_TOUCH, LATE_RELEASE = 8, 30  # and after it: who goes on for long has missed the object
GONE = 2  # frames without touch after which it is over
BUMP = 6  # frames; shorter contacts need not come


class Course:
    """The course of a demonstration through a new scene; `advance` is called once a control step.

    Args:
        reference: the demonstration.
        aside_m: how far to the side, along y, the object stands from where it stood.
        reaction_hz: (3, 2), see `reference.reaction_hz`.

    Attributes:
        frame: of the reference.
        offset_m: (3,) displacement of the reference's path now.
        in_contact: whether this frame belongs to a contact that has come.
        answer: (3 + C,) to be added to the action, as the touch is elsewhere on the gel than it was.
    """

    def __init__(self, reference: Reference, aside_m: float, reaction_hz: np.ndarray):
        self._contacts, self._reaction_hz = list(reference.contacts), reaction_hz
        self._centre_mm = _since_touched(reference)
        self._reference, self._aside_m, self._frames = reference, aside_m, reference.frames
        self._waited = self._lost = 0
        self._largest = 0.0
        self.frame, self.offset_m, self.in_contact = -1, np.zeros(3), False
        self.answer = np.zeros(reference.action.shape[1])

    def advance(self, area: float, centre_mm: np.ndarray, flange_m: np.ndarray) -> bool:
        """Goes on to the next frame; False where a demonstrated touch does not come, or does not end.

        Args:
            area: contact area that the gel feels.
            centre_mm: (2,) middle of the imprint; NaN without touch.
            flange_m: (3,) where the flange is.
        """
        self.frame += 1
        if self.in_contact and not self._stay_in_contact(area):
            return False
        goes_on = self.in_contact or self._search(area > 0, flange_m)
        # Where the touch is elsewhere than it was the way is led aside as the demonstrations do.
        self.answer = np.zeros_like(self.answer)
        elsewhere = 1e-3 * (centre_mm - self._centre_mm[min(self.frame, len(self._centre_mm) - 1)])
        if self.in_contact and np.isfinite(elsewhere).all():
            self.answer[:3] = self._reaction_hz @ elsewhere
        self.offset_m = self.offset_m + self.answer[:3] / self._reference.control_hz
        return goes_on

    def _stay_in_contact(self, area: float) -> bool:
        """Ends a contact when the touch is gone, up to `EARLY` frames too soon; False if it is too late."""
        end, gone = self._contacts[0][1], self._frames(GONE)
        self._largest = max(self._largest, area)
        self._lost = 0 if area >= FIRM * self._largest or self._lasts else self._lost + 1
        if self._lost >= gone and end - self.frame <= self._frames(EARLY):
            self.frame = end
        elif self.frame == end and self._lost < gone:
            self._waited += 1
            if self._waited > self._frames(LATE_RELEASE):
                return False
            self.frame = end - 1
            self.offset_m = self.offset_m + self.onward_m
        if self.frame >= end:
            del self._contacts[0]
            self.in_contact, self._waited, self._lost = False, 0, 0
        return True

    def _search(self, touched: bool, flange_m: np.ndarray) -> bool:
        """The free way, until the next touch comes."""
        self.offset_m = np.zeros(3)
        if not self._contacts:
            return True
        if touched:
            while len(self._contacts) > 1 and self._is_bump(self._contacts[0]):
                del self._contacts[0]
        first, end = self._contacts[0]
        if touched:
            self.frame, self.in_contact, self._waited, self._largest = first, True, 0, 0.0
            self.offset_m = flange_m - self._reference.flange_m[first]
            if not self._reaction_hz[1].any():
                self.offset_m[1] = self._aside_m
        elif self.frame == first and self._is_bump(self._contacts[0]):
            del self._contacts[0]
        elif self.frame == first:
            self._waited += 1
            self.frame = first - 1
            return self._waited <= self._frames(LATE_TOUCH)
        return True

    def _is_bump(self, contact: tuple[int, int]) -> bool:
        return contact[1] - contact[0] < self._frames(BUMP)

    @property
    def _lasts(self) -> bool:
        """Whether the demonstration ended in this contact: then a touch that flickers is no release."""
        return self._contacts[0][1] == len(self._reference)

    @property
    def last(self) -> int:
        """The last frame that is certain: whether a contact is released is up to the touch."""
        return self._contacts[0][1] - 1 if self.in_contact else len(self._reference) - 1

    def area_goal(self, frames: np.ndarray) -> np.ndarray:
        """Contact areas (H,) that the demonstration asks for at `frames` (H,) of the present contact.

        NaN where it had let go: whoever asked for its last area there would cling to what gives way at last,
        and then press whatever lies behind it. A demonstration that ended in touch asks for its last area.
        """
        areas = self._reference.area[np.minimum(frames, self.last)]
        return areas if self._lasts else np.where(frames > self.last, np.nan, areas)

    @property
    def onward_m(self) -> np.ndarray:
        """(3,) mean motion of a control step in the contact, by which it goes on after the last frame."""
        path, first = self._reference.flange_m, self._contacts[0][0] if self.in_contact else 0
        return (path[self.last] - path[first]) / max(self.last - first, 1)

    @property
    def waiting(self) -> bool:
        """Whether a touch, or its end, is overdue."""
        return self._waited > 0


def _since_touched(reference: Reference) -> np.ndarray:
    """Middles of the imprints (T, 2), mm; the first that is seen also where a contact begins too softly."""
    if reference.centre_mm is None:
        return np.full((len(reference), 2), np.nan)
    centre = reference.centre_mm.copy()
    for first, end in reference.contacts:
        seen = np.flatnonzero(np.isfinite(centre[first:end, 0]))
        if len(seen):
            centre[first : first + seen[0]] = centre[first + seen[0]]
    return centre
