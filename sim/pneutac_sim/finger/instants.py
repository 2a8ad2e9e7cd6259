"""When a command stepped: between two samples, at an instant that nobody wrote down.

Each step has an instant of its own, fitted to the few rows after it. That also fits their noise, so a model
is fitted and reported at these instants, but never chosen by them. It is judged by two rules:

1. A row is judged at the instant that the other rows after the same step choose (leave one out).
2. One instant serves all steps unless instants of their own predict better under rule 1.
"""

from collections.abc import Callable

import numpy as np

from pneutac_sim.finger.data import BodyData
from pneutac_sim.finger.pipeline import Pipeline
from pneutac_sim.finger.switches import steps

_AFTER = 6  # samples after a step that show its instant
_GRID = np.linspace(0, 1, 25)


def step_rows(recording) -> np.ndarray:
    """Rows before which the command of a recording (with `.samples`) steps."""
    trial = np.asarray(recording.samples["trial"])
    names = [c for c in recording.samples if c.startswith("pressure_cmd_")]
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
        grid = _GRID[:1] if "time_sent_s" in recording.samples else _GRID
        self._data = [read(float(share)).thin(self.rows.ravel()) for share in grid]

    def residual(self, data: BodyData, pipeline: Pipeline, theta: np.ndarray) -> np.ndarray:
        """(steps, 6, D) model - measured in these rows, in the unit of the error.

        Args:
            data: these rows of the recording.
            pipeline: the model.
            theta: (P,) its parameters.
        """
        run = pipeline.run(data.inputs, theta)
        r = (pipeline.outputs(run, data.columns) - data.measured) * data.scale
        return r.reshape(*self.rows.shape, -1)

    def errors(self, pipeline: Pipeline, theta: np.ndarray) -> np.ndarray:
        """(shares, steps) sums of squares over the rows of a step."""
        squared = (self._residuals(pipeline, theta) ** 2).sum(axis=-1) * self.own
        return squared.sum(axis=2)

    def judged(self, pipeline: Pipeline, theta: np.ndarray) -> np.ndarray:
        """(steps, 6, D) residual by which a model may be judged."""
        R = self._residuals(pipeline, theta)
        E = (R**2).sum(axis=-1) * self.own  # (shares, steps, 6)
        total = E.sum(axis=2)
        one = int(total.sum(axis=1).argmin())
        left_out = (total[..., None] - E).argmin(axis=0)  # chosen by the other rows of the step
        if total[one].sum() <= np.take_along_axis(E, left_out[None], 0).sum():
            return R[one]
        return np.take_along_axis(R, left_out[None, ..., None], 0)[0]

    def _residuals(self, pipeline: Pipeline, theta: np.ndarray) -> np.ndarray:
        return np.stack([self.residual(data, pipeline, theta) for data in self._data])


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

    Args:
        recording: with `.samples`.
        read: share of all steps to the recording read so.
        pipeline: the model.
        theta: (P,) its parameters.

    Returns:
        (n,), NaN where there is no step; None where there are none, or `time_sent_s` gives them.
    """
    if "time_sent_s" in recording.samples or not len(step_rows(recording)):
        return None
    return by_row(recording, StepRows(recording, read), pipeline, theta)


def by_row(recording, step: StepRows, pipeline: Pipeline, theta: np.ndarray) -> np.ndarray:
    """`instants` where the rows after steps have been read already."""
    out = np.full(len(recording.samples["trial"]), np.nan)
    out[step.at] = np.round(_least(step.errors(pipeline, theta)), 3)
    return out
