"""Within what a measurement should lie if the twin is right: prediction bands of a body's comparison.

To first order a sample's prediction varies by g C g^T, g its gradient to the parameters and C their
covariance (Seber and Wild, Nonlinear Regression, Wiley 1989, ch. 5.1); the measurement adds its noise. A twin
keeps the interval of each parameter but not how they go together: a bend that is a little too large may be
put down to gain or to rest pressure. So C has the form that least squares gives it on the recording's train
samples, and the size from the twin's intervals.
"""

from dataclasses import dataclass, replace

import numpy as np

from pneutac_datasets.recording.noise import NoiseFloor
from pneutac_sim.finger.confidence import Z95, independent
from pneutac_sim.finger.data import BodyData
from pneutac_sim.finger.pipeline import Pipeline
from pneutac_sim.twin import Twin

STEP = 0.05  # of a standard deviation: how far a parameter is moved to see what it does


@dataclass(frozen=True)
class Band:
    """95 % prediction bands of the columns that count.

    Attributes:
        half: (n, k) half width, in the unit of each column.
        how: what they are made from, in words.
    """

    half: np.ndarray
    how: str

    def inside(self, residual: np.ndarray) -> np.ndarray:
        """(n, k) whether a residual, measured minus model, lies in the band."""
        return np.abs(residual) <= self.half

    def at(self, samples: np.ndarray) -> "Band":
        """Of these samples (m,) alone."""
        return replace(self, half=self.half[samples])


def prediction_band(twin: Twin, bench: BodyData, train: np.ndarray, noise: NoiseFloor) -> Band | None:
    """Bands from the intervals of a twin's parameters and from the measurement's noise.

    Args:
        twin: of the recording's device.
        bench: the recording as the twin reads it.
        train: (n,) mask of samples on which the parameters were fitted.
        noise: of the recording.

    Returns:
        None where the noise is unknown, or neither intervals nor noise are there.
    """
    if noise.value is None:
        return None
    sensor = np.array([noise.by_column.get(c, 0.0) for c in bench.columns[: bench.counted]])
    moved = _moved(twin, bench)
    if moved.shape[-1] == 0:
        how = "the noise alone, as no parameter of the twin has an interval"
        return Band(np.tile(Z95 * sensor, (len(bench), 1)), how) if sensor.any() else None
    half = Z95 * np.sqrt(_variance(moved, train) + sensor**2)
    return Band(half, "the intervals of the twin's parameters and the noise")


def _moved(twin: Twin, bench: BodyData) -> np.ndarray:
    """(n, k, F): what one standard deviation of each parameter with an interval does to the prediction."""
    pipeline, columns = Pipeline.of(twin, bench.inputs), bench.columns[: bench.counted]
    theta = pipeline.theta(twin, bench.inputs.pressure_range_kpa)
    run = pipeline.run(bench.inputs, theta)
    here = pipeline.outputs(run, columns)
    out = [np.zeros((*here.shape, 0))]
    for i, (name, spec) in enumerate(zip(pipeline.names, pipeline.specs, strict=True)):
        effect, _, parameter = name.rpartition(".")
        value = (twin.effects.get(effect, {}) if effect else twin.parameters).get(parameter)
        if value is None or value.ci95 is None or value.ci95[0] == value.ci95[1]:
            continue
        inner, outer = (np.log, np.exp) if spec.log else (float, float)
        # the longer side: a bound may have cut the other one
        side = max((inner(end) - inner(value.value) for end in value.ci95), key=abs)
        there = theta.copy()
        there[i] = outer(inner(value.value) + STEP * side / Z95)
        moved = pipeline.outputs(pipeline.run(bench.inputs, there, run), columns)
        out.append((moved - here)[..., None] / STEP)
    return np.concatenate(out, axis=-1)


def _variance(moved: np.ndarray, train: np.ndarray) -> np.ndarray:
    """(n, k) variance of the predictions that the parameters leave open.

    Parameters that the train samples do not separate vary by their own intervals only.
    """
    trained = moved[train].reshape(-1, moved.shape[-1])
    known = independent(trained)
    variance = (moved[..., ~known] ** 2).sum(axis=-1)
    if known.any():
        inverse = np.linalg.inv(trained[:, known].T @ trained[:, known])
        # counted in their own standard deviations, the diagonal of a covariance is one
        covariance = inverse / np.median(np.diag(inverse))
        variance += np.einsum("nki,ij,nkj->nk", moved[..., known], covariance, moved[..., known])
    return variance
