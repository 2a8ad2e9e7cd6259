"""What the choice of effects needs to know of a fitted model, and who fits it."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from pneutac_sim.finger.quantities import squared_distance
from pneutac_sim.twin import Twin


@dataclass
class FittedModel:
    """A model with all its parameters fitted to the training samples.

    Attributes:
        effects: names that are switched on, sorted.
        residual: (n, k) measured minus predicted at every sample, unit of the headline error.
        count: number of free parameters that are not at a bound where they do nothing.
        twin: the fitted twin; where a refit starts.
        names: free parameters, base parameters first, then `effect.parameter`.
        at_bound: parameter to `lower` or `upper`.
        not_identified: parameter to the reason.
        correlation: between the free parameters, (count, count).
        evaluations: simulations that the fit took.
    """

    effects: tuple[str, ...]
    residual: np.ndarray
    count: int
    twin: Twin
    names: list[str] = field(default_factory=list)
    at_bound: dict[str, str] = field(default_factory=dict)
    not_identified: dict[str, str] = field(default_factory=dict)
    correlation: np.ndarray | None = None
    evaluations: int = 0

    @property
    def squared(self) -> np.ndarray:
        """(n,) squared Euclidean distance."""
        return squared_distance(self.residual)

    def independent(self, mask: np.ndarray, least: int = 10) -> float:
        """Number of independent ones among the samples of a mask (n,), see `effective_count`."""
        return effective_count(self.residual, mask, least)


class Fitter(Protocol):
    """Fits models, several at a time where it can."""

    def fit_all(
        self, effects: Iterable[tuple[str, ...]], start: FittedModel | None = None
    ) -> list[FittedModel]:
        """One fit for each set of effects, in order, warm-started from `start`."""
        ...

    def promising(self, fit: FittedModel, candidates: list[str], least: float) -> list[str]:
        """Those that might lower the training mean square error of `fit` by the share `least` of it."""
        ...


def effective_count(residual: np.ndarray, mask: np.ndarray, least: int = 10) -> float:
    """Number of independent samples, N (1 - rho) / (1 + rho), with rho between neighbours.

    Args:
        residual: (n, k).
        mask: (n,) samples that count.
        least: independent pieces of time there are anyway.

    Returns:
        Between `least` and N.
    """
    pair = mask[1:] & mask[:-1]
    r = residual - residual[mask].mean(0)
    power = (r[mask] ** 2).sum() / max(mask.sum(), 1)
    n = int(mask.sum())
    if power <= 0 or not pair.any():
        return float(max(n, least))
    rho = float((r[1:][pair] * r[:-1][pair]).sum() / pair.sum() / power)
    rho = min(max(rho, 0.0), 0.9999)
    return float(min(max(n, least), max(least, n * (1 - rho) / (1 + rho))))


def bic(fit: FittedModel, mask: np.ndarray, n: float, floor: float) -> float:
    """Bayesian information criterion on the training samples, n log MSE + k log n.

    Args:
        fit: the fitted model.
        mask: (n,) training samples.
        n: effective number of samples, the same for all models that are compared.
        floor: a fit below the noise is not better than the noise; keeps a noise-free recording finite.
    """
    mse = max(float(fit.squared[mask].mean()), 0.25 * floor**2, 1e-18)
    return n * float(np.log(mse)) + fit.count * float(np.log(n))
