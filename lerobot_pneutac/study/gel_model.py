"""A gel between a twin and a recording's images, and what a search may try on them."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lerobot_pneutac.diagnosis import thresholds as T
from lerobot_pneutac.diagnosis.result import FittedModel
from lerobot_pneutac.diagnosis.search import Space, Start, Structure
from lerobot_pneutac.diagnosis.steps import Steps
from pneutac_datasets.recording.gel import GelRecording
from pneutac_sim.effects.registry import get_effect, sensor_effects
from pneutac_sim.gel.fit import GelFit, fit_photographs
from pneutac_sim.gel.identifiability import library
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.pair import CONTACT_DISC
from pneutac_sim.gel.photograph import Predictor, Pressed
from pneutac_sim.twin import Twin


def for_twin(gel: GelModel, twin: Twin) -> GelModel:
    """The gel at the size in which the twin has its images; as it is where that is of other proportions."""
    (h, w), (rows, columns) = gel.rest_image.shape[:2], GelModel.from_twin(twin).rest_image.shape[:2]
    return gel.resized(rows, columns) if twin.gel and abs(w * rows / (h * columns) - 1) <= 0.02 else gel


def predict(gel: GelModel, data: GelRecording, pressed: Pressed | None = None) -> list[np.ndarray]:
    """Predicted image of every sample; the calibration pairs show how the light drifts.

    Args:
        gel: of this recording.
        data: its images.
        pressed: gives the surfaces, see `Predictor`.
    """
    predictor = Predictor(gel, data.presses, pressed)
    return [predictor.image(s.press, s.rest, s.clock, s.earlier) for s in data.samples]


def late_effects(effects: dict[str, dict[str, float]]) -> dict[str, dict[str, float]]:
    """Effects whose values stay where photographs do not identify them: of what earlier presses leave."""
    return {name: values for name, values in effects.items() if sensor_effects()[name].late}


def seen_by(gel: GelModel, data: GelRecording) -> GelModel:
    """The same gel in a recording's images: their rest image, scale and thickness."""
    own = {"rest_image": data.rest, "px_per_mm": data.px_per_mm, "thickness_mm": data.thickness_mm}
    return replace(gel, **own)


def at_bound(gel: GelModel, effects: Sequence[str]) -> list[str]:
    """Parameters of these effects that lie at a bound."""
    return [
        f"{e}.{p.name}"
        for e in effects
        for p in get_effect(e).parameters
        if min(gel.effects[e][p.name] - p.lower, p.upper - gel.effects[e][p.name])
        < T.AT_BOUND * (p.upper - p.lower)
    ]


@dataclass(kw_only=True)
class FittedGel(FittedModel):
    """Light and effects fitted to photographs; `residual` (n, 1) is each one's error, unseen by its fit."""

    structure: Structure  # its structure, effects sorted
    fit: GelFit  # what was fitted to all photographs outside the test part
    gels: list[GelModel]  # n gels, each fitted without the fold of its photograph
    seen: np.ndarray  # (n,) mean square errors of `fit`, levels^2
    contact: np.ndarray  # (n,) as the squares of `residual`, in the contact region

    @property
    def values(self) -> GelModel:
        """Where a fit of a similar structure begins."""
        return self.fit.gel

    @property
    def cost(self) -> int:
        return self.count

    def cv_squared(self, fold: np.ndarray) -> np.ndarray:
        """(n,) squared errors, each from a fit without its fold; 0 where the fold is negative.

        A fit takes seconds, so the folds that the space was given stand, however they are dealt here.
        """
        return np.where(fold >= 0, self.squared, 0.0)


class GelSpace(Space):
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
        self.twin_effects, self.candidates = tuple(own), list(candidates)
        self.photographs = data.samples
        self.steps, self._makes = Steps(), library()
        self._regions = [p.near(data.px_per_mm, CONTACT_DISC) for p in self.photographs]
        self._wholes: dict[Structure, tuple[GelFit, np.ndarray]] = {}
        self._known: dict[Structure, FittedGel] = {}

    # ---------------------------------------------------------------- what a search tries

    def bases(self) -> list[Start]:
        return [(Structure(tuple(sorted(self.twin_effects))), None)]

    def grow(self, model: FittedGel, most: int, pairs: int) -> list[Start]:
        """One effect more, where it lowers the error of the photographs it is fitted to."""
        open_ = [self.plus(model, c) for c in self.candidates if c not in model.effects]
        left = {s[0]: float(self._whole(s)[1][self.train].mean()) for s in open_}
        limit = (1 - T.PROMISE) * float(model.seen[self.train].mean())
        return sorted((s for s in open_ if left[s[0]] < limit), key=lambda s: left[s[0]])[:most]

    def plus(self, model: FittedGel, effect: str) -> Start:
        return (Structure(tuple(sorted({*model.effects, effect}))), model.values)

    def removable(self, model: FittedGel) -> list[str]:
        return [e for e in model.effects if e not in self.twin_effects]

    def without(self, model: FittedGel, term: str) -> FittedGel:
        return self.fit((model.structure.without(term), model.values))

    # ---------------------------------------------------------------- fits

    def fit(self, start: Start, steps: int = 0, every: int = 1) -> FittedGel:
        """Fits a structure to all photographs, and for each fold to all others; always to the end."""
        structure, _ = start
        if structure not in self._known:
            whole, seen = self._whole(start)
            parts = {-1: whole.gel} | {
                k: self._fit(structure, self.train & (self.fold != k), whole.gel, True).gel
                for k in range(self.fold.max() + 1)
            }
            gels = [parts[k] for k in self.fold]
            differences = self.differences(gels)
            self._known[structure] = FittedGel(
                effects=structure.effects,
                residual=np.sqrt(mean_squares(differences))[:, None],
                count=sum(len(get_effect(e).parameters) for e in structure.effects),
                twin=self.twin,
                at_bound=at_bound(whole.gel, structure.effects),
                structure=structure,
                fit=whole,
                gels=gels,
                seen=seen,
                contact=mean_squares(d[m] for d, m in zip(differences, self._regions, strict=True)),
            )
            self.steps.done()
        return self._known[structure]

    def differences(self, gels: Sequence[GelModel]) -> list[np.ndarray]:
        """Predicted - photographed of every photograph, each by its own gel, int16 (H, W, 3)."""
        predictors = {id(g): Predictor(g, self.data.presses) for g in gels}
        return [
            predictors[id(g)].image(p.press, p.rest, p.clock, p.earlier).astype(np.int16) - p.image
            for g, p in zip(gels, self.photographs, strict=True)
        ]

    def _whole(self, start: Start) -> tuple[GelFit, np.ndarray]:
        """The fit to all photographs that may be fitted, and its mean square error (n,) on each."""
        structure, near = start
        if structure not in self._wholes:
            fit = self._fit(structure, self.train, near, False)
            self._wholes[structure] = (
                fit,
                mean_squares(self.differences([fit.gel] * len(self.photographs))),
            )
        return self._wholes[structure]

    def _fit(self, structure: Structure, mask: np.ndarray, near: GelModel | None, quick: bool) -> GelFit:
        chosen = [p for p, m in zip(self.photographs, mask, strict=True) if m]
        return fit_photographs(self.gel, chosen, structure.effects, self._makes, near=near, quick=quick)


def mean_squares(images: Iterable[np.ndarray]) -> np.ndarray:
    return np.array([np.mean(np.square(np.asarray(image, np.float64))) for image in images])
