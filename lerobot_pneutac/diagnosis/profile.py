"""A second look at what the recording tells of each parameter: its profile likelihood.

A parameter is held at a value beside its best one and all others are fitted again. What the training
residuals lose by that, in units of their variance and counted with the effective number of samples, follows
chi-square with one degree of freedom (Wilks 1938); the values that lose less than 3.84 are the 95 % interval.
Unlike an interval from the Jacobian it sees curved valleys, and bounds that are reached before anything is
lost. It is told, and decides nothing.
"""

from dataclasses import dataclass

import numpy as np

from lerobot_pneutac.diagnosis.engine import Prepared, StageFitter
from lerobot_pneutac.diagnosis.fits import FittedModel
from lerobot_pneutac.diagnosis.parts import Parts
from lerobot_pneutac.diagnosis.steps import Steps
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.finger.confidence import Z95
from pneutac_sim.finger.data import BodyData
from pneutac_sim.finger.least_squares import minimise
from pneutac_sim.finger.pipeline import Pipeline
from pneutac_sim.finger.problem import Bounds, Problem
from pneutac_sim.twin import Twin

POINTS = 6  # most values tried on each side; one or two do where the model is nearly linear
OUTWARD = 3  # of them before the bound itself is tried
LEAST_GROWTH, GROWTH = 1.25, 10.0  # by which one try goes farther than the one before
STEPS = 4  # of each refit, which starts where the others are expected
CLOSE = 0.1  # of the limit's root: so near to it a straight line leads to it
IMPOSSIBLE = 1e9  # chi-square of a value that physics does not allow
NEGLIGIBLE = 0.02  # chi-square that is not worth another step of a refit


@dataclass(frozen=True)
class Profile:
    """What the recording tells of one parameter.

    Attributes:
        name: `effect.parameter`.
        unit: of the values.
        value: fitted.
        interval: 95 %; ends at a bound where the profile stays under the limit up to there.
        below: whether the data bound it from below.
        above: whether the data bound it from above.
        neutral: value at which the parameter does nothing.
        points: values that were tried and what each loses, chi-square.
    """

    name: str
    unit: str
    value: float
    interval: tuple[float, float]
    below: bool
    above: bool
    neutral: float
    points: tuple[tuple[float, float], ...]

    @property
    def remark(self) -> str:
        """What the interval says in words; empty where it is bounded on both sides."""
        free = {"below": not self.below, "above": not self.above}
        if not any(free.values()):
            return ""
        ends = zip(free.values(), self.interval, strict=True)
        nothing = any(open_ and end == self.neutral for open_, end in ends)
        sides = " or ".join(side for side, open_ in free.items() if open_)
        return f"not bounded {sides} by this data" + ("; it may be nothing" if nothing else "")


@dataclass(frozen=True)
class ProfileJob:
    """The profile of one parameter, to be run by an `Engine`.

    Attributes:
        twin: fitted.
        effects: switched on.
        free: names of the parameters that were fitted.
        name: of the parameter to be held.
        count: independent training samples.
        target: `pose` or `pressure`.
        source: `command` or `measured`.
    """

    twin: Twin
    effects: tuple[str, ...]
    free: tuple[str, ...]
    name: str
    count: float
    target: str
    source: str

    def run(self, prepared: Prepared) -> Profile:
        """Follows the valley to both sides."""
        bench = prepared.bench(self.twin, self.target, self.source)
        pipeline = Pipeline.of(self.twin, bench.inputs, list(self.effects))
        limits = Bounds(pipeline, bench.inputs.pressure_range_kpa)
        valley = _Valley(self, pipeline, limits, bench.thin(np.flatnonzero(prepared.train)))
        (low, below), (high, above) = valley.follow(-1), valley.follow(1)
        spec = pipeline.specs[valley.index]
        return Profile(
            name=self.name,
            unit=spec.unit,
            value=float(valley.theta[valley.index]),
            interval=(low, high),
            below=below,
            above=above,
            neutral=spec.neutral,
            points=tuple(sorted(valley.seen)),
        )


class _Valley:
    """Training residuals with one parameter held and the others at their best."""

    def __init__(self, job: ProfileJob, pipeline: Pipeline, limits: Bounds, bench: BodyData):
        self._pipeline, self._limits, self._bench = pipeline, limits, bench
        self.theta = pipeline.theta(job.twin, bench.inputs.pressure_range_kpa)
        self.index = pipeline.names.index(job.name)
        names = enumerate(pipeline.names)
        self._others = np.array([i for i, n in names if n in job.free and n != job.name], int)
        both = Problem(pipeline, bench, self.theta, limits, np.append(self._others, self.index))
        v = limits.scaled(self.theta, both.free)
        self._start, self._best = v[-1], v[:-1]
        r = both.residual(v)
        J = both.jacobian(v)
        self._J, j = J[:, :-1], J[:, -1]
        self._least = max(float(r @ r), 1e-30)
        self._worth = job.count * len(bench.columns) / self._least  # chi-square of one unit of cost
        loose = (self._best > 1e-6) & (self._best < 1 - 1e-6)  # those at a bound stay there
        self._along = np.zeros(len(self._best))
        self._along[loose] = -np.linalg.lstsq(self._J[:, loose], j, rcond=1e-6)[0]
        left = j + self._J @ self._along
        self._rise = 2 * self._worth * float(left @ r), self._worth * float(left @ left)
        self.seen: list[tuple[float, float]] = [(float(self.theta[self.index]), 0.0)]

    def follow(self, sign: int) -> tuple[float, bool]:
        """The interval's end on one side, and whether it comes before the bound.

        The root of chi-square is a straight line over the parameter where the model is linear, so the next
        value to try is found by the rule of false position, or halfway in magnitude while nothing near is
        known.
        """
        end = 1.0 if sign > 0 else 0.0
        room = abs(end - self._start)
        inside, outside = (0.0, 0.0), None
        reach, slope = self._guess(sign), self._along * sign
        for turn in range(POINTS if room > 1e-6 else 0):
            reach = room if outside is None and turn >= OUTWARD else min(reach, room)
            root, others = self._root(
                end if reach == room else self._start + sign * reach,
                np.clip(self._best + reach * slope, 0, 1),
            )
            if root < Z95:
                inside, slope = (reach, root), (others - self._best) / reach
                if reach == room:
                    break
            else:
                outside = (reach, root)
            if outside is None:
                reach *= np.clip(1.05 * Z95 / max(root, 1e-3), LEAST_GROWTH, GROWTH)
            elif min(outside[1] - Z95, Z95 - inside[1]) < CLOSE * Z95:
                break
            elif inside[0] > 0 and outside[0] > GROWTH * inside[0]:
                reach = np.sqrt(inside[0] * outside[0])
            else:
                reach = _crossing(inside, outside)
        if outside is None:
            return self._value(end), False
        return self._value(self._start + sign * _crossing(inside, outside)), True

    def _guess(self, sign: int) -> float:
        """Distance at which the limit is reached where the model is linear; at a bound it starts uphill."""
        b, a = max(0.0, sign * self._rise[0]), max(self._rise[1], 1e-12)
        return 2 * Z95**2 / (b + np.sqrt(b * b + 4 * a * Z95**2))

    def _root(self, v: float, guess: np.ndarray) -> tuple[float, np.ndarray]:
        """Root of the chi-square that is lost at a scaled value, and the others (F - 1,) there."""
        theta = self.theta.copy()
        theta[self.index] = self._value(v)
        problem = Problem(self._pipeline, self._bench, theta, self._limits, self._others)
        known = [self._J]  # the first step may do with the Jacobian of the fit

        def jacobian(at):
            return known.pop() if known else problem.jacobian(at)

        if not np.isfinite(problem.residual(guess)).all():  # the body gives way under its load, for example
            return self._lost(theta, IMPOSSIBLE), guess
        found = minimise(problem.residual, jacobian, guess, STEPS, NEGLIGIBLE / (self._worth * self._least))
        return self._lost(theta, self._worth * (found.cost - self._least)), found.v

    def _lost(self, theta: np.ndarray, chi2: float) -> float:
        """Notes a value; what fits better than the fit itself loses nothing."""
        chi2 = min(max(0.0, chi2), IMPOSSIBLE)
        self.seen.append((float(theta[self.index]), chi2))
        return float(np.sqrt(chi2))

    def _value(self, v: float) -> float:
        """The parameter at a scaled value."""
        return float(self._limits.value(np.array([v]), np.array([self.index]))[0])


def _crossing(inside: tuple[float, float], outside: tuple[float, float]) -> float:
    """Where the line through two (distance, root of chi-square) reaches the limit."""
    return inside[0] + (Z95 - inside[1]) * (outside[0] - inside[0]) / (outside[1] - inside[1])


def profile(
    fitter: StageFitter, fit: FittedModel, selected: list[str], parts: Parts, steps: Steps
) -> list[Profile]:
    """Profiles of all parameters of the selected effects.

    Args:
        fitter: of the stage in which `fit` was made; its engine runs the profiles.
        fit: the final fit.
        selected: effects that were found in this stage.
        parts: gives the training samples.
        steps: counts the jobs.
    """
    pieces = len(np.unique(parts.unit[parts.train]))
    count = fit.independent(parts.train, pieces)
    names = [f"{e}.{p.name}" for e in selected for p in get_effect(e).parameters if not p.fixed]
    steps.expect("how well each parameter is known", len(names))
    return fitter.engine.run(
        ProfileJob(fit.twin, fit.effects, tuple(fit.names), n, count, fitter.target, fitter.source)
        for n in names
    )
