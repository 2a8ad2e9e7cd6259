"""What a search may try on photographs of a gel: sets of effects of light and gel."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from lerobot_pneutac.diagnosis.model import FittedModel
from lerobot_pneutac.diagnosis.steps import Steps
from lerobot_pneutac.study.gel_model import at_bound, calibration_pairs
from pneutac_datasets.recording.gel import GelRecording
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.gel.fit import fit_photographs
from pneutac_sim.gel.makes import library
from pneutac_sim.gel.metrics import CONTACT_DISC
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.photograph import Predictor
from pneutac_sim.gel.problem import GelFit
from pneutac_sim.twin import Twin

PROMISE = 0.01  # of the mean square error on the fitted photographs: least fall for which a set is judged


@dataclass(frozen=True)
class Trial:
    """Effects to be fitted.

    Attributes:
        effects: names, sorted.
        near: a fit with almost the same effects.
    """

    effects: tuple[str, ...]
    near: GelModel | None = field(default=None, compare=False)


@dataclass(kw_only=True)
class FittedGel(FittedModel):
    """Light and effects fitted to photographs; `residual` (n, 1) is each one's error, unseen by its fit.

    Attributes:
        form: the trial.
        fit: what was fitted to all photographs that are not kept for the report.
        gels: n gels, each fitted without the fold of its photograph.
        seen: (n,) mean square errors of `fit`, levels^2.
        contact: (n,) as the squares of `residual`, in the contact region.
    """

    form: Trial
    fit: GelFit
    gels: list[GelModel]
    seen: np.ndarray
    contact: np.ndarray

    @property
    def cost(self) -> int:
        """Number of parameters: what a simpler model has fewer of."""
        return self.count

    def crossed(self, fold: np.ndarray) -> np.ndarray:
        """(n,) squared errors, each from a fit without its fold; 0 where the fold is negative.

        A fit takes seconds, so the folds that the space was given stand, however they are dealt here.
        """
        return np.where(fold >= 0, self.squared, 0.0)


class GelSpace:
    """Everything that a search asks of photographs.

    Args:
        data: the photographs.
        gel: gives size, scale and thickness.
        twin: that the recording is judged with.
        train: (n,) mask of photographs that are fitted.
        fold: (n,) fold of photographs that are fitted and judged, -1 for all others.
        own: effects that every model has.
        candidates: effects that may be added.
    """

    def __init__(
        self,
        data: GelRecording,
        gel: GelModel,
        twin: Twin,
        train: np.ndarray,
        fold: np.ndarray,
        own: Sequence[str],
        candidates: Sequence[str],
    ):
        self.data, self.gel, self.twin, self.train, self.fold = data, gel, twin, train, fold
        self.own, self.candidates = tuple(own), list(candidates)
        self.photographs = [s.photograph for s in data.samples]
        self.steps, self._makes = Steps(), library()
        self._regions = [p.near(data.px_per_mm, CONTACT_DISC) for p in self.photographs]
        self._wholes: dict[Trial, tuple[GelFit, np.ndarray]] = {}
        self._known: dict[Trial, FittedGel] = {}

    # ---------------------------------------------------------------- what a search tries

    def bases(self) -> list[Trial]:
        """The effects of the twin."""
        return [Trial(tuple(sorted(self.own)))]

    def with_lines(self, model: FittedGel) -> list[Trial]:
        """None: a gel has no air."""
        return []

    def grow(self, model: FittedGel, most: int, pairs: int) -> list[Trial]:
        """One effect more, where it lowers the error of the photographs it is fitted to."""
        open_ = [self.plus(model, c) for c in self.candidates if c not in model.effects]
        left = {t: float(self._whole(t)[1][self.train].mean()) for t in open_}
        limit = (1 - PROMISE) * float(model.seen[self.train].mean())
        return sorted((t for t in open_ if left[t] < limit), key=left.__getitem__)[:most]

    def plus(self, model: FittedGel, effect: str) -> Trial:
        """A model with one effect more."""
        return Trial(tuple(sorted({*model.effects, effect})), model.fit.gel)

    def settle_line(self, model: FittedGel) -> FittedGel:
        """The model: it has no line."""
        return model

    def settle(self, model: FittedGel) -> FittedGel:
        """The model: nothing about how photographs were taken is searched for."""
        return model

    def again(self, model: FittedGel) -> Trial:
        """The same trial, which was fitted well at once."""
        return model.form

    def removable(self, model: FittedGel) -> list[str]:
        """Effects that the twin has not got."""
        return [e for e in model.effects if e not in self.own]

    def without(self, model: FittedGel, effect: str) -> FittedGel:
        """The model re-fitted without an effect."""
        rest = tuple(e for e in model.effects if e != effect)
        return self.fit(Trial(rest, model.fit.gel))

    # ---------------------------------------------------------------- fits

    def fit(self, trial: Trial, steps: int = 0, every: int = 1) -> FittedGel:
        """Fits a trial to all photographs, and for each fold to all others; always to the end."""
        if trial not in self._known:
            whole, seen = self._whole(trial)
            parts = {-1: whole.gel} | {
                k: self._fit(trial, self.train & (self.fold != k), whole.gel, True).gel
                for k in range(self.fold.max() + 1)
            }
            gels = [parts[k] for k in self.fold]
            differences = self.differences(gels)
            self._known[trial] = FittedGel(
                effects=trial.effects,
                residual=np.sqrt(mean_squares(differences))[:, None],
                count=sum(len(get_effect(e).parameters) for e in trial.effects),
                twin=self.twin,
                at_bound=at_bound(whole.gel, trial.effects),
                form=trial,
                fit=whole,
                gels=gels,
                seen=seen,
                contact=mean_squares(d[m] for d, m in zip(differences, self._regions, strict=True)),
            )
            self.steps.done()
        return self._known[trial]

    def differences(self, gels: Sequence[GelModel]) -> list[np.ndarray]:
        """Predicted - photographed of every photograph, each by its own gel, int16 (H, W, 3)."""
        pairs = calibration_pairs(self.data)
        predictors = {id(g): Predictor(g, pairs) for g in gels}
        return [
            predictors[id(g)].image(p.press, p.rest, p.clock, p.earlier).astype(np.int16) - p.image
            for g, p in zip(gels, self.photographs, strict=True)
        ]

    def _whole(self, trial: Trial) -> tuple[GelFit, np.ndarray]:
        """The fit to all photographs that may be fitted, and its mean square error (n,) on each."""
        if trial not in self._wholes:
            fit = self._fit(trial, self.train, trial.near, False)
            self._wholes[trial] = fit, mean_squares(self.differences([fit.gel] * len(self.photographs)))
        return self._wholes[trial]

    def _fit(self, trial: Trial, mask: np.ndarray, near: GelModel | None, quick: bool) -> GelFit:
        chosen = [p for p, m in zip(self.photographs, mask, strict=True) if m]
        return fit_photographs(self.gel, chosen, trial.effects, self._makes, near=near, quick=quick)


def mean_squares(images: Iterable[np.ndarray]) -> np.ndarray:
    """(n,) mean squares of n images."""
    return np.array([np.mean(np.square(np.asarray(image, np.float64))) for image in images])
