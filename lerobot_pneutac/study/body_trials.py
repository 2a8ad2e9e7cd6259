"""What a trial has of its own, no part of the device: offsets of outputs; gain, zero, clock of the drive."""

from functools import cached_property

import numpy as np

from pneutac_sim.finger.data import BodyData
from pneutac_sim.finger.pipeline import Pipeline
from pneutac_sim.finger.problem import Problem

ALIKE = 8.0  # neighbouring samples of one kind: so many residuals are worth one independent one
TRIAL_RANGE = 6.0  # widths that a trial may be off


def of_each_trial(pipeline: Pipeline, data: BodyData, run, widths: tuple[float, ...]) -> np.ndarray:
    """(n, D, D + 3): what a width of a trial's offsets, gain, zero and clock does, in the error's unit."""
    offset, gain, zero, clock = widths
    p = data.inputs.pressure_range_kpa
    u, eps = run.signals[pipeline.drive], 1e-4 * p
    moved = pipeline.run(data.inputs, run.theta, run, u + eps)
    bent = (pipeline.outputs(moved, data.columns) - pipeline.outputs(run, data.columns)) * data.scale / eps
    n, d = bent.shape
    out = np.zeros((n, d, d + 3))
    out[:, range(d), range(d)] = offset * np.ptp(data.measured * data.scale, axis=0).max()
    share = u[data.inputs.rows].mean(axis=1, keepdims=True)
    out[:, :, d], out[:, :, d + 1] = gain * share * bent, zero * p * bent
    drive = u[data.inputs.rows]
    out[:, :, d + 2] = clock * rate(drive, data.inputs.sample_dt_s).mean(axis=1, keepdims=True) * bent
    return out


def rate(u: np.ndarray, dt_s: np.ndarray) -> np.ndarray:
    """(n, chambers) 1/s: change of the drive within a trial, to the sample before or the next, the smaller.

    A step is on one side of a sample alone, and a clock that is a little off does not move it past one.
    """
    begins = ~np.isfinite(dt_s)
    slope = np.diff(u, axis=0) / np.where(begins[1:], np.inf, dt_s[1:])[:, None]
    before, after = np.pad(slope, ((1, 0), (0, 0))), np.pad(slope, ((0, 1), (0, 0)))
    first, last = begins[:, None], np.r_[begins[1:], True][:, None]
    before, after = np.where(first, after, before), np.where(last, before, after)
    return np.where(before * after > 0, np.sign(before) * np.minimum(np.abs(before), np.abs(after)), 0.0)


class TrialProblem:
    """A problem in which each trial has offsets of its outputs, a gain and a zero of its drive.

    Args:
        problem: without them.
        trial: (N,) of each row.
        trials: how many there are, also those of which there is no row.
    """

    def __init__(self, problem: Problem, trial: np.ndarray, trials: int, widths: tuple[float, ...]):
        self._problem, self._trial, self._widths, self.free = problem, trial, widths, problem.free
        self._trials, self.count = trials, trials * (len(problem.data.columns) + 3)

    def begin(self, v: np.ndarray) -> np.ndarray:
        """The same parameters of the device, with the zeros that suit them best under their prior."""
        zeros = 0.5 + np.zeros(self.count)
        for _ in range(2):
            r = self.residual(np.r_[v, zeros])
            C, stiff = self._columns, np.mean(r**2) * ALIKE * (2 * TRIAL_RANGE) ** 2
            H = C.T @ C + stiff * np.eye(self.count)
            zeros = np.clip(zeros - np.linalg.solve(H, C.T @ r + stiff * (zeros - 0.5)), 0.0, 1.0)
        return np.r_[v, zeros]

    def theta(self, v: np.ndarray) -> np.ndarray:
        """All parameters of the device."""
        return self._problem.theta(v[: len(self.free)])

    def residual(self, v: np.ndarray) -> np.ndarray:
        """Model - measured."""
        r = self._problem.residual(v[: len(self.free)])
        return r + self._columns @ (v[len(self.free) :] - 0.5)

    def jacobian(self, v: np.ndarray) -> np.ndarray:
        """Of the residual."""
        J = self._problem.jacobian(v[: len(self.free)])
        return np.concatenate([J, self._columns], axis=1)

    @cached_property
    def _columns(self) -> np.ndarray:
        """(N D, count): what each trial's numbers do, over their range, where the problem was last run."""
        problem = self._problem
        each = of_each_trial(problem.pipeline, problem.data, problem.run, self._widths)
        n, d = each.shape[:2]
        out = np.zeros((n, d, self._trials, d + 3))
        out[np.arange(n), :, self._trial] = 2 * TRIAL_RANGE * each
        return out.reshape(n * d, -1)
