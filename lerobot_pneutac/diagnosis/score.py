"""A quick look at which effects are worth a fit, by a score test (one Gauss-Newton step, no iteration).

Each candidate is switched on at its starting values; what that changes, and what its parameters would change
from there, is regressed on the residual together with the parameters that are in the model already. The share
of the residual that this explains bounds, to first order, what a fit could win.
"""

import numpy as np

from lerobot_pneutac.diagnosis.fits import FittedModel
from pneutac_sim.finger.data import BodyData
from pneutac_sim.finger.pipeline import Pipeline
from pneutac_sim.twin import Twin

STEP = 1e-3
THIN = 3  # every third sample is enough to see a direction
SIZES = (0.3, 1.0, 3.0)  # of the starting value's distance from doing nothing


def promising(
    fit: FittedModel, candidates: list[str], least: float, bench: BodyData, train: np.ndarray
) -> list[str]:
    """Candidates that might lower the training mean square error of `fit` by the share `least` of it.

    Args:
        fit: the model so far.
        candidates: effects that it lacks.
        least: share of the mean square error.
        bench: the recording, prepared.
        train: (n,) training samples.
    """
    some = np.zeros(len(train), bool)
    some[np.flatnonzero(train)[::THIN]] = True
    residual = (fit.residual[some]).ravel()
    base = _columns(fit.twin, list(fit.effects), bench, some, None)
    power = float(((residual - base @ _solve(base, residual)) ** 2).sum())
    kept = []
    for name in candidates:
        J = np.hstack([base, _columns(fit.twin, [*fit.effects, name], bench, some, name)])
        J = J[:, np.isfinite(J).all(0)]
        left = float(((residual - J @ _solve(J, residual)) ** 2).sum())
        if left < (1 - least) * power:
            kept.append(name)
    return kept


def _columns(
    twin: Twin, effects: list[str], bench: BodyData, some: np.ndarray, new: str | None
) -> np.ndarray:
    """Directions (m, F) in which the prediction moves: of all parameters, or of the new effect alone."""
    pipeline = Pipeline.of(twin, bench.inputs, effects)
    scale = bench.inputs.pressure_range_kpa
    theta = pipeline.theta(twin, scale)
    outputs = bench.columns[: bench.counted]

    def predict(values, reuse=None):
        run = pipeline.run(bench.inputs, values, reuse)
        return pipeline.outputs(run, outputs)[some].ravel(), run

    columns = []
    if new is None:
        starts = [theta]
    else:
        neutral = pipeline.neutral(theta, [new])
        without = predict(neutral)[0]
        finite = np.isfinite(neutral)
        still = np.where(finite, neutral, 0.0)
        starts = [np.where(finite, still + s * (theta - still), theta / s) for s in SIZES]
        starts = [_inside(pipeline, t, scale) for t in starts]
        columns += [predict(t)[0] - without for t in starts]
    for start in starts[:2]:
        at, run = predict(start)
        for i, (name, spec) in enumerate(zip(pipeline.names, pipeline.specs, strict=True)):
            owner = name.rpartition(".")[0]
            if spec.fixed or owner in pipeline.left_out or (new is not None and owner != new):
                continue
            _, low, high = spec.limits(scale)
            step = STEP * (abs(start[i]) if spec.log else high - low)
            moved = start.copy()
            moved[i] += step if start[i] + step <= high else -step
            columns.append((predict(moved, run)[0] - at) / (moved[i] - start[i]))
    J = np.stack(columns, 1) if columns else np.zeros((int(some.sum()) * len(outputs), 0))
    return J / np.maximum(np.linalg.norm(J, axis=0), 1e-12)


def _inside(pipeline: Pipeline, theta: np.ndarray, scale: float) -> np.ndarray:
    limits = np.array([s.limits(scale) for s in pipeline.specs])
    return np.clip(theta, limits[:, 1], limits[:, 2])


def _solve(J: np.ndarray, y: np.ndarray) -> np.ndarray:
    gram = J.T @ J
    gram[np.diag_indices_from(gram)] += 1e-9
    return np.linalg.solve(gram, J.T @ y)
