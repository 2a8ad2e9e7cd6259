"""Models of a body that a search fits: which effects, how the recording is read, and all their parameters."""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.optimize import lsq_linear

from lerobot_pneutac.study.body_trials import ALIKE, TRIAL_RANGE, TrialProblem, of_each_trial
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.finger.data import BodyData
from pneutac_sim.finger.instants import StepRows
from pneutac_sim.finger.pipeline import Pipeline
from pneutac_sim.finger.problem import Bounds, Problem, past_jumps
from pneutac_sim.finger.starts import rough_drive
from pneutac_sim.least_squares import minimise
from pneutac_sim.twin import Twin

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
    "payload.share": 3.0,
    "gravity.body_mass_g": 300.0,
    "gravity.tip_mass_g": 300.0,
}
LAW_WEIGHT = 1.0
FAR = 0.3  # of a parameter's range: how far a fit without a fold may be from the whole one
MANY = 3  # steps of each half of a fit from which on it also looks past jumps


@dataclass(frozen=True)
class Reading:
    """How a recording is taken to have been made; see `Inputs.from_samples`.

    Attributes:
        source: `command` or `measured` pressure drives the model.
        target: `pose` or `pressure` is predicted.
        start: of trials.
        switch: (n,) instants at which the command steps, as a tuple; one for all; None for no steps.
    """

    source: str = "command"
    target: str = "pose"
    start: str | float = "held"
    switch: float | tuple[float, ...] | None = None


@dataclass(frozen=True)
class Form:
    """The structure of a model.

    Attributes:
        effects: all that are switched on, in the order in which they came.
        reading: of the recording.
        joints: of the spine.
        own: whether bend profile, curl and directions of chambers are the device's own, or the paper's.
        trials: widths of what each trial has of its own, no part of the device: offset of outputs, as a share
            of their range, gain of the drive, its zero, as a share of the pressure's, and its clock, s; empty
            for none.
    """

    effects: tuple[str, ...]
    reading: Reading
    joints: int
    own: bool = True
    trials: tuple[float, ...] = ()

    def plus(self, *effects: str) -> "Form":
        """With further effects; a law that is there already comes in a second instance."""
        now = list(self.effects)
        for e in effects:
            number, name = 2, e
            while name in now:
                name, number = f"{e} #{number}", number + 1
            now.append(name)
        return replace(self, effects=tuple(now))

    def without(self, effect: str) -> "Form":
        """Without one effect."""
        return replace(self, effects=tuple(e for e in self.effects if e != effect))


@dataclass
class BodyModel:
    """A fitted model.

    Attributes:
        form: its structure.
        pipeline: that runs it.
        theta: (P,) all parameters.
        free: (F,) those that were fitted.
        v: (F,) their scaled values.
        residual: (N, D) model - measured at the rows of the search, in the unit of the error.
        jacobian: (N D, F) of it; with further columns for what each trial has of its own.
        weight: (F, F) of the prior, in units of the residual's squares.
        pull: (F,) weight times the distance from the prior's centre.
        counted: columns that count in the error.
        bounds: of the parameters.
        of_trials: (trials, D + 3) offset of each output, gain, zero and clock of the drive, in their widths.
        fitter: that fitted it; None where no instants of steps were fitted.
    """

    form: Form
    pipeline: Pipeline
    theta: np.ndarray
    free: np.ndarray
    v: np.ndarray
    residual: np.ndarray
    jacobian: np.ndarray
    weight: np.ndarray
    pull: np.ndarray
    counted: int
    bounds: Bounds = field(repr=False)
    of_trials: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)), repr=False)
    fitter: "BodyFitter | None" = field(default=None, repr=False)

    @property
    def values(self) -> dict[str, float]:
        """Name to value of all parameters."""
        return dict(zip(self.pipeline.names, map(float, self.theta), strict=True))

    @property
    def cost(self) -> int:
        """Number of parameters, which a simpler model has fewer of; one stuck at a bound counts twice."""
        stuck = (self.v <= 1e-3) | (self.v >= 1 - 1e-3)
        return len(self.free) + int(stuck.sum())

    @cached_property
    def normal(self) -> np.ndarray:
        """(F, F) normal matrix with the prior."""
        return self.jacobian.T @ self.jacobian + self.weight

    @cached_property
    def judged(self) -> tuple[np.ndarray, np.ndarray]:
        """Residual (N, D) and what is to be added to its squares (N,), see `finger.instants`."""
        if self.fitter is None or not isinstance(self.form.reading.switch, tuple):
            return self.residual, np.zeros(len(self.residual))
        return self.fitter.judged(self)

    def crossed(self, fold: np.ndarray) -> np.ndarray:
        """(N,) squared errors, each by a fit without its own fold, one Gauss-Newton step from the whole one.

        Errors are counted as `judged` says. The step stays within bounds and within `FAR`, where a linear
        model says something.

        Args:
            fold: (N,) number of each row's fold; rows of a negative one stay out and count 0.
        """
        d, of_trials = self.residual.shape[1], np.arange(len(self.v), self.jacobian.shape[1])
        out = np.zeros(len(fold))
        moves = np.flatnonzero((self.v > 1e-6) & (self.v < 1 - 1e-6))
        low, high = np.maximum(-self.v, -FAR)[moves], np.minimum(1 - self.v, FAR)[moves]
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
    """Fits forms to a recording.

    Args:
        recording: of a finger or an arm.
        twin: gives where fits start.
        rows: (N,) samples that are fitted.
    """

    def __init__(self, recording, twin: Twin, rows: np.ndarray):
        self.recording, self.twin, self.rows = recording, twin, rows
        self.trial = np.unique(np.asarray(recording.samples["trial"]), return_inverse=True)[1]
        self._data: dict[Reading, BodyData] = {}
        self._steps: dict[Reading, StepRows] = {}
        between = np.diff(np.asarray(recording.samples["time_s"], dtype=float))[np.diff(self.trial) == 0]
        self.row_s = float(np.median(between)) if len(between) else None

    def data(self, reading: Reading) -> BodyData:
        """The whole recording, read so."""
        data = self._data.get(reading)
        if data is None:
            if len(self._data) > 60:
                self._data.clear()  # other threads may be in here as well
            switch = np.array(reading.switch) if isinstance(reading.switch, tuple) else reading.switch
            data = BodyData.of(
                self.recording, self.twin, reading.source, reading.target, reading.start, switch
            )
            self._data[reading] = data
        return data

    def steps(self, reading: Reading) -> StepRows:
        """The rows just after the command's steps, read so but for the instants."""
        key = replace(reading, switch=None)
        if key not in self._steps:
            self._steps[key] = StepRows(self.recording, lambda s: self.data(replace(reading, switch=s)))
        return self._steps[key]

    def judged(self, model: BodyModel) -> tuple[np.ndarray, np.ndarray]:
        """`BodyModel.judged` of a model with instants of steps, fitted to all `rows`."""
        reading, out, added = model.form.reading, model.residual.copy(), np.zeros(len(model.residual))
        step = self.steps(reading)
        now = step.residual(self.data(reading).thin(step.rows.ravel()), model.pipeline, model.theta)
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

    def pipeline(self, form: Form) -> Pipeline:
        """The model of a form."""
        return Pipeline.of(self.twin_with(form.joints), self.data(form.reading).inputs, form.effects)

    def start(self, form: Form, pipeline: Pipeline, values: dict[str, float]) -> np.ndarray:
        """(P,) parameters to start from: given ones, else the twin's, else defaults."""
        theta = pipeline.theta(self.twin_with(form.joints), self.data(form.reading).inputs.pressure_range_kpa)
        return np.array([values.get(n, t) for n, t in zip(pipeline.names, theta, strict=True)])

    def fit(self, form: Form, values: dict[str, float], steps: int = 8, every: int = 1) -> BodyModel:
        """Fits all parameters of a form.

        Args:
            form: structure.
            values: where to start, by name.
            steps: most Gauss-Newton steps; 0 takes the values as they are.
            every: uses one row in so many.
        """
        data, pipeline = self.data(form.reading), self.pipeline(form)
        p = data.inputs.pressure_range_kpa
        bounds = Bounds(pipeline, p, self.row_s)
        theta = np.clip(self.start(form, pipeline, values), bounds.lower, bounds.upper)
        free = self.free(pipeline, data, form.own)
        problem = Problem(pipeline, data.thin(self.rows[::every]), theta, bounds, free)
        v, jumps = bounds.scaled(theta, free), problem.jumps
        centre, spread = self._prior(pipeline, free, bounds, p)
        if form.trials:
            trial = self.trial[self.rows[::every]]
            problem = TrialProblem(problem, trial, self.trial.max() + 1, form.trials)
            more = problem.count
            v, centre = problem.begin(v), np.r_[centre, np.full(more, 0.5)]
            spread = np.r_[spread, np.full(more, 0.5 / TRIAL_RANGE)]
        r = problem.residual(v)
        if steps:
            for part in (steps // 2, steps - steps // 2):
                weight = np.diag(np.mean(r**2) * ALIKE / spread**2)
                v = minimise(problem.residual, problem.jacobian, v, part, 1e-4, (centre, weight)).v
                v = past_jumps(problem.residual, jumps, v) if part >= MANY else v
                r = problem.residual(v)
        J = problem.jacobian(v)
        weight = np.diag(np.mean(r**2) * ALIKE / spread**2)
        return BodyModel(
            form=form,
            pipeline=pipeline,
            theta=problem.theta(v),
            free=free,
            v=v[: len(free)],
            of_trials=(2 * v[len(free) :] - 1).reshape(-1, len(data.columns) + 3) * TRIAL_RANGE
            if form.trials
            else np.zeros((0, 0)),
            residual=r.reshape(-1, len(data.columns)),
            jacobian=J,
            weight=weight,
            pull=weight @ (v - centre),
            counted=data.counted,
            bounds=bounds,
            fitter=self if every == 1 else None,
        )

    def rough(self, form: Form) -> dict[str, float]:
        """Gain, rest pressure and directions of chambers from a coarse grid, by name."""
        data, pipeline = self.data(form.reading), self.pipeline(form)
        bounds = Bounds(pipeline, data.inputs.pressure_range_kpa, self.row_s)
        theta = self.start(form, pipeline, {})
        thin = data.thin(self.rows[:: max(1, len(self.rows) // 400)])
        theta = rough_drive(pipeline, thin, theta, bounds, self.free(pipeline, data, form.own))
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
        data = self.data(model.form.reading)
        run = model.pipeline.run(data.inputs, model.theta)
        out = model.pipeline.outputs(run, data.columns)
        if model.form.trials:
            each = of_each_trial(model.pipeline, data, run, model.form.trials)
            out = out + np.einsum("ndk,nk->nd", each, model.of_trials[self.trial]) / data.scale
        return out
