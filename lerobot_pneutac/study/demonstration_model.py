"""What a fit of demonstrations finds: values, residuals and how they move, intervals."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from pneutac_sim.finger.confidence import Z95

TRUST = 0.3  # of the range of what is free: no step is longer
SHARES = (1.0, 0.5, 0.25, 0.1)


@dataclass(frozen=True)
class Form:
    """What is free.

    Attributes:
        effects: fitted: new ones, and those of the twin whose parameters are fitted anew.
    """

    effects: tuple[str, ...] = ()

    def plus(self, effect: str) -> "Form":
        """With one effect more."""
        return Form((*self.effects, effect))


@dataclass
class DemonstrationModel:
    """A fitted model.

    Attributes:
        form: what was free.
        values: name to value.
        residual: (n, k) of the rows and columns that were fitted, mm.
        jacobian: (n, k, P) of it by what was free, in units of its range.
        at_bound: names that stopped at a bound.
        unit: of what the Jacobian is by: name to its lower and upper bound, of the logarithm of those that
            are `logarithmic`.
        logarithmic: names.
        residual_at: (n, k) of it so far from what was found, (P,) in units of the range.
        bench: of what the free bend off the bench's counts: half the slope (P,), and the curvature (P, P).
    """

    form: Form
    values: dict[str, float]
    residual: np.ndarray
    jacobian: np.ndarray
    at_bound: list[str]
    unit: dict[str, tuple[float, float]]
    logarithmic: frozenset[str] = frozenset()
    residual_at: Callable[[np.ndarray], np.ndarray] = lambda step: np.empty(0)  # noqa: E731
    bench: tuple[np.ndarray, np.ndarray] = field(default_factory=lambda: (np.zeros(0), np.zeros((0, 0))))

    @property
    def cost(self) -> int:
        """Parameters, by which simpler models are told."""
        return self.jacobian.shape[2] + len(self.form.effects)

    def crossed(self, fold: np.ndarray) -> np.ndarray:
        """(n,) squared errors, each by a fit without its own fold, one Gauss-Newton step away.

        A step that leads too far, as where the rest hardly tells, is shortened until it helps the rest.
        """
        squared = (self.residual**2).sum(1)
        if not self.jacobian.shape[2]:
            return squared
        out, (slope, curved) = squared.copy(), self.bench
        for k, step in zip(np.unique(fold), self._steps(fold), strict=True):
            mine = fold == k
            for share in SHARES:
                there, way = (self.residual_at(share * step) ** 2).sum(1), share * step
                if there[~mine].sum() + 2 * slope @ way + way @ curved @ way <= squared[~mine].sum():
                    out[mine] = there[mine]
                    break
        return out

    def _steps(self, fold: np.ndarray) -> np.ndarray:
        """(folds, P) Gauss-Newton steps from the whole fit to those without each fold."""
        J, r, out = self.jacobian, self.residual, []
        slope, curved = self.bench
        for k in np.unique(fold):
            rest = J[fold != k].reshape(-1, J.shape[2])
            H = rest.T @ rest + curved
            ridge = 1e-6 * np.trace(H) / max(len(H), 1) + 1e-12
            step = -np.linalg.solve(H + ridge * np.eye(len(H)), rest.T @ r[fold != k].ravel() + slope)
            out.append(np.clip(step, -TRUST, TRUST))
        return np.array(out)

    def intervals(self, fold: np.ndarray) -> dict[str, tuple[float, float]]:
        """95 % intervals of what was free, from fits without each fold (jackknife)."""
        if not self.unit:
            return {}
        steps = self._steps(fold)
        n = len(steps)
        sd = np.sqrt((n - 1) / n * ((steps - steps.mean(0)) ** 2).sum(0))
        out = {}
        for (name, (low, high)), s in zip(self.unit.items(), sd, strict=True):
            value, wide = self.values[name], Z95 * float(s) * (high - low)
            log = name in self.logarithmic
            out[name] = (value * np.exp(-wide), value * np.exp(wide)) if log else (value - wide, value + wide)
        return out
