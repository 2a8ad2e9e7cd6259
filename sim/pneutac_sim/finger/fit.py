"""Fits a twin to a recording: bounded nonlinear least squares over all parameters, from several starts.

A first round on a thinned recording looks for the right valley, the second polishes on every sample. Whatever
the recording does not separate stays as it is and is named.

Where a fit may start: from the twin as it is, from a rough guess of its drive, and at random.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pneutac_sim.errors import InputError
from pneutac_sim.finger.data import BodyData
from pneutac_sim.finger.equilibrium import SoftBody
from pneutac_sim.finger.pipeline import Pipeline
from pneutac_sim.finger.problem import Bounds, Problem, level_stretch, past_jumps
from pneutac_sim.least_squares import Z95, Confidence, confidence, independent, minimise
from pneutac_sim.twin import Twin

# Tried for each joint: rad at the largest pressure, rest pressure over the largest one, angle over 2 pi.
_GAIN = (-0.7, -0.3, -0.12, -0.04, 0.02, 0.04, 0.08, 0.12, 0.2, 0.3, 0.5, 0.8)
_REST = (-0.5, -0.1, 0.0, 0.1, 0.5, 1.0)
_ANGLE = tuple(np.arange(-6, 6) / 12)


def rough_drive(
    pipeline: Pipeline, data: BodyData, theta: np.ndarray, bounds: Bounds, free: np.ndarray
) -> np.ndarray:
    """The best parameters (P,) of a coarse grid over gain, rest pressure and directions, without effects.

    The grid has 72 points for a finger, 264 for an arm, so the data are thinned; those of `free` may change.
    """
    p = data.inputs.pressure_range_kpa
    tried = {
        "gain_rad_per_kpa": [s / p for s in _GAIN],
        "rest_pressure_kpa": [s * p for s in _REST],
        "chamber_angle_rad": [2 * np.pi * s for s in _ANGLE],
    }
    axes = {i: tried[name] for i, name in enumerate(pipeline.names) if name in tried and i in free}
    axes = {i: [x for x in xs if bounds.lower[i] <= x <= bounds.upper[i]] for i, xs in axes.items()}
    if any(pipeline.names[i] == "chamber_angle_rad" for i in axes):
        axes[pipeline.names.index("chamber_handedness")] = [-1.0, 1.0]
    if not axes:
        return theta
    bare = Pipeline(pipeline.geometry, (), data.inputs.measured)
    problem = Problem(bare, data, theta[: len(bare.names)], Bounds(bare, p), np.zeros(0, int))
    best, lowest = theta, np.inf
    for values in np.stack(np.meshgrid(*axes.values(), indexing="ij"), axis=-1).reshape(-1, len(axes)):
        trial = theta.copy()
        trial[list(axes)] = values
        cost = problem.cost(trial[: len(bare.names)])
        if cost < lowest:
            best, lowest = trial, cost
    return best


def starting_points(
    anchors: list[np.ndarray],
    pipeline: Pipeline,
    bounds: Bounds,
    free: np.ndarray,
    starts: int,
    rng: np.random.Generator,
) -> list[np.ndarray]:
    """The anchors, best first, then the best one with random values for the effects' parameters.

    Returns:
        At most `starts` points (P,), at least one.
    """
    points = list(anchors[: max(starts, 1)])
    random = np.array([i for i in free if "." in pipeline.names[i]], int)
    while len(points) < starts and len(random):
        theta = anchors[0].copy()
        theta[random] = bounds.value(rng.uniform(0.02, 0.6, len(random)), random)
        points.append(theta)
    return points


_EDGE = 1e-3  # of a parameter's whole range: nearer to its bound it counts as at it
_COARSE = 1200  # samples in the first round
_COARSE_STEPS = 8  # enough to separate the valleys
_DEPENDENT = "the recording cannot separate it from the other parameters"
_PROFILE = ("gain_alpha", "gain_beta")
BY_IMAGES = "calibrated by images"  # how a twin's history calls it


@dataclass(frozen=True)
class PipelineFit:
    """The outcome of `fit`."""

    twin: Twin  # the twin with the new parameters and their confidence intervals
    pipeline: Pipeline  # the model that was fitted
    theta: np.ndarray  # (P,) all parameters
    free: np.ndarray  # (F,) indices of those that were fitted; `confidence` is in this order
    residual: np.ndarray  # (n, D) measured - model over all samples
    train: float  # error over the training samples, in `unit`
    heldout: float  # error over the others; NaN where there are none
    unit: str  # of the errors
    confidence: Confidence  # spread and correlations in scaled units, effective number of samples
    ci95: dict[str, tuple[float, float]]  # parameter name to its interval, for all in `free`
    # parameter name to `lower` or `upper`, where it stopped at a bound that is no neutral point
    at_bound: dict[str, str]
    not_identified: dict[str, str]  # parameters that the recording does not identify, and why
    evaluations: int  # simulations made, most of them of a thinned recording or of a part of the chain
    seconds: float  # wall time

    @property
    def free_names(self) -> list[str]:
        return [self.pipeline.names[i] for i in self.free]


def fit(
    twin: Twin,
    recording,
    effects: Sequence[str] | None = None,
    train: np.ndarray | None = None,
    only: Sequence[str] | None = None,
    starts: int = 4,
    seed: int = 0,
    body: SoftBody | None = None,
) -> PipelineFit:
    """Fits all parameters of a twin with these effects to the training samples of a recording.

    Args:
        twin: where the fit starts.
        recording: a bench recording, or a `BodyData` prepared from one (faster for many fits).
        effects: switched on; None for the twin's own.
        train: (n,) samples to fit; None for all.
        only: fit these and hold the rest: names of parameters, or of effects for all of theirs. None for all;
            but where photographs of the whole body gave how the bend is spread over the joints, a
            recording of the tip alone, which hardly identifies it, does not change that.
        starts: how many starting points the first round tries.
        seed: decides the random ones among them.
        body: of a finger, with which its modulus and the joints' stiffness are fitted too.

    Raises InputError: there are fewer training samples than parameters.
    """
    began = time.perf_counter()
    data = recording if isinstance(recording, BodyData) else BodyData.of(recording, twin)
    mask = np.ones(len(data), bool) if train is None else np.asarray(train, bool)
    pipeline = Pipeline.of(twin, data.inputs, effects, body)
    bounds = Bounds(pipeline, data.inputs.pressure_range_kpa)
    free = _free(pipeline, data, twin, only)
    if mask.sum() * len(data.columns) <= len(free):
        raise InputError(
            f"There are {mask.sum()} training samples for {len(free)} parameters; record more, or fit fewer."
        )
    start = pipeline.theta(twin, data.inputs.pressure_range_kpa)
    problems, v = _search(start, pipeline, data, np.flatnonzero(mask), bounds, free, starts, seed)
    final, v, level = problems[-1], v.copy(), {}
    for j in np.flatnonzero(final.jumps):  # the error knows no better than a stretch: its middle is taken
        ends = level_stretch(final.residual, v, j, final.jumps[j])
        if ends is not None and ends[1] < 1 - _EDGE:  # what stopped at its upper bound says so
            v[j], level[j] = np.mean(ends), np.ptp(ends) / 2
    theta = final.theta(v)
    residual = data.measured - pipeline.outputs(pipeline.run(data.inputs, theta), data.columns)
    edge = (v < _EDGE) | (v > 1 - _EDGE)
    known = confidence(final.jacobian(v), residual[mask] * data.scale, data.adjacent[mask], edge)
    for j, half in level.items():  # where there is no slope from which to compute its spread
        known.sd[j] = max(half / Z95, known.sd[j] if np.isfinite(known.sd[j]) else 0.0)
    ci95 = _intervals(pipeline, bounds, final.free, v, known.sd)
    unknown = dict.fromkeys((pipeline.names[i] for i in free if i not in final.free), _DEPENDENT)
    for j in np.flatnonzero((2 * Z95 * known.sd > 1) & ~edge):
        unknown[pipeline.names[final.free[j]]] = "its interval spans everything that physics allows"
    return PipelineFit(
        twin=pipeline.update(twin, theta, ci95),
        pipeline=pipeline,
        theta=theta,
        free=final.free,
        residual=residual,
        train=data.error(residual, mask),
        heldout=data.error(residual, ~mask),
        unit=data.unit,
        confidence=known,
        ci95=ci95,
        at_bound=_at_bound(pipeline, bounds, final.free, v, edge),
        not_identified=unknown,
        evaluations=sum(p.evaluations for p in problems),
        seconds=time.perf_counter() - began,
    )


def _search(
    theta: np.ndarray,
    pipeline: Pipeline,
    data: BodyData,
    train: np.ndarray,
    bounds: Bounds,
    free: np.ndarray,
    starts: int,
    seed: int,
) -> tuple[list[Problem], np.ndarray]:
    """Finds the best valley on some samples and follows it on all that train (indices).

    Returns:
        All problems that were simulated, the last with those of the `free` that the samples identify; and
        its solution.
    """
    thin = data.thin(train[:: max(1, len(train) // _COARSE)])
    first = Problem(pipeline, thin, theta, bounds, free)
    anchors = sorted([theta, rough_drive(pipeline, thin, theta, bounds, free)], key=first.cost)
    whole = Problem(pipeline, data.thin(train), anchors[0], bounds, free)
    free = free[independent(whole.jacobian(np.clip(bounds.scaled(anchors[0], free), 0.01, 0.99)))]
    points = starting_points(anchors, pipeline, bounds, free, starts, np.random.default_rng(seed))
    tried = [Problem(pipeline, thin, point, bounds, free) for point in points]
    found = [
        minimise(p.residual, p.jacobian, bounds.scaled(point, free), _COARSE_STEPS)
        for p, point in zip(tried, points, strict=True)
    ]
    best = min(range(len(found)), key=lambda i: found[i].cost)
    final = Problem(pipeline, whole.data, points[best], bounds, free)
    v = minimise(final.residual, final.jacobian, found[best].v).v
    moved = past_jumps(final, final.jumps, v)
    if not np.array_equal(moved, v):
        v = minimise(final.residual, final.jacobian, moved).v
    return [first, whole, *tried, final], v


def _at_bound(
    pipeline: Pipeline, bounds: Bounds, free: np.ndarray, v: np.ndarray, edge: np.ndarray
) -> dict[str, str]:
    """Name to `lower` or `upper` of those at an edge that is no neutral point."""
    out = {}
    for j in np.flatnonzero(edge):
        side = "upper" if v[j] > 0.5 else "lower"
        if getattr(bounds, side)[free[j]] != pipeline.specs[free[j]].neutral:
            out[pipeline.names[free[j]]] = side
    return out


def _intervals(pipeline: Pipeline, bounds: Bounds, free: np.ndarray, v: np.ndarray, sd: np.ndarray) -> dict:
    """Name to 95 % interval, within the bounds; a logarithmic parameter has it around its logarithm."""
    low = bounds.value(np.clip(v - Z95 * sd, 0, 1), free)
    high = bounds.value(np.clip(v + Z95 * sd, 0, 1), free)
    return {pipeline.names[i]: (float(a), float(b)) for i, a, b in zip(free, low, high, strict=True)}


def _free(pipeline: Pipeline, data: BodyData, twin: Twin, only: Sequence[str] | None) -> np.ndarray:
    """Indices of the parameters to fit, see `fit`."""
    spared = ()
    if only is None and data.unit == "kPa":  # the pressure knows nothing of the body behind it
        only = [e.name for e in pipeline.effects if e.stage == "pneumatics"]
    elif only is None:
        by_images = any(entry["change"] == BY_IMAGES for entry in twin.history)
        spared = _PROFILE if by_images and not any(c.startswith("q_") for c in data.columns) else ()
    else:
        known = {*pipeline.names, *(e.name for e in pipeline.effects)}
        for name in only:
            if name not in known:
                raise InputError(f"There is no parameter or effect '{name}'; there are {', '.join(known)}.")
    free = []
    for i, (name, spec) in enumerate(zip(pipeline.names, pipeline.specs, strict=True)):
        effect = name.rpartition(".")[0]
        wanted = only is None or name in only or (effect and effect in only)
        if wanted and name not in spared and not spec.fixed and effect not in pipeline.left_out:
            free.append(i)
    return np.array(free, int)
