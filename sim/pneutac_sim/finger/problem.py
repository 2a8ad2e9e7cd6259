"""A recording and a pipeline as a function from scaled parameters to residuals, with its Jacobian."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from pneutac_sim.finger.data import BodyData
from pneutac_sim.finger.equilibrium import sensitivities
from pneutac_sim.finger.inputs import Inputs
from pneutac_sim.finger.pipeline import BENDING_PRESSURE, Pipeline, Run
from pneutac_sim.finger.stages import EffectLink, LoadLink
from pneutac_sim.least_squares import Z95

# How a pipeline's outputs change with its parameters, to first order.
#
# Up to the drive the changed pressures of all parameters pass each effect side by side. Behind it nothing is
# remembered as a rule, so that a change of pressure, of free joint angles or of loads is worth its derivative
# at each sample, by one solution of the adjoint equilibrium for all parameters.


_SMALL = 1e-4  # of the pressure's range, of the length, or rad: where a derivative is taken
_LEAST_WEIGHT = 1e-3  # from which on a linear effect is scaled rather than run again


def changes(
    pipeline: Pipeline,
    inputs: Inputs,
    run: Run,
    columns: Sequence[str],
    indices: np.ndarray,
    values: np.ndarray,
) -> np.ndarray:
    """(n, D, F) what D outputs change by where one parameter alone takes another value, to first order.

    They count from a run with these inputs; (F,) parameters move to (F,) values.
    """
    only_air = pipeline.until(columns) <= pipeline.drive
    end = pipeline.reads_pressure if only_air else pipeline.drive
    of_link = {i: k for k, e in reversed(list(enumerate(pipeline.chain))) for i in e.indices}
    link = np.array([of_link.get(int(i), -1) for i in indices], int)
    early = np.flatnonzero((link >= 0) & (link < end))
    out = np.zeros((len(inputs.rows), len(columns), len(indices)))
    moved = _pressures(pipeline, inputs, run, indices[early], values[early], end)  # (m, 0, chambers) of none
    if only_air:
        change = moved[inputs.rows] - run.signals[end][inputs.rows, None]
        out[:, :, early] = change[:, :, [_chamber(c) for c in columns]].transpose(0, 2, 1)
        return out
    at, late = pipeline.outputs(run, columns), np.flatnonzero(link >= end)
    if AtRest.suits(pipeline, columns):
        rest = AtRest(pipeline, inputs, run, columns, at)
        out[:, :, early] = rest.by_pressures(moved)
        own, late = late[link[late] <= pipeline.reads_joints], late[link[late] > pipeline.reads_joints]
        out[:, :, own] = rest.by_parameters(indices[own], values[own])
    elif len(early):
        out[:, :, early] = _by_pressure(pipeline, inputs, run, columns, moved)
    for j in late:
        other = pipeline.run(inputs, _with(run, indices[j], values[j]), run)
        out[:, :, j] = pipeline.outputs(other, columns) - at
    return out


def _with(run: Run, index: int, value: float) -> np.ndarray:
    theta = run.theta.copy()
    theta[index] = value
    return theta


class AtRest:
    """Derivatives of the outputs of a body that remembers nothing behind its drive.

    They are taken at a run of a pipeline that has loads, if any, and markers directly behind the drive; `at`
    (n, D) are the values of the outputs there.

    Attributes:
        by_free: (n, D, Q) by joint angles without loads, 1/rad.
        by_load: (n, D, 6) by loads, 1/N, see `equilibrium.solve`.
        by_stiffness: (n, D) by the joints' stiffness.
    """

    @staticmethod
    def suits(pipeline: Pipeline, columns: Sequence[str]) -> bool:
        """Whether a pipeline is made so, and the outputs are of its markers."""
        between = pipeline.chain[pipeline.drive + 1 : pipeline.reads_joints]
        return (
            pipeline.thins_at == pipeline.drive
            and all(isinstance(e, LoadLink) and e.body is None for e in between)
            and not any(c.startswith("q_") for c in columns)
        )

    def __init__(self, pipeline: Pipeline, inputs: Inputs, run: Run, columns: Sequence[str], at: np.ndarray):
        self._pipeline, self._inputs, self._run, self._columns, self._at = pipeline, inputs, run, columns, at
        between, free = pipeline.chain[pipeline.drive + 1], run.signals[pipeline.drive + 1]
        self._load = between if isinstance(between, LoadLink) else None
        loads = np.zeros((len(free), 6)) if self._load is None else self._loads(run.theta)
        stiffness = 1.0 if self._load is None else float(run.theta[self._load.stiffness])
        self.by_free = np.empty((*at.shape, free.shape[1]))
        self.by_load, self.by_stiffness = np.zeros((*at.shape, 6)), np.zeros(at.shape)
        links, results = pipeline.geometry.links, (self.by_free, self.by_load, self.by_stiffness)
        sensitivities(run.joints, free, loads, stiffness, links, self._by_markers(), *results)

    def by_pressures(self, moved: np.ndarray) -> np.ndarray:
        """(n, D, F) what outputs change by where other pressures (m, F, chambers) bend the body."""
        rows = self._inputs.rows
        change = moved[rows] - self._run.signals[self._pipeline.drive][rows, None]
        return np.einsum("ndc,nfc->ndf", self.by_pressure, change)

    @cached_property
    def by_pressure(self) -> np.ndarray:
        """(n, D, chambers) 1/kPa."""
        p, run = self._pipeline, self._run
        out = self.by_free @ p.chain[p.drive].line(run.theta)[0].T
        if BENDING_PRESSURE in self._computed:
            eps = _SMALL * self._inputs.pressure_range_kpa
            other = {BENDING_PRESSURE: self._computed[BENDING_PRESSURE] + eps}
            change = (self._seen(run.signals[p.reads_joints + 1], other) - self._at) / eps
            out += change[:, :, None] / out.shape[2]
        return out

    def by_parameters(self, indices: np.ndarray, values: np.ndarray) -> np.ndarray:
        """(n, D, F) what outputs change by with parameters of the drive and of loads."""
        p, run, out = self._pipeline, self._run, np.zeros((*self._at.shape, len(indices)))
        of_drive = [j for j, i in enumerate(indices) if i in p.chain[p.drive].indices]
        lines = [p.chain[p.drive].line(_with(run, indices[j], values[j])) for j in of_drive]
        if lines:
            gain, still = p.chain[p.drive].line(run.theta)
            out[:, :, of_drive] = self.by_free @ np.stack([s - still for _, s in lines], axis=1)
            for c, u in enumerate(run.signals[p.drive][self._inputs.rows].T):
                by_gain = self.by_free @ np.stack([g[c] - gain[c] for g, _ in lines], axis=1)
                out[:, :, of_drive] += u[:, None, None] * by_gain
        for j, i in enumerate(indices):
            if j in of_drive or self._load is None:
                continue
            if i == self._load.stiffness:
                out[:, :, j] = self.by_stiffness * (values[j] - run.theta[i])
                continue
            change = self._loads(_with(run, i, values[j])) - self._loads(run.theta)
            out[:, :, j] = np.einsum("ndk,nk->nd", self.by_load, change)
        return out

    @cached_property
    def _computed(self) -> dict[str, np.ndarray]:
        return self._pipeline.computed(self._run.signals, self._inputs, True)

    def _loads(self, theta: np.ndarray) -> np.ndarray:
        assert self._load is not None
        return self._load.loads(self._inputs.sample_dt_s, theta, self._inputs.conditions_with({}, True))

    def _by_markers(self) -> np.ndarray:
        g, out = self._pipeline.geometry, np.zeros((*self._at.shape, 5))
        markers = self._run.signals[self._pipeline.reads_joints + 1]
        for m in (0, 2, 3) if g.axes == 1 else range(5):
            other, eps = markers.copy(), _SMALL * (g.length_mm if m < 3 else 1.0)
            other[:, m] += eps
            out[:, :, m] = (self._seen(other, self._computed) - self._at) / eps
        return out

    def _seen(self, markers: np.ndarray, computed: dict[str, np.ndarray]) -> np.ndarray:
        conditions = self._inputs.conditions_with(computed, True)
        for link in self._pipeline.chain[self._pipeline.reads_joints + 1 :]:
            markers = link(markers, self._inputs.sample_dt_s, self._run.theta, conditions, np.zeros(0))
        return self._pipeline.outputs(replace(self._run, markers=markers), self._columns)


def _chamber(column: str) -> int:
    number = column.split("_")[1]
    return int(number) - 1 if number.isdigit() else 0


def _pressures(
    pipeline: Pipeline, inputs: Inputs, run: Run, indices: np.ndarray, values: np.ndarray, end: int
) -> np.ndarray:
    """(m, F, chambers) what enters link `end` where each parameter of a link before takes its other value."""
    conditions = inputs.conditions_with({}, False)
    x = np.zeros((len(inputs.dt_s), 0, run.signals[0].shape[1]))
    order: list[int] = []
    for link, before, after in zip(pipeline.chain[:end], run.signals, run.signals[1:], strict=False):
        assert isinstance(link, EffectLink)
        if order:
            x = link.side_by_side(x, inputs.dt_s, run.theta, conditions)
        own = [j for j, i in enumerate(indices) if i in link.indices]
        new = []
        for j in own:
            now, value = run.theta[indices[j]], values[j]
            if pipeline.names[indices[j]].endswith(f".{link.effect.linear}") and abs(now) > _LEAST_WEIGHT:
                new.append(after + (after - before) * ((value - now) / now))
                continue
            state = np.zeros(link.state_size(before.shape[1]))
            new.append(link(before, inputs.dt_s, _with(run, indices[j], value), conditions, state))
        if own:
            x, order = np.concatenate([x, np.stack(new, axis=1)], axis=1), order + own
    return x if order == sorted(order) else x[:, np.argsort(order)]


def _by_pressure(
    pipeline: Pipeline, inputs: Inputs, run: Run, columns: Sequence[str], moved: np.ndarray
) -> np.ndarray:
    """(n, D, F) what outputs change by where other pressures (m, F, chambers) bend the body."""
    at, u = pipeline.outputs(run, columns), run.signals[pipeline.drive]

    def outputs(pressure: np.ndarray) -> np.ndarray:
        return pipeline.outputs(pipeline.run(inputs, run.theta, run, pressure), columns) - at

    if pipeline.thins_at > pipeline.drive:
        return np.stack([outputs(np.ascontiguousarray(moved[:, j])) for j in range(moved.shape[1])], axis=2)
    eps, out = _SMALL * inputs.pressure_range_kpa, 0.0
    change = moved[inputs.rows] - u[inputs.rows][:, None]
    for c in range(u.shape[1]):
        other = u.copy()
        other[:, c] += eps
        out = out + (outputs(other) / eps)[:, :, None] * change[:, None, :, c]
    return np.asarray(out)


SHORTEST_ROWS = 0.25  # of a time that a recording can show, in its time between rows
SHORTEST_PERIOD_ROWS = 4.0
# Of a swing of the air where the times of commands are logged: rows alias it, but they show where in it each
# lies. Without these times fitted instants and such a swing together fit any step.
SHORTEST_AIR_ROWS = 1.0


class Bounds:
    """Bounds `lower` and `upper` (P,) of all parameters of a pipeline, and their map to [0, 1].

    It is that of the logarithm where that matters. `default` (P,) are starting values for the recording's
    pressure range. With a time between rows, `row_s`, times and periods that are too short to show stay
    outside the bounds; `sent` says whether the times of commands are logged.
    """

    def __init__(
        self, pipeline: Pipeline, pressure_range_kpa: float, row_s: float | None = None, sent: bool = False
    ):
        bounds = np.array([p.limits(pressure_range_kpa) for p in pipeline.specs])
        for (_, low, high), bound, spec, name in zip(
            bounds.copy(), bounds, pipeline.specs, pipeline.names, strict=True
        ):
            if row_s is not None and spec.unit == "s" and low > 0:  # a dead time may be none
                bound[1] = min(max(low, SHORTEST_ROWS * row_s), 0.9 * high)
            elif row_s is not None and spec.unit == "rad/s":
                air = sent and name.startswith("air_resonance.")
                rows = SHORTEST_AIR_ROWS if air else SHORTEST_PERIOD_ROWS
                bound[2] = max(min(high, 2 * np.pi / (rows * row_s)), 1.1 * low)
        self._log = np.array([p.log for p in pipeline.specs])
        self.default, self.lower, self.upper = bounds.T
        every = np.arange(len(bounds))
        self._bottom, self._top = self._inner(self.lower, every), self._inner(self.upper, every)

    def _inner(self, x: np.ndarray, index: np.ndarray) -> np.ndarray:
        return np.where(self._log[index], np.log(np.maximum(x, 1e-300)), x)

    def value(self, v: np.ndarray, index: np.ndarray) -> np.ndarray:
        """Parameters `index` at scaled values v in [0, 1]."""
        inner = self._bottom[index] + v * (self._top - self._bottom)[index]
        return np.where(self._log[index], np.exp(np.where(self._log[index], inner, 0.0)), inner)

    def scaled(self, theta: np.ndarray, index: np.ndarray) -> np.ndarray:
        """Scaled values of parameters `index` of theta (P,), clipped to their bounds."""
        v = (self._inner(theta[index], index) - self._bottom[index]) / (self._top - self._bottom)[index]
        return np.clip(v, 0.0, 1.0)


class Problem:
    """Residuals of one recording, whole or thinned, as a function of the free parameters, scaled to [0, 1].

    `free` (F,) are their indices, `theta` (P,) has the values of the others; `evaluations` counts
    simulations.
    """

    def __init__(
        self, pipeline: Pipeline, data: BodyData, theta: np.ndarray, bounds: Bounds, free: np.ndarray
    ):
        self.pipeline, self.data, self.bounds = pipeline, data, bounds
        self.free = np.asarray(free, int)
        self.evaluations = 0
        self._theta = theta
        self._measured = self._scaled(data.measured)
        self._until = pipeline.until(data.columns)
        self._last: Run | None = None
        self._taken: tuple[np.ndarray, np.ndarray] | None = None

    @property
    def jumps(self) -> np.ndarray:
        """(F,) share of its range within which each free parameter is tried, see `past_jumps`."""
        return np.array([self.pipeline.specs[i].jump for i in self.free])

    def theta(self, v: np.ndarray) -> np.ndarray:
        """All parameters (P,)."""
        theta = self._theta.copy()
        theta[self.free] = self.bounds.value(v, self.free)
        return theta

    @property
    def run(self) -> Run:
        """The last simulation of `residual`."""
        assert self._last is not None
        return self._last

    def residual(self, v: np.ndarray) -> np.ndarray:
        """Model - measured (m D,), in the unit of the error."""
        self._last = self._run(self.theta(v), self._last)
        return self._values(self._last) - self._measured

    def nearby(self, v: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        """`residual` for v of which only what comes before the drive differs, the body to first order."""
        r, run, pipeline, data = self.residual(v), self.run, self.pipeline, self.data
        if self._until <= pipeline.drive or not AtRest.suits(pipeline, data.columns):
            return self.residual
        at = pipeline.outputs(run, data.columns)
        slope = AtRest(pipeline, data.inputs, run, data.columns, at).by_pressure * data.scale[:, None]
        rows, u = data.inputs.rows, run.signals[pipeline.drive]

        def residual(other: np.ndarray) -> np.ndarray:
            moved = pipeline.run(data.inputs, self.theta(other), run, until=pipeline.drive)
            change = (moved.signals[pipeline.drive] - u)[rows]
            return r + (slope @ change[:, :, None]).ravel()

        return residual

    def cost(self, theta: np.ndarray) -> float:
        """Sum of squares at all parameters (P,)."""
        r = self._values(self._run(theta, None)) - self._measured
        return float(r @ r)

    def jacobian(self, v: np.ndarray) -> np.ndarray:
        """Derivative (m D, F) of the residual by one-sided differences; two-sided where it comes in jumps."""
        if self._taken is not None and np.array_equal(self._taken[0], v):
            return self._taken[1]
        theta = self.theta(v)
        if self._last is None or not np.array_equal(self._last.theta, theta):
            self.residual(v)
        steps = np.array([self.pipeline.specs[i].step for i in self.free])
        moved = v + np.where(v < 0.5, steps, -steps)
        back = np.flatnonzero((self.jumps > 0) & (v >= steps) & (v <= 1 - steps))  # a jump is on one side
        index, there = np.r_[np.arange(len(v)), back].astype(int), np.r_[moved, 2 * v[back] - moved[back]]
        values, data = self.bounds.value(there, self.free[index]), self.data
        change = changes(self.pipeline, data.inputs, self.run, data.columns, self.free[index], values)
        slope = change * self.data.scale[:, None] / (there - v[index])
        slope[:, :, back] = (slope[:, :, back] + slope[:, :, len(v) :]) / 2
        J = slope[:, :, : len(v)].reshape(self._measured.size, len(v))
        self._taken = v.copy(), J
        self.evaluations += len(v)
        return J

    def _run(self, theta: np.ndarray, reuse: Run | None) -> Run:
        self.evaluations += 1
        return self.pipeline.run(self.data.inputs, theta, reuse, until=self._until)

    def _values(self, run: Run) -> np.ndarray:
        return self._scaled(self.pipeline.outputs(run, self.data.columns))

    def _scaled(self, values: np.ndarray) -> np.ndarray:
        return (values * self.data.scale).ravel()


def past_jumps(problem, jumps: np.ndarray, v: np.ndarray) -> np.ndarray:
    """The best v nearby along each parameter that moves the error in jumps, which derivatives do not show.

    Of each width the best by `nearby` is tried in full; `jumps` (F,) are those of the first F parameters, see
    `Problem.jumps`.
    """
    where = np.flatnonzero(jumps)
    if not len(where):
        return v
    squares = lambda r: float(np.square(r).sum())  # noqa: E731
    least, near = squares(problem.residual(v)), problem.nearby(v)
    for j in where:
        for width in jumps[j] / np.array([3, 12, 48, 192]):
            away = np.unique(np.clip(v[j] + width * np.array([-3, -2, -1, 1, 2, 3]), 0.0, 1.0))
            tried = np.repeat(v[None], len(away), axis=0)
            tried[:, j] = away
            best = min(tried, key=lambda x, near=near: squares(near(x)))
            if (now := squares(problem.residual(best))) < least:
                v, least, near = best, now, problem.nearby(best)
    return v


def level_stretch(
    residual: Callable[[np.ndarray], np.ndarray], v: np.ndarray, j: int, width: float
) -> tuple[float, float] | None:
    """From where to where parameter j explains as much as at the best v: a 95 % profile of white residuals.

    None where it does so farther than `width` on either side.
    """
    r = residual(v)
    most = float(r @ r) * (1 + Z95**2 / len(r))

    def as_good(away: float) -> bool:
        tried = v.copy()
        tried[j] += away
        return 0 <= tried[j] <= 1 and float(np.square(residual(tried)).sum()) <= most

    ends = []
    for side in (-1, 1):
        near, far = 0.0, width * 2.0**-10
        while far < width and as_good(side * far):
            near, far = far, 2 * far
        if far >= width:
            return None
        for _ in range(6):
            middle = (near + far) / 2
            near, far = (middle, far) if as_good(side * middle) else (near, middle)
        ends.append(float(v[j] + side * near))
    return ends[0], ends[1]
