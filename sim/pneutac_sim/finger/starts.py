"""Where a fit may start: from the twin as it is, from a rough guess of its drive, and at random."""

import numpy as np

from pneutac_sim.finger.data import BodyData
from pneutac_sim.finger.pipeline import Pipeline
from pneutac_sim.finger.problem import Bounds, Problem

# Tried for each joint: rad at the largest pressure, rest pressure over the largest one, angle over 2 pi.
_GAIN = (-0.7, -0.3, -0.12, -0.04, 0.02, 0.04, 0.08, 0.12, 0.2, 0.3, 0.5, 0.8)
_REST = (-0.5, -0.1, 0.0, 0.1, 0.5, 1.0)
_ANGLE = tuple(np.arange(-6, 6) / 12)


def rough_drive(
    pipeline: Pipeline, data: BodyData, theta: np.ndarray, bounds: Bounds, free: np.ndarray
) -> np.ndarray:
    """The best of a coarse grid over gain, rest pressure and the chambers' directions, without any effect.

    Args:
        pipeline: with its effects.
        data: thinned; the grid has 72 points for a finger, 264 for an arm.
        theta: (P,) all other parameters.
        bounds: of the pipeline.
        free: (F,) indices of parameters that may change.

    Returns:
        (P,) parameters.
    """
    p = data.inputs.pressure_range_kpa
    tried = {
        "gain_rad_per_kpa": [s / p for s in _GAIN],
        "rest_pressure_kpa": [s * p for s in _REST],
        "chamber_angle_rad": [2 * np.pi * s for s in _ANGLE],
    }
    axes = {pipeline.names.index(k): v for k, v in tried.items() if k in pipeline.names}
    axes = {
        i: [x for x in values if bounds.lower[i] <= x <= bounds.upper[i]]
        for i, values in axes.items()
        if i in free
    }
    if "chamber_angle_rad" in pipeline.names and pipeline.names.index("chamber_angle_rad") in axes:
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
