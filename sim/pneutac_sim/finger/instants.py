"""When a command stepped: between two samples, at an instant that nobody wrote down."""

from collections.abc import Callable

import numpy as np

from pneutac_sim.finger.data import BodyData
from pneutac_sim.finger.pipeline import Pipeline
from pneutac_sim.finger.switches import steps

_AFTER = 6  # samples after a step that tell its instant
_GRID = np.linspace(0, 1, 25)


def step_rows(recording) -> np.ndarray:
    """Rows before which the command of a recording (with `.samples`) steps."""
    trial = np.asarray(recording.samples["trial"])
    names = [c for c in recording.samples if c.startswith("pressure_cmd_")]
    command = np.stack([np.asarray(recording.samples[c], dtype=float) for c in names], axis=1)
    return steps(command, np.r_[True, trial[1:] != trial[:-1]])


class StepErrors:
    """Errors of a model just after each step of the command, by the instant at which it stepped.

    Args:
        recording: with `.samples`.
        read: share of all steps to the recording read so.
        pipeline: the model.

    Attributes:
        at: rows before which the command steps.
        told: whether `time_sent_s` tells the instants.
    """

    def __init__(self, recording, read: Callable[[float], BodyData], pipeline: Pipeline):
        self.at, self.told = step_rows(recording), "time_sent_s" in recording.samples
        trial = np.asarray(recording.samples["trial"])
        rows = np.minimum(self.at[:, None] + np.arange(_AFTER), len(trial) - 1)
        self._same = trial[rows] == trial[self.at][:, None]
        grid = _GRID[:1] if self.told else _GRID
        self._data = [read(float(share)).thin(rows.ravel()) for share in grid]
        self._pipeline = pipeline

    def of(self, theta: np.ndarray) -> np.ndarray:
        """(shares, steps) sums of squares over the six samples after a step, at parameters (P,)."""
        errors = []
        for data in self._data:
            run = self._pipeline.run(data.inputs, theta)
            r = (self._pipeline.outputs(run, data.columns) - data.measured) * data.scale
            errors.append(((r**2).sum(axis=1).reshape(self._same.shape) * self._same).sum(axis=1))
        return np.stack(errors)

    def least(self, theta: np.ndarray) -> float:
        """Sum over all steps, each at the instant that suits it best."""
        return float(self.of(theta).min(axis=0).sum())


def instants(
    recording, read: Callable[[float], BodyData], pipeline: Pipeline, theta: np.ndarray
) -> np.ndarray | None:
    """The share of the time between two samples at which each step happened, as a model sees it.

    Each step has one number of its own, within one sample's time, found by the six samples after it.

    Args:
        recording: with `.samples`.
        read: share of all steps to the recording read so.
        pipeline: the model.
        theta: (P,) its parameters.

    Returns:
        (n,), NaN where there is no step; None where there are none, or `time_sent_s` tells them.
    """
    if "time_sent_s" in recording.samples or not len(step_rows(recording)):
        return None
    steps = StepErrors(recording, read, pipeline)
    E = steps.of(theta)
    best = E.argmin(axis=0)
    inner, step = np.clip(best, 1, len(_GRID) - 2), np.arange(len(steps.at))
    a, b, c = E[inner - 1, step], E[inner, step], E[inner + 1, step]
    x = _GRID[inner] + 0.5 * (a - c) / np.maximum(a - 2 * b + c, 1e-12) * _GRID[1]
    out = np.full(len(recording.samples["trial"]), np.nan)
    out[steps.at] = np.round(np.where(best == inner, np.clip(x, 0, 1), _GRID[best]), 3)
    return out
