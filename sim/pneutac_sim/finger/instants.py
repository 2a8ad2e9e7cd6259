"""When a command stepped: between two samples, at an instant that nobody wrote down.

Each step has an instant of its own, fitted to the few rows after it, at which a model is fitted and reported.
That also fits their noise, so models are not compared by these errors as they stand:

1. What a fitted number takes out of the noise is added back: of variance s^2, each row of the step gets its
   leverage on the instant times `COST` s^2 (the correction of Mallows' C_p).
2. One instant serves all steps unless instants of their own are better by rule 1.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from pneutac_sim.finger.data import BodyData
from pneutac_sim.finger.inputs import pressure_columns, steps
from pneutac_sim.finger.pipeline import Pipeline

COST = (
    1.5  # of the noise's variance: what an instant of its own must gain; by fitting noise it gains up to one
)
_AFTER = 6  # samples after a step that show its instant
_GRID = np.linspace(0, 1, 25)


def step_rows(recording) -> np.ndarray:
    """Rows before which the command of a recording (with `.samples`) steps."""
    trial = np.asarray(recording.samples["trial"])
    names = pressure_columns(recording.device)[0]
    command = np.stack([np.asarray(recording.samples[c], dtype=float) for c in names], axis=1)
    return steps(command, np.r_[True, trial[1:] != trial[:-1]])


class StepRows:
    """The samples just after each step of the command, read with the step at several instants.

    Args:
        recording: with `.samples`.
        read: share of all steps to the recording read so.

    Attributes:
        at: rows before which the command steps.
        rows: (steps, 6) rows from there on.
        own: (steps, 6) whether a row belongs to the step: the same trial, before the next step.
    """

    def __init__(self, recording, read: Callable[[float], BodyData]):
        self.at = step_rows(recording)
        trial = np.asarray(recording.samples["trial"])
        wanted = self.at[:, None] + np.arange(_AFTER)
        self.rows = np.minimum(wanted, len(trial) - 1)
        end = np.r_[self.at[1:], len(trial)][: len(self.at)]
        self.own = (wanted < end[:, None]) & (trial[self.rows] == trial[self.at][:, None])
        data = read(0.5)
        last, near = data.inputs.rows[self.at], data.thin(self.rows.ravel())
        self._data = [near]
        if "time_sent_s" not in recording.samples:
            moved = [near.inputs.switched_at(last, float(share)) for share in _GRID]
            self._data = [replace(near, inputs=inputs) for inputs in moved]

    def residual(self, data: BodyData, pipeline: Pipeline, theta: np.ndarray) -> np.ndarray:
        """(steps, 6, D) model - measured in these rows of the recording, in the unit of the error."""
        run = pipeline.run(data.inputs, theta)
        r = (pipeline.outputs(run, data.columns) - data.measured) * data.scale
        return r.reshape(*self.rows.shape, -1)

    def errors(self, pipeline: Pipeline, theta: np.ndarray) -> np.ndarray:
        """(shares, steps) sums of squares over the rows of a step."""
        return self._errors(self._residuals(pipeline, theta)).sum(axis=2)

    def judged(self, pipeline: Pipeline, theta: np.ndarray, variance: float) -> tuple[np.ndarray, np.ndarray]:
        """By what models are compared: residual (steps, 6, D) and what is added to its squares (steps, 6).

        `variance` is the mean square of the model's residual, summed over outputs.
        """
        R = self._residuals(pipeline, theta)
        E = self._errors(R)
        total = E.sum(axis=2)
        one, best = int(total.sum(axis=1).argmin()), total.argmin(axis=0)
        step = np.arange(len(self.at))
        low, high = np.maximum(best - 1, 0), np.minimum(best + 1, len(R) - 1)
        moved = self._errors((R[high, step] - R[low, step])[None])[0]
        leverage = moved / np.maximum(moved.sum(axis=1, keepdims=True), 1e-300)
        cost = COST * variance * leverage
        if total[one].sum() <= E[best, step].sum() + cost.sum():
            return R[one], np.zeros_like(cost)
        return R[best, step], cost

    def _residuals(self, pipeline: Pipeline, theta: np.ndarray) -> np.ndarray:
        return np.stack([self.residual(data, pipeline, theta) for data in self._data])

    def _errors(self, R: np.ndarray) -> np.ndarray:
        return (R**2).sum(axis=-1) * self.own


def _least(E: np.ndarray) -> np.ndarray:
    """(k,) shares at which errors (shares, k) are least, between those of the grid by a parabola."""
    best = E.argmin(axis=0)
    inner, k = np.clip(best, 1, len(_GRID) - 2), np.arange(E.shape[1])
    a, b, c = E[inner - 1, k], E[inner, k], E[inner + 1, k]
    x = _GRID[inner] + 0.5 * (a - c) / np.maximum(a - 2 * b + c, 1e-12) * _GRID[1]
    return np.where(best == inner, np.clip(x, 0, 1), _GRID[best])


def instants(
    recording, read: Callable[[float], BodyData], pipeline: Pipeline, theta: np.ndarray
) -> np.ndarray | None:
    """The share of the time between two samples at which each step happened, as a model sees it.

    (n,), NaN where there is no step; None where there are none, or `time_sent_s` gives them. `read` takes a
    share of all steps to the recording read so.
    """
    if "time_sent_s" in recording.samples or not len(step_rows(recording)):
        return None
    return by_row(recording, StepRows(recording, read), pipeline, theta)


def by_row(recording, step: StepRows, pipeline: Pipeline, theta: np.ndarray) -> np.ndarray:
    """`instants` where the rows after steps have been read already."""
    out = np.full(len(recording.samples["trial"]), np.nan)
    out[step.at] = np.round(_least(step.errors(pipeline, theta)), 3)
    return out
