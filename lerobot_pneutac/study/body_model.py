"""Models of a body that a search fits: which effects, how the recording is read, and all their parameters."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.optimize import lsq_linear

from lerobot_pneutac.diagnosis import thresholds as T
from lerobot_pneutac.diagnosis.search import Structure
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.finger.data import BodyData
from pneutac_sim.finger.fit import rough_drive
from pneutac_sim.finger.instants import StepRows
from pneutac_sim.finger.pipeline import Pipeline
from pneutac_sim.finger.problem import Bounds, Problem, past_jumps
from pneutac_sim.least_squares import minimise
from pneutac_sim.twin import Twin

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

    `trial` (N,) is of each row; `trials` counts also those of which there is no row.
    """

    def __init__(self, problem: Problem, trial: np.ndarray, trials: int, widths: tuple[float, ...]):
        self._problem, self._trial, self._widths, self.free = problem, trial, widths, problem.free
        self._trials, self.count = trials, trials * (len(problem.data.columns) + 3)

    def begin(self, v: np.ndarray) -> np.ndarray:
        """The same parameters of the device, with the zeros that suit them best under their prior."""
        zeros = 0.5 + np.zeros(self.count)
        for _ in range(2):
            r = self.residual(np.r_[v, zeros])
            C, stiff = self._columns, np.mean(r**2) * T.CORRELATED * (2 * TRIAL_RANGE) ** 2
            H = C.T @ C + stiff * np.eye(self.count)
            zeros = np.clip(zeros - np.linalg.solve(H, C.T @ r + stiff * (zeros - 0.5)), 0.0, 1.0)
        return np.r_[v, zeros]

    def theta(self, v: np.ndarray) -> np.ndarray:
        return self._problem.theta(v[: len(self.free)])

    def residual(self, v: np.ndarray) -> np.ndarray:
        r = self._problem.residual(v[: len(self.free)])
        return r + self._columns @ (v[len(self.free) :] - 0.5)

    def nearby(self, v: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        near, of_trials = (
            self._problem.nearby(v[: len(self.free)]),
            self._columns @ (v[len(self.free) :] - 0.5),
        )
        return lambda other: near(other[: len(self.free)]) + of_trials

    def jacobian(self, v: np.ndarray) -> np.ndarray:
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


# Standard deviation of what is not a law, in its own unit, before any data is seen; at full pressure where a
# parameter is counted per kPa.
PRIOR = {
    "bend": 0.4,
    "curl_rad": 0.4,
    "turn": 0.3,
    "base_tilt.pitch_rad": 0.05,
    "base_tilt.yaw_rad": 0.1,
    "base_tilt.roll_rad": 0.1,
    "base_tilt.shift_x_mm": 3.0,
    "base_tilt.shift_y_mm": 3.0,
    "base_tilt.shift_z_mm": 3.0,
    "elongation.strain_1_per_kpa": 0.05,
    "curvature_reading.uneven_1_per_rad2": 0.05,
    "payload.share": 3.0,
    "gravity.body_mass_g": 300.0,
    "gravity.tip_mass_g": 300.0,
}
LAW_WEIGHT = 1.0
MANY = 3  # steps of each half of a fit from which on it also looks past jumps


@dataclass(frozen=True)
class InputModel:
    """How a recording is taken to have been made; see `Inputs.from_samples`."""

    source: str = "command"  # `command` or `measured` pressure drives the model
    target: str = "pose"  # `pose` or `pressure` is predicted
    start: str | float | tuple[float, ...] = "held"  # of all trials, or the pause before each
    # (n,) instants at which the command steps, as a tuple; one for all; None for no steps
    switch: float | tuple[float, ...] | None = None


@dataclass(frozen=True)
class BodyStructure(Structure):
    """The structure of a model."""

    input_model: InputModel = InputModel()  # of the recording
    joints: int = 8  # of the spine
    # whether bend profile, curl and directions of chambers are the device's, or the paper's
    own_profile: bool = True
    # widths of what each trial has of its own, no part of the device: offset of outputs, as a share of their
    # range, gain of the drive, its zero, as a share of the pressure's, and its clock, s; empty for none
    trials: tuple[float, ...] = ()


@dataclass
class BodyModel:
    """A fitted model."""

    structure: BodyStructure  # its structure
    pipeline: Pipeline  # that runs it
    theta: np.ndarray  # (P,) all parameters
    free: np.ndarray  # (F,) those that were fitted
    v: np.ndarray  # (F,) their scaled values
    residual: np.ndarray  # (N, D) model - measured at the rows of the search, in the unit of the error
    # returns `jacobian`; most models of a search are never asked for it
    slope: Callable[[], np.ndarray] = field(repr=False)
    weight: np.ndarray  # (F, F) of the prior, in units of the residual's squares
    pull: np.ndarray  # (F,) weight times the distance from the prior's centre
    counted: int  # columns that count in the error
    bounds: Bounds = field(repr=False)  # of the parameters
    # (trials, D + 3) offset of each output, gain, zero and clock of the drive, in their widths
    of_trials: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)), repr=False)
    # that fitted it; None where no instants of steps were fitted
    fitter: "BodyFitter | None" = field(default=None, repr=False)

    @property
    def values(self) -> dict[str, float]:
        return dict(zip(self.pipeline.names, map(float, self.theta), strict=True))

    @property
    def cost(self) -> int:
        """Number of parameters, which a simpler model has fewer of; one stuck at a bound counts twice."""
        stuck = (self.v <= T.AT_BOUND) | (self.v >= 1 - T.AT_BOUND)
        return len(self.free) + int(stuck.sum())

    @property
    def jacobian(self) -> np.ndarray:
        """(N D, F) of the residual; with further columns for what each trial has of its own."""
        J = self.slope()
        self.slope = lambda: J  # and no longer the recording and the run that it came from
        return J

    @property
    def squared(self) -> np.ndarray:
        """(N,) squared errors on the rows of the search, as they were fitted."""
        return (self.residual[:, : self.counted] ** 2).sum(axis=1)

    @cached_property
    def normal(self) -> np.ndarray:
        return self.jacobian.T @ self.jacobian + self.weight

    @cached_property
    def judged(self) -> tuple[np.ndarray, np.ndarray]:
        """Residual (N, D) and what is to be added to its squares (N,), see `finger.instants`."""
        if self.fitter is None or not isinstance(self.structure.input_model.switch, tuple):
            return self.residual, np.zeros(len(self.residual))
        return self.fitter.judged(self)

    def cv_squared(self, fold: np.ndarray) -> np.ndarray:
        """(N,) squared errors, each by a fit without its own fold, one Gauss-Newton step from the whole one.

        Errors are counted as `judged` says. The step stays within bounds and within `thresholds.FAR`, where
        a linear model says something. Rows of a negative fold (N,) stay out and count 0.
        """
        d, of_trials = self.residual.shape[1], np.arange(len(self.v), self.jacobian.shape[1])
        out = np.zeros(len(fold))
        moves = np.flatnonzero((self.v > 1e-6) & (self.v < 1 - 1e-6))
        low, high = np.maximum(-self.v, -T.FAR)[moves], np.minimum(1 - self.v, T.FAR)[moves]
        use, (judged, added) = np.r_[moves, of_trials], self.judged
        if not len(use):
            return np.where(fold >= 0, (judged[:, : self.counted] ** 2).sum(axis=1) + added, 0.0)
        J = self.jacobian.reshape(len(fold), d, -1)[:, :, use]
        H = self.normal[np.ix_(use, use)]
        H = H + 1e-9 * np.trace(H) / len(H) * np.eye(len(H))
        slope = self.jacobian.T @ self.residual.ravel() + self.pull
        for k in range(fold.max() + 1):
            mine = fold == k
            Jk, rk = J[mine].reshape(-1, len(use)), self.residual[mine]
            step = _least_within(H - Jk.T @ Jk, Jk.T @ rk.ravel() - slope[use], low, high)
            moved = judged[mine] + (Jk @ step).reshape(rk.shape)
            out[mine] = (moved[:, : self.counted] ** 2).sum(axis=1) + added[mine]
        # A fit that stopped early is promised the rest of its way by the step: it counts by its own errors.
        left_in = float(np.where(fold >= 0, (judged[:, : self.counted] ** 2).sum(axis=1) + added, 0.0).sum())
        return out * max(1.0, left_in / max(float(out.sum()), 1e-300))


def _least_within(H: np.ndarray, g: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The x (F,) that makes x H x / 2 - g x least, its first (B,) within bounds (B,).

    To cut single numbers of a poorly determined combination would move the model far.
    """
    n = len(low)
    others = np.linalg.solve(H[n:, n:], np.c_[g[n:], H[n:, :n]])  # of no bounds: as the first ones have it
    size, axes = np.linalg.eigh(H[:n, :n] - H[:n, n:] @ others[:, 1:])
    root = np.sqrt(np.maximum(size, 1e-12 * size.max(initial=0.0)))
    target = axes.T @ (g[:n] - H[:n, n:] @ others[:, 0]) / root
    x = axes @ (target / root)
    if ((x < low) | (x > high)).any():
        x = lsq_linear(root[:, None] * axes.T, target, (low, high), method="bvls").x
    return np.r_[x, others[:, 0] - others[:, 1:] @ x]


class BodyFitter:
    """Fits structures to the samples `rows` (N,) of a recording, beginning at a twin."""

    def __init__(self, recording, twin: Twin, rows: np.ndarray):
        self.recording, self.twin, self.rows = recording, twin, rows
        self.trial = np.unique(np.asarray(recording.samples["trial"]), return_inverse=True)[1]
        self._data: dict[InputModel, BodyData] = {}
        self._steps: dict[InputModel, StepRows] = {}
        between = np.diff(np.asarray(recording.samples["time_s"], dtype=float))[np.diff(self.trial) == 0]
        self.row_s = float(np.median(between)) if len(between) else None
        self.sent = "time_sent_s" in recording.samples

    def data(self, input_model: InputModel) -> BodyData:
        data = self._data.get(input_model)
        if data is None:
            if len(self._data) > 60:
                self._data.clear()  # other threads may be in here as well
            switch = (
                np.array(input_model.switch) if isinstance(input_model.switch, tuple) else input_model.switch
            )
            data = BodyData.of(
                self.recording, self.twin, input_model.source, input_model.target, input_model.start, switch
            )
            self._data[input_model] = data
        return data

    def steps(self, input_model: InputModel) -> StepRows:
        """The rows just after the command's steps, read so but for the instants."""
        key = replace(input_model, switch=None)
        if key not in self._steps:

            def read(share) -> BodyData:  # a tuple, since what is read is cached by it
                switch = tuple(share) if np.ndim(share) else share
                return self.data(replace(input_model, switch=switch))

            self._steps[key] = StepRows(self.recording, read)
        return self._steps[key]

    def judged(self, model: BodyModel) -> tuple[np.ndarray, np.ndarray]:
        """`BodyModel.judged` of a model with instants of steps, fitted to all `rows`."""
        input_model, out, added = (
            model.structure.input_model,
            model.residual.copy(),
            np.zeros(len(model.residual)),
        )
        step = self.steps(input_model)
        now = step.residual(self.data(input_model).thin(step.rows.ravel()), model.pipeline, model.theta)
        variance = float((model.residual[:, : model.counted] ** 2).sum(axis=1).mean())
        judged, cost = step.judged(model.pipeline, model.theta, variance)
        at = np.minimum(np.searchsorted(self.rows, step.rows), len(self.rows) - 1)
        use = step.own & (self.rows[at] == step.rows)
        if not cost.any():  # one instant for all steps
            out[at[use]] += (judged - now)[use]
        added[at[use]] = cost[use]
        return out, added

    def twin_with(self, joints: int) -> Twin:
        """The twin with so many joints, in the middle of equal segments where that is not its own number."""
        if joints == len(self.twin.spine_joint_positions_mm):
            return self.twin
        twin = self.twin.copy()
        twin.spine_joint_positions_mm = [twin.length_mm * (i + 0.5) / joints for i in range(joints)]
        for name in [n for n in twin.parameters if n in ("gain_alpha", "gain_beta") or n.startswith("bend_")]:
            del twin.parameters[name]
        if "gain_rad_per_kpa" in twin.parameters:
            ratio = len(self.twin.spine_joint_positions_mm) / joints
            gain = twin.parameters["gain_rad_per_kpa"]
            twin.parameters["gain_rad_per_kpa"] = replace(gain, value=gain.value * ratio, ci95=None)
            stiffness = twin.parameters.get("joint_stiffness_nm_per_rad")
            if stiffness is not None:
                twin.parameters["joint_stiffness_nm_per_rad"] = replace(
                    stiffness, value=stiffness.value / ratio
                )
        return twin

    def pipeline(self, structure: BodyStructure) -> Pipeline:
        return Pipeline.of(
            self.twin_with(structure.joints), self.data(structure.input_model).inputs, structure.effects
        )

    def start(self, structure: BodyStructure, pipeline: Pipeline, values: dict[str, float]) -> np.ndarray:
        """(P,) parameters to start from: given ones, else the twin's, else defaults."""
        theta = pipeline.theta(
            self.twin_with(structure.joints),
            self.data(structure.input_model).inputs.pressure_range_kpa,
        )
        return np.array([values.get(n, t) for n, t in zip(pipeline.names, theta, strict=True)])

    def fit(
        self, structure: BodyStructure, values: dict[str, float], steps: int = 8, every: int = 1
    ) -> BodyModel:
        """Fits all parameters of a structure from `values`, by name, to one row in `every`.

        It makes at most so many Gauss-Newton `steps`; 0 takes the values as they are.
        """
        data, pipeline = self.data(structure.input_model), self.pipeline(structure)
        p = data.inputs.pressure_range_kpa
        bounds = Bounds(pipeline, p, self.row_s, self.sent)
        theta = np.clip(self.start(structure, pipeline, values), bounds.lower, bounds.upper)
        free = self.free(pipeline, data, structure.own_profile)
        problem = Problem(pipeline, data.thin(self.rows[::every]), theta, bounds, free)
        v, jumps = bounds.scaled(theta, free), problem.jumps
        centre, spread = self._prior(pipeline, free, bounds, p)
        if structure.trials:
            trial = self.trial[self.rows[::every]]
            problem = TrialProblem(problem, trial, self.trial.max() + 1, structure.trials)
            more = problem.count
            v, centre = problem.begin(v), np.r_[centre, np.full(more, 0.5)]
            spread = np.r_[spread, np.full(more, 0.5 / TRIAL_RANGE)]
        r = problem.residual(v)
        if steps:
            for part in (steps // 2, steps - steps // 2):
                weight = np.diag(np.mean(r**2) * T.CORRELATED / spread**2)
                v = minimise(problem.residual, problem.jacobian, v, part, 1e-4, (centre, weight)).v
                v = past_jumps(problem, jumps, v) if part >= MANY else v
                r = problem.residual(v)
        weight = np.diag(np.mean(r**2) * T.CORRELATED / spread**2)
        return BodyModel(
            structure=structure,
            pipeline=pipeline,
            theta=problem.theta(v),
            free=free,
            v=v[: len(free)],
            of_trials=(2 * v[len(free) :] - 1).reshape(-1, len(data.columns) + 3) * TRIAL_RANGE
            if structure.trials
            else np.zeros((0, 0)),
            residual=r.reshape(-1, len(data.columns)),
            slope=lambda: problem.jacobian(v),
            weight=weight,
            pull=weight @ (v - centre),
            counted=data.counted,
            bounds=bounds,
            fitter=self if every == 1 else None,
        )

    def rough(self, structure: BodyStructure) -> dict[str, float]:
        """Gain, rest pressure and directions of chambers from a coarse grid, by name."""
        data, pipeline = self.data(structure.input_model), self.pipeline(structure)
        bounds = Bounds(pipeline, data.inputs.pressure_range_kpa, self.row_s, self.sent)
        theta = self.start(structure, pipeline, {})
        thin = data.thin(self.rows[:: max(1, len(self.rows) // 400)])
        theta = rough_drive(pipeline, thin, theta, bounds, self.free(pipeline, data, structure.own_profile))
        return dict(zip(pipeline.names, map(float, theta), strict=True))

    def free(self, pipeline: Pipeline, data: BodyData, own: bool) -> np.ndarray:
        """(F,) parameters that a search fits."""
        out = []
        for i, (name, spec) in enumerate(zip(pipeline.names, pipeline.specs, strict=True)):
            effect = name.rpartition(".")[0]
            if effect in pipeline.left_out:
                continue
            if data.unit == "kPa":
                if not effect or get_effect(effect).stage != "pneumatics":
                    continue
            elif effect and get_effect(effect).of_air and data.inputs.measured:
                continue
            shape = name.startswith("bend_") or name == "curl_rad" or name.endswith("_turn_rad")
            if shape and own or not spec.fixed and not (own and name in ("gain_alpha", "gain_beta")):
                out.append(i)
        return np.array(out, int)

    def _prior(self, pipeline: Pipeline, free: np.ndarray, bounds: Bounds, p: float):
        """(F,) centres and standard deviations, both scaled."""
        centre, spread = np.full(len(free), 0.5), np.full(len(free), 1e3)
        for j, i in enumerate(free):
            name, spec = pipeline.names[i], pipeline.specs[i]
            known = "bend" if name.startswith("bend_") else "turn" if name.endswith("_turn_rad") else name
            width = PRIOR.get(known)
            if name.endswith(".weight"):
                width = LAW_WEIGHT
            if width is None:
                continue
            width *= p**spec.range_power
            centre[j] = bounds.scaled(
                np.full(len(pipeline.names), np.clip(0.0, bounds.lower[i], bounds.upper[i])), np.array([i])
            )[0]
            spread[j] = width / (bounds.upper[i] - bounds.lower[i])
        return centre, spread

    def predict(self, model: BodyModel) -> np.ndarray:
        """(n, D) predictions at all samples, with what each trial has of its own."""
        data = self.data(model.structure.input_model)
        run = model.pipeline.run(data.inputs, model.theta)
        out = model.pipeline.outputs(run, data.columns)
        if model.structure.trials:
            each = of_each_trial(model.pipeline, data, run, model.structure.trials)
            out = out + np.einsum("ndk,nk->nd", each, model.of_trials[self.trial]) / data.scale
        return out
