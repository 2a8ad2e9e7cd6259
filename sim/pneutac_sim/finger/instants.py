"""When a command stepped: between two samples, at an instant that nobody wrote down.

Each step has an instant of its own, fitted to the few rows after it, at which a model is fitted and reported.
That also fits their noise, so models are not compared by these errors as they stand:

1. What a fitted number takes out of the noise is added back: of variance s^2, each row of the step gets its
   leverage on the instant times `COST` s^2 (the correction of Mallows' C_p).
2. One instant serves all steps unless instants of their own are better by rule 1.

A computer that holds each command until the next does so in ramps too: these are read as held, each command
sent where steps typically are, if the whole recording fits better so (`inputs.held`).

How long the device rested before each run is found likewise where the log does not have it: a pause is one
number a run, fitted to the poses of that run (`pauses`).
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from pneutac_sim.finger.data import BodyData
from pneutac_sim.finger.inputs import pressure_columns, shares, steps
from pneutac_sim.finger.pipeline import Pipeline
from pneutac_sim.finger.problem import Bounds, Problem
from pneutac_sim.finger.sent import sent_times

# Of the noise's variance: what an instant of its own must gain; by fitting noise it gains up to one.
COST = 1.5
_AFTER = 6  # samples after a step that show its instant
_GRID = np.linspace(0, 1, 25)
_FIRST, _NEARER = 4, (2, 1)  # apart in the grid: what is tried first, and on both sides of the best so far


def step_rows(recording) -> np.ndarray:
    """Rows before which the command of a recording (with `.samples`) steps."""
    return steps(*_command(recording))


def _command(recording) -> tuple[np.ndarray, np.ndarray]:
    """The command (n, chambers) and where a trial begins (n,)."""
    trial = np.asarray(recording.samples["trial"])
    names = pressure_columns(recording.device)[0]
    command = np.stack([np.asarray(recording.samples[c], dtype=float) for c in names], axis=1)
    return command, np.r_[True, trial[1:] != trial[:-1]]


class StepRows:
    """The samples just after each step of the command, read with the step at several instants.

    `read` takes the share of all steps to the recording read so.

    Attributes:
        at: rows before which the command steps.
        read: as given.
        unknown: (steps,) whether the instant of a step is not known; where the recording has the times at
            which commands were sent, few or none.
        rows: (steps, 6) rows from there on.
        own: (steps, 6) whether a row belongs to the step: the same trial, before the next step.
    """

    def __init__(self, recording, read: Callable[..., BodyData]):
        self.at, self.read = step_rows(recording), read
        trial = np.asarray(recording.samples["trial"])
        wanted = self.at[:, None] + np.arange(_AFTER)
        self.rows = np.minimum(wanted, len(trial) - 1)
        end = np.r_[self.at[1:], len(trial)][: len(self.at)]
        self.own = (wanted < end[:, None]) & (trial[self.rows] == trial[self.at][:, None])
        data = read(0.5)
        self._last, self._near = data.inputs.rows[self.at], data.thin(self.rows.ravel())
        self._earliest, self._latest = shares(recording.samples, *_command(recording))
        self.unknown = self._latest > self._earliest

    def instant(self, share: float | np.ndarray) -> np.ndarray:
        """(steps,) of the time between two samples, at a share of when each step may have come."""
        return self._earliest + share * (self._latest - self._earliest)

    def switched(self, share: float | np.ndarray) -> BodyData:
        """These rows with all steps at one share of when they may have come, or each (steps,) at its own."""
        last, instant = self._last[self.unknown], self.instant(share)[self.unknown]
        return replace(self._near, inputs=self._near.inputs.switched_at(last, instant))

    def residual(self, data: BodyData, pipeline: Pipeline, theta: np.ndarray) -> np.ndarray:
        """(steps, 6, D) model - measured in these rows of the recording, in the unit of the error."""
        run = pipeline.run(data.inputs, theta, until=pipeline.until(data.columns))
        r = (pipeline.outputs(run, data.columns) - data.measured) * data.scale
        return r.reshape(*self.rows.shape, -1)

    def errors(self, pipeline: Pipeline, theta: np.ndarray) -> np.ndarray:
        """(shares, steps) sums of squares over the rows of a step; infinite where it was not tried."""
        return self.squared(self.residuals(pipeline, theta)).sum(axis=2)

    def judged(self, pipeline: Pipeline, theta: np.ndarray, variance: float) -> tuple[np.ndarray, np.ndarray]:
        """By what models are compared: residual (steps, 6, D) and what is added to its squares (steps, 6).

        `variance` is the mean square of the model's residual, summed over outputs.
        """
        R = self.residuals(pipeline, theta)
        E = self.squared(R)
        best, one = E.sum(axis=2).argmin(axis=0), self._at_one(R, pipeline, theta)
        step = np.arange(len(self.at))
        low, high = np.maximum(best - 1, 0), np.minimum(best + 1, len(R) - 1)
        moved = self.squared((R[high, step] - R[low, step])[None])[0]
        leverage = moved / np.maximum(moved.sum(axis=1, keepdims=True), 1e-300)
        cost = COST * variance * leverage
        if self.squared(one).sum() <= E[best, step].sum() + cost.sum():
            return one, np.zeros_like(cost)
        return R[best, step], cost

    def _at_one(self, R: np.ndarray, pipeline: Pipeline, theta: np.ndarray) -> np.ndarray:
        """`residual` at the share that is best for all steps together, where `residuals` are R."""
        tried = {share: R[share] for share in range(0, len(R), _FIRST)}
        least = lambda share: float(self.squared(tried[share]).sum())  # noqa: E731
        for away in _NEARER if len(R) > 1 else ():
            best = min(tried, key=least)
            for share in {best - away, best + away} & set(range(len(_GRID))):
                tried[share] = self.residual(self.switched(_GRID[share]), pipeline, theta)
        return tried[min(tried, key=least)]

    def residuals(self, pipeline: Pipeline, theta: np.ndarray) -> np.ndarray:
        """`residual` (shares, steps, 6, D) of each step at the shares that are tried; infinite at others.

        Each step is tried nearer and nearer to its best share, so that this and its neighbours are known.
        """
        if not self.unknown.any():
            return self.residual(self._near, pipeline, theta)[None]
        each = np.arange(len(self.at))
        out = np.full((len(_GRID), *self.rows.shape, len(self._near.columns)), np.inf)

        def run(share: np.ndarray) -> None:
            new, share = (share >= 0) & (share < len(_GRID)), np.clip(share, 0, len(_GRID) - 1)
            residual = self.residual(self.switched(_GRID[share]), pipeline, theta)
            out[share[new], each[new]] = residual[new]

        for share in range(0, len(_GRID), _FIRST):
            run(np.full(len(each), share))
        for away in _NEARER:
            error = self.squared(out).sum(axis=2)
            run(error.argmin(axis=0) - away)
            run(error.argmin(axis=0) + away)
        return out

    def squared(self, R: np.ndarray) -> np.ndarray:
        """(shares, steps, 6) of `residuals`, summed over outputs; 0 in rows of other steps."""
        return np.where(self.own, (R**2).sum(axis=-1), 0.0)


class StepProblem:
    """Residuals of the rows after steps as a function of free parameters, each step at its best instant.

    The derivative leaves out what moving the instants does as well (variable projection, Kaufman's form:
    Golub, Pereyra, Inverse Problems 19, 2003).

    `theta` takes scaled values (F,) to all parameters (P,), see `Problem.theta`; arguments as of `Problem`.
    """

    def __init__(self, steps: StepRows, pipeline: Pipeline, theta: np.ndarray, bounds: Bounds, free):
        self._steps = steps
        self._problem = lambda share: Problem(pipeline, steps.switched(share), theta, bounds, free)
        self._best, self._along = np.zeros(0, int), np.zeros(0)
        self.theta = self._problem(0.5).theta
        self._residuals = lambda v: steps.residuals(pipeline, self.theta(v))

    def residual(self, v: np.ndarray) -> np.ndarray:
        """Model - measured (rows D,), in the unit of the error."""
        R = np.where(self._steps.own[:, :, None], self._residuals(v), 0.0)
        self._best, k = self._steps.squared(R).sum(axis=2).argmin(axis=0), np.arange(R.shape[1])
        inner = np.clip(self._best, 1, len(R) - 2)
        along = R[inner + 1, k] - R[inner - 1, k] if len(R) > 1 else np.zeros_like(R[0])
        self._along = np.where((inner == self._best)[:, None, None], along, 0.0)
        return R[self._best, k].ravel()

    def jacobian(self, v: np.ndarray) -> np.ndarray:
        """Derivative (rows D, F) of it, at the v of the last call of `residual`."""
        shape = (len(self._best), -1, len(v))
        J = self._problem(_GRID[self._best]).jacobian(v).reshape(*self._along.shape, -1)
        J = (J * self._steps.own[:, :, None, None]).reshape(shape)
        along = self._along.reshape(shape[:2])
        along = along / (np.linalg.norm(along, axis=1, keepdims=True) + 1e-300)
        J = J - along[:, :, None] * np.einsum("si,sif->sf", along, J)[:, None]
        return J.reshape(-1, len(v))


def _least(E: np.ndarray) -> np.ndarray:
    """(k,) shares at which errors (shares, k) are least, between those of the grid by a parabola."""
    best = E.argmin(axis=0)
    inner, k = np.clip(best, 1, len(_GRID) - 2), np.arange(E.shape[1])
    a, b, c = E[inner - 1, k], E[inner, k], E[inner + 1, k]
    x = _GRID[inner] + 0.5 * (a - c) / np.maximum(a - 2 * b + c, 1e-12) * _GRID[1]
    return np.where(best == inner, np.clip(x, 0, 1), _GRID[best])


def instants(
    recording,
    read: Callable[..., BodyData],
    pipeline: Pipeline,
    theta: np.ndarray,
    usual: float | None = None,
) -> np.ndarray | None:
    """The share of the time between two samples at which each step happened, as a model sees it.

    (n,), NaN where there is no step and ramps go straight, or `time_sent_s` has the time; None where there
    is no other. `read` takes a share of all steps, or (n,) of each row, to the recording read so. Without a
    step, the commands of ramps may be sent at the `usual` share.
    """
    earliest, latest = shares(recording.samples, *_command(recording))
    if (latest > earliest).any():
        return by_row(recording, StepRows(recording, read), pipeline, theta)
    if len(latest) or usual is None or _sent_known(recording):
        return None
    none = np.full(len(recording.samples["trial"]), np.nan)
    return _as_held(none, usual, read, pipeline, theta)


def by_row(recording, step: StepRows, pipeline: Pipeline, theta: np.ndarray) -> np.ndarray:
    """`instants` where the rows after steps have been read already."""
    out = np.full(len(recording.samples["trial"]), np.nan)
    found = step.instant(_least(step.errors(pipeline, theta)))
    out[step.at[step.unknown]] = np.round(found, 3)[step.unknown]
    if _sent_known(recording):
        return out
    return _as_held(out, float(np.median(out[step.at])), step.read, pipeline, theta)


def _sent_known(recording) -> bool:
    """Whether it is known when the commands of ramps were sent."""
    command, first = _command(recording)
    time = np.asarray(recording.samples["time_s"], dtype=float)
    return "time_sent_s" in recording.samples or bool(np.isfinite(sent_times(time, command, first)).any())


def _as_held(out: np.ndarray, share: float, read, pipeline: Pipeline, theta: np.ndarray) -> np.ndarray:
    """Instants `out` (n,), with ramps whose commands are held, sent at one share, where that fits better."""
    ramps = np.where(np.isnan(out), share, out)

    def error(share: np.ndarray) -> float:
        data = read(share)
        run = pipeline.run(data.inputs, theta, until=pipeline.until(data.columns))
        return float((((pipeline.outputs(run, data.columns) - data.measured) * data.scale) ** 2).sum())

    return ramps if error(ramps) < error(out) else out


RESTED_S = 1e4  # a pause at zero pressure after which everything has rested
GRID_S = np.r_[0.0, np.geomspace(1.0, 400.0, 9), RESTED_S]
_FACTORS = 2.0 ** np.array([0.5, -0.5, 0.5, -0.5, 0.25, -0.25, 0.12, -0.12])


def unknown_pauses(recording) -> np.ndarray:
    """Indices of the first samples of runs before which the pause is not stated; never the first run."""
    trial = np.asarray(recording.samples["trial"])
    first = np.flatnonzero(trial[1:] != trial[:-1]) + 1
    stated = getattr(recording, "meta", {}).get("trials", {})
    known = {k for k, how in stated.items() if how.get("start") == "rested" or "pause_s" in how}
    return first[np.array([str(trial[i]) not in known for i in first], dtype=bool)]


def goes_on(pipeline: Pipeline) -> bool:
    """Whether what a model does in a run depends on how long the pause before it was."""
    clocked = any("session_time_s" in e.columns for e in pipeline.effects)
    return clocked or any(link.remembers for link in pipeline.chain)


def pauses_read(recording, data: BodyData) -> np.ndarray:
    """(k,) s at zero pressure before the runs of `unknown_pauses`, as `data` was read with finite ones."""
    return data.inputs.dt_s[data.inputs.rows[unknown_pauses(recording)] - 1]


def pauses(
    recording, data: BodyData, rows: np.ndarray, pipeline: Pipeline, theta: np.ndarray
) -> tuple[float, ...] | None:
    """Seconds at zero pressure before each run (trials,), as a model sees it; the median where not asked for.

    A run keeps the pause that `data` was read with where its own gains no more than fitting it to noise does.

    Args:
        recording: with `.samples`, and `.meta`, where pauses may be stated.
        data: of all samples, read with a finite pause before each run.
        rows: (m,) samples by which it is judged.
        pipeline: of the model.
        theta: (P,) its parameters.

    Returns None where all are stated, or nothing in the model remembers.
    """
    own = unknown_pauses(recording)
    if not len(own) or not goes_on(pipeline):
        return None
    clock_alone = not any(link.remembers for link in pipeline.chain)
    trial = np.asarray(recording.samples["trial"])
    number = np.cumsum(np.r_[True, trial[1:] != trial[:-1]]) - 1
    at, thin = data.inputs.rows[own] - 1, data.thin(rows)

    def of(x: np.ndarray) -> np.ndarray:
        """(k,) pauses, of what is fitted."""
        return np.diff(np.maximum.accumulate(x), prepend=0.0) if clock_alone else x

    def errors(x: np.ndarray) -> np.ndarray:
        """(k,) sums of squares over the rows of these runs."""
        run = pipeline.run(thin.inputs.paused(at, of(x)), theta, until=pipeline.until(thin.columns))
        r = (pipeline.outputs(run, thin.columns) - thin.measured) * thin.scale
        return np.bincount(number[rows], (r**2).sum(axis=1), minlength=number[-1] + 1)[number[own]]

    usual = pauses_read(recording, data)
    each = np.arange(1.0, len(own) + 1) if clock_alone else np.ones(len(own))
    now = errors(np.cumsum(usual) if clock_alone else usual)
    best = each * GRID_S[np.array([errors(s * each) for s in GRID_S]).argmin(axis=0)]
    least = errors(best)
    for factor in _FACTORS:
        tried = errors(factor * best)
        best, least = np.where(tried < least, factor * best, best), np.minimum(tried, least)
    variance = now.sum() / max(np.isin(number[rows], number[own]).sum(), 1)
    found = of(best) if clock_alone else np.where(now - least > COST * variance, best, usual)
    out = np.full(number[-1] + 1, np.median(found))
    out[number[own]] = found
    return tuple(map(float, out))
