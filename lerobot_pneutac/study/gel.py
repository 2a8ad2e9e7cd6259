"""A gel between a twin and a recording's photographs, what a search may try on them, and what it found.

A sample is a photograph. At every imprint the force by the law of `pneutac_sim.gel.force` is proportional to
Young's modulus, so that each press with a measured force gives one; the gel's is their geometric mean, as
errors of depth and of the law are relative ones.
"""

import math
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import stats
from scipy.ndimage import map_coordinates

from lerobot_pneutac.diagnosis import thresholds as T
from lerobot_pneutac.diagnosis.bootstrap import Parts
from lerobot_pneutac.diagnosis.result import FittedModel, Outcome, Tested, Untested
from lerobot_pneutac.diagnosis.search import (
    Found,
    Scored,
    Search,
    Space,
    Start,
    Steps,
    Structure,
    chosen_in,
    contenders,
    deal_folds,
    rivals,
)
from lerobot_pneutac.diagnosis.verdict import too_few
from lerobot_pneutac.study.base import EffectStudy
from pneutac_datasets.recording.gel import GelRecording, GelSample
from pneutac_datasets.recording.noise import NoiseFloor
from pneutac_datasets.recording.recording import Recording, assign
from pneutac_sim.effects.registry import get_effect, of_sensor, sensor_effects
from pneutac_sim.errors import InputError
from pneutac_sim.finger.quantities import root_mean
from pneutac_sim.gel import optics
from pneutac_sim.gel.fit import LEFT_RADII, GelFit, fit_photographs
from pneutac_sim.gel.force import MATERIAL, MODULUS, MODULUS_MPA, GelForce
from pneutac_sim.gel.identifiability import library
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.pair import CONTACT_DISC, FAR_ENOUGH, PressPhotograph, press_px
from pneutac_sim.gel.photograph import Predictor, Pressed, session_light
from pneutac_sim.twin import Twin, Value


def for_twin(gel: GelModel, twin: Twin) -> GelModel:
    """The gel at the size in which the twin has its images; as it is where that is of other proportions."""
    (h, w), (rows, columns) = gel.rest_image.shape[:2], GelModel.from_twin(twin).rest_image.shape[:2]
    return gel.resized(rows, columns) if twin.gel and abs(w * rows / (h * columns) - 1) <= 0.02 else gel


def predict(gel: GelModel, data: GelRecording, pressed: Pressed | None = None) -> list[np.ndarray]:
    """Predicted image of every sample; the calibration pairs show how the light drifts.

    `pressed` gives the surfaces, see `Predictor`.
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

    `gel` gives size, scale and thickness; of the photographs, `train` (n,) masks those that are fitted, and
    `fold` (n,) is that of those which are judged too, -1 for all others. Every model has the effects `own`.
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


RECENT = 3  # presses before, of which something may be left that is no noise


def away(
    photographs: Sequence[PressPhotograph], differences: Iterable[np.ndarray], px_per_mm: float
) -> float:
    """Root mean square of differences (H, W, 3) away from contacts; 0 where no photograph shows enough."""
    out = []
    for p, difference in zip(photographs, differences, strict=True):
        far = ~p.near(px_per_mm)
        for e in p.earlier[-RECENT:]:
            far &= ~replace(p, press=e.press).near(px_per_mm, LEFT_RADII)
        if far.mean() > FAR_ENOUGH:
            out.append(np.mean(np.square(difference[far].astype(float))))
    return float(np.sqrt(np.mean(out))) if out else 0.0


def noise(photographs: Sequence[PressPhotograph], px_per_mm: float) -> float:
    """What is left away from contacts once each photograph's own drift of light is taken off, levels."""
    left = []
    for p in photographs:
        drift = optics.upsample(session_light(p, px_per_mm), *p.rest.shape[:2])
        left.append(p.image.astype(float) - p.rest - drift)
    return away(photographs, left, px_per_mm)


UNHELD = "cannot be tested, record column hold_s and a time_s that runs on"


def sort_candidates(data: GelRecording, own: Sequence[str]) -> tuple[list[str], list[Untested]]:
    """Effects to try that a twin has not got, and those that these photographs cannot test."""
    others = {n: e for n, e in sensor_effects().items() if n not in own}
    has_earlier = any(s.earlier for s in data.samples)
    untested = [Untested(n, UNHELD) for n, e in others.items() if e.late and not has_earlier]
    return [n for n, e in others.items() if has_earlier or not e.late], untested


def deal_photographs(recording: Recording, seed: int) -> Parts:
    """Photographs to fit, to choose by and to test on; the last two are one where there are fewer than 24.

    Raises:
        InputError: there is no photograph besides the calibration pair.
    """
    n = len(recording)
    roles = recording.samples["role"].astype(str) if recording.has("role") else np.full(n, "")
    judged = np.asarray(roles != "calibration")
    if not judged.any():
        raise InputError("The recording has no image but the calibration pair, so no error can be computed.")
    train, test = np.ones(n, bool), judged
    if n >= T.APART:
        others = np.flatnonzero(judged)
        part = assign(recording.samples.iloc[others], np.arange(len(others)), seed, (2 / 3, 1 / 3))
        test = np.isin(np.arange(n), others[part == 1])
        train = ~test
    stratum = np.unique(np.asarray(roles), return_inverse=True)[1]
    return Parts(train, judged & train, test, np.arange(n), stratum)


def photograph_folds(parts: Parts, seed: int) -> np.ndarray:
    """(n,) fold of each photograph that is judged by cross-validation; -1 for all others."""
    fold = np.full(len(parts.unit), -1)
    fold[parts.validation] = deal_folds(parts.unit[parts.validation], T.FOLDS, seed)
    return fold


GAIN = 4.0  # maps are shown this many times brighter
CONTACT_PX, CONTACT_RADII = 121, 3.0  # of the map around a contact, and how far it reaches


def error_pictures(
    samples: list[GelSample], differences: list[list[np.ndarray]]
) -> list[tuple[np.ndarray, str]]:
    """Maps of some models side by side, uint8 (H, W, 3), with what they show.

    `differences` are, of each model and photograph, predicted - photographed, int16 (H, W, 3).
    """
    planes = np.concatenate([np.clip(GAIN * plane(each), 0, 255) for each in differences], 1)
    contacts = [np.clip(128 + GAIN * contact(samples, each), 0, 255) for each in differences]
    return [
        (
            planes.astype(np.uint8),
            f"Root mean square error over the test images, {GAIN:g} times brighter; left as it is, right "
            "with all effects found.",
        ),
        (
            np.concatenate(contacts, 1).astype(np.uint8).repeat(2, 0).repeat(2, 1),
            "Mean of rendered less photographed around the contact, three contact radii each way; grey is "
            "none.",
        ),
    ]


def plane(differences: list[np.ndarray]) -> np.ndarray:
    """Root mean square in the image plane (H, W, 3), levels."""
    return np.sqrt(np.mean([np.square(d.astype(float)) for d in differences], axis=0))


def contact(samples: list[GelSample], differences: list[np.ndarray]) -> np.ndarray:
    """Signed mean around the contact (121, 121, 3), from -3 to 3 contact radii, levels."""
    t = np.linspace(-CONTACT_RADII, CONTACT_RADII, CONTACT_PX)
    x, y = np.meshgrid(t, t)
    total, count = np.zeros((CONTACT_PX, CONTACT_PX, 3)), np.zeros((CONTACT_PX, CONTACT_PX, 1))
    for s, difference in zip(samples, differences, strict=True):
        d = difference.astype(float)
        at = [s.y_px - 0.5 + y * s.radius_px, s.x_px - 0.5 + x * s.radius_px]
        inside = (at[0] >= 0) & (at[0] <= d.shape[0] - 1) & (at[1] >= 0) & (at[1] <= d.shape[1] - 1)
        shown = np.stack([map_coordinates(d[..., k], at, order=1) for k in range(3)], -1)
        total += shown * inside[..., None]
        count += inside[..., None]
    return total / np.maximum(count, 1)


class GelStudy(EffectStudy):
    """A gel and its optics; arguments are those of `study_of`.

    Raises InputError where there is no good calibration pair, or no photograph to test on.
    """

    unit = "levels"
    more_data = (
        f"Press one ball at {T.NEEDED} places all over the window, to several depths; note where and how "
        "deep."
    )

    @property
    def repeat(self) -> str:
        """Other shapes than were pressed."""
        pressed = set(self.recording.samples.get("indenter", ()))
        shapes = {"edge": "an edge", "cylinder": "a small cylinder", "cube": "a cube", "cone": "a cone"}
        other = [words for name, words in (shapes | {"sphere": "a ball"}).items() if name not in pressed]
        if not other:
            return "All shapes of indenters were pressed: press them at other places and to other depths."
        shapes = " or ".join(other[:2])
        return f"Press other shapes, such as {shapes}: so far the light is known for these alone."

    nothing_left = repeat

    def __init__(self, twin: Twin, recording: Recording, seed: int = 0):
        data = GelRecording.load(recording, to_fit=True)
        self.twin, self.recording, self.seed, self.data = twin, recording, seed, data
        self.findings = data.warnings
        self.twin_effects = tuple(of_sensor(twin.effects))
        self.candidates, self.untested = sort_candidates(data, self.twin_effects)
        self.parts = deal_photographs(recording, seed)
        self._stored = seen_by(GelModel.from_twin(twin), data)
        fold = photograph_folds(self.parts, seed)
        gel = replace(self._stored, effects=late_effects(self._stored.effects))
        self.space = GelSpace(data, gel, twin, self.parts.train, fold, self.twin_effects, self.candidates)

    @cached_property
    def noise(self) -> NoiseFloor:
        how = "images away from contacts, less each image's own smooth drift of light"
        value = noise(self.space.photographs, self.data.px_per_mm)
        return NoiseFloor(value, None, self.unit, how, {})

    # ---------------------------------------------------------------- the verbs

    def refit(self, effects: Sequence[str], start: FittedGel | None, steps: Steps) -> FittedGel:
        """Light and these effects, fitted to all photographs outside the test part."""
        model = self.space.fit((Structure(tuple(sorted(effects))), start and start.values))
        steps.done()
        return model

    def search(self, jobs: int, steps: Steps) -> Outcome:
        began, space = time.perf_counter(), self.space
        engine = Search(
            space,
            self.bootstrap,
            space.fold,
            self.noise.floor,
            report=lambda text: steps.expect(f"{text} {self.unit}", 0),
        )
        steps.expect("the twin as it is, and with each effect", 1 + len(self.candidates))
        space.steps = steps
        found = engine.find()
        base, final = found.base.model, found.final.model
        alone = {e: space.fit(space.plus(base, e)) for e in self.candidates}
        steps.expect("what each effect of the twin is good for", len(self.twin_effects))
        taken = {e: space.without(base, e) for e in self.twin_effects}
        votes = chosen_in(found, self.parts.unit, self.noise.floor, str)
        came = dict.fromkeys(e for step in found.path for e in step.model.effects)
        added = [e for e in came if e in final.effects and e not in self.twin_effects]
        selected = sorted(added, key=lambda e: -found.without[e].value)
        excess = self.bootstrap.value(base.squared) - self.noise.floor**2
        falls = {e: self.bootstrap.drop(base.squared, fit.squared)[0] for e, fit in alone.items()}
        evidence = self.evidence(
            base,
            final,
            selected,
            votes,
            floor=max(self.noise.floor, self._far(final)),  # drifts of light count too
            near_miss=[] if selected else [e for e, fall in falls.items() if fall > T.MOST * excess > 0],
            explained=self.explained(final),
        )
        tested = [self.alone(e, fit, base, "added to the twin") for e, fit in alone.items()]
        tested.sort(key=lambda t: -(t.reduction or 0.0))
        tested += [
            Tested(e, self.errors(f), None, None, {}, "taken out of the twin") for e, f in taken.items()
        ]
        ladder = [("as it is", base)]
        for name in added:
            ladder.append((f"+ {name}", space.fit(space.plus(ladder[-1][1], name))))
        others = rivals(
            found,
            self.noise.floor,
            final.effects,
            str,
            lambda s: s.model,
            self._as_good,
            len(self.candidates),
        )
        return self.outcome(
            began,
            base,
            final,
            evidence,
            ladder=ladder,
            tested=tested,
            rivals=sorted(others, key=lambda r: r.difference),
            chosen_in={e: votes[e] for e in selected},
            contenders=contenders(
                weighed(found), self.bootstrap, base.effects, lambda s: self.twin_of(s.model)
            ),
        )

    def tested_errors(self, model: FittedGel) -> dict[str, float]:
        return self.errors(model)

    def _as_good(self, before: Scored, taken: Scored, other: Scored) -> bool:
        """Whether another model helps significantly, and the chosen one does not help significantly more."""
        if not set(taken.model.effects) - set(before.model.effects) - set(other.model.effects):
            return False
        more, low, _ = self.bootstrap.drop(other.cv_squared, taken.cv_squared)
        excess = max(before.value - self.noise.floor**2, 0.0)
        return self.bootstrap.drop(before.cv_squared, other.cv_squared)[1] > 0 and (
            low <= 0 or more < T.AS_GOOD * excess
        )

    def explained(self, model: FittedGel) -> float:
        """Share of what a contact changes that a model predicts on test photographs."""
        rest = mean_squares(p.image.astype(float) - p.rest for p in self.space.photographs)
        return self.test.reduction(rest, model.squared, self.noise.floor)[0]

    def idle(self, model: FittedGel, effect: str) -> bool:
        """Whether an effect moves the images by less than `thresholds.IDLE_OF_NOISE` of the noise."""
        gel, n = model.fit.gel, len(self.space.photographs)
        without = replace(gel, effects={e: v for e, v in gel.effects.items() if e != effect})
        seen, plain = (self.space.differences([g] * n) for g in (gel, without))
        moved = mean_squares(a - b for a, b in zip(seen, plain, strict=True))
        return root_mean(moved) < T.IDLE_OF_NOISE * self.noise.floor

    def _far(self, model: FittedGel) -> float:
        """Error of a model away from contacts on test photographs, levels."""
        space, shown = self.space, np.flatnonzero(self.parts.test)
        differences = space.differences(model.gels)
        return away(
            [space.photographs[i] for i in shown], [differences[i] for i in shown], self.data.px_per_mm
        )

    # ---------------------------------------------------------------- sentences

    def errors(self, model: FittedGel) -> dict[str, float]:
        return super().errors(model) | {
            "train": root_mean(model.seen[self.parts.train]),
            "heldout_contact": root_mean(model.contact[self.parts.test]),
        }

    def refusal(self, effect: str) -> str:
        why = next((u.reason for u in self.untested if u.name == effect), "")
        if why:
            return f"'{effect}' {why}."
        if effect not in sensor_effects():
            return f"'{effect}' does not act on a gel's images; give one of {', '.join(sensor_effects())}."
        return self.already_on(effect)

    def twin_of(self, model: FittedGel) -> Twin:
        twin = self.twin.copy()
        for_twin(model.fit.gel, twin).into_twin(twin)
        return twin

    def parameters(self, model: FittedGel, effect: str) -> dict[str, dict]:
        units = {p.name: p.unit for p in get_effect(effect).parameters}
        values = model.fit.gel.effects[effect]
        return {k: {"value": v, "ci95": None, "unit": units[k]} for k, v in values.items()}

    def at_bound(self, model: FittedGel, effects: Sequence[str]) -> list[str]:
        return at_bound(model.fit.gel, effects)

    def amount_recorded(self) -> tuple[float, str, str]:
        return float(len(self.data.samples)), "photograph", "of such presses"

    def too_little(self) -> str:
        images, judged = len(self.data.samples), self.test.units
        if not too_few(images, judged, T.NEEDED):
            return ""
        return (
            f"This recording cannot decide: it has {images} images, {judged} of them usable for the test; "
            f"{T.NEEDED} are needed, including the calibration pair's."
        )

    def how_tested(self, outcome: Outcome) -> str:
        parts, stored = self.parts, self._stored_error
        n, tested = len(parts.train), parts.test.sum()
        as_stored = "" if stored is None else f"As stored it is {stored:.3g} levels off. "
        if parts.has_test:
            return (
                f"{as_stored}Everything below is re-fitted to {parts.train.sum()} of the {n} images, chosen "
                f"by {T.FOLDS}-fold cross-validation among them, and tested on the other {tested}."
            )
        return (
            f"{as_stored}With {n} images, fewer than {T.APART}, there is no separate test part: effects are "
            f"chosen and tested on {tested} by five-fold cross-validation, so the errors are slightly "
            "optimistic."
        )

    def as_written(self, parameters: dict[str, dict]) -> dict[str, float]:
        return {k: p["value"] for k, p in parameters.items()}

    @cached_property
    def _stored_error(self) -> float | None:
        """Error of the twin's gel as it is stored, on test photographs; None where it has no light."""
        if not self._stored.light.any():
            return None
        differences = self.space.differences([self._stored] * len(self.data.samples))
        return float(np.sqrt(self.test.value(mean_squares(differences))))

    def details(self, outcome: Outcome) -> dict:
        fit, names = outcome.after.fit, [s.name for s in self.data.samples]
        return {
            "stored": self._stored_error,
            "make": fit.make,
            "orientation": str(fit.orientation) if fit.make else "",
            "trained_on": [n for n, t in zip(names, self.parts.train, strict=True) if t],
            "tested_on": [n for n, t in zip(names, self.parts.test, strict=True) if t],
        }

    def pictures(self, outcome: Outcome) -> list[tuple[np.ndarray, str]]:
        """Where in the image the twin fails, left as it is, right with all effects found."""
        models = [outcome.before, outcome.after] if outcome.selected else [outcome.before]
        shown = np.flatnonzero(self.parts.test)
        each = [self.space.differences(m.gels) for m in models]
        return error_pictures([self.data.samples[i] for i in shown], [[d[i] for i in shown] for d in each])


def weighed(found: Found) -> list[Scored]:
    """The final model, others that were fitted well, and last the twin as it is, re-fitted."""
    rest = [s for round_ in reversed(found.rivals) for s in sorted(round_, key=lambda s: s.value)]
    others = {s.model.effects: s for s in [found.final, *found.without.values(), *found.path, *rest]}
    others.pop(found.base.model.effects, None)
    return [*list(others.values())[: 1 + T.MOST_OTHERS], found.base]


@dataclass(frozen=True)
class Modulus:
    """A gel's modulus from presses."""

    value_mpa: float  # the modulus
    ci95: tuple[float, float] | None  # its 95 % interval, by Student's t over presses; None of one press
    presses: int  # how many have a force
    off: float  # relative error of the law's forces on them, root mean square
    heldout: float | None  # the same of presses that were not fitted; None where there are none

    def parameter(self) -> dict[str, dict]:
        return {MODULUS: {"value": self.value_mpa, "ci95": self.ci95, "unit": "MPa"}}


def keep_modulus(twin: Twin, data: GelRecording) -> Modulus | None:
    """Fits the modulus to the rows of role `calibration` that have `force_n`, and writes it into the twin.

    Returns the modulus; None, with the twin as it was, if no row has a force. Raises InputError where the
    forces are not those of a rubber.
    """
    forced = [s for s in data.samples if s.force_n is not None]
    if not any(s.role == "calibration" for s in forced):
        return None
    soft = twin.copy()
    soft.parameters[MODULUS] = Value(MATERIAL[MODULUS])
    law = GelForce.of(soft)
    moduli = {
        r: np.log([_over(law, s) for s in forced if (s.role == "calibration") == r]) for r in (True, False)
    }
    mean, n = moduli[True].mean(), len(moduli[True])
    value = MATERIAL[MODULUS] * math.exp(mean)
    if not MODULUS_MPA[0] <= value <= MODULUS_MPA[1]:
        raise InputError(
            f"By force_n the gel's modulus would be {value:.2g} MPa, and a gel's lies between "
            f"{MODULUS_MPA[0]:g} and {MODULUS_MPA[1]:g}; give force_n in newton and depth_mm in millimetres."
        )
    ci95 = None
    if n > 1:
        half = stats.t.ppf(0.975, n - 1) * moduli[True].std(ddof=1) / math.sqrt(n)
        ci95 = value * math.exp(-half), value * math.exp(half)
    twin.parameters[MODULUS] = Value(value, ci95)
    off, heldout = (float(np.sqrt(np.mean((t - mean) ** 2))) if len(t) else None for t in moduli.values())
    return Modulus(value, ci95, n, off or 0.0, heldout)


def _over(law: GelForce, s: GelSample) -> float:
    assert s.force_n is not None
    return s.force_n / law.force(s.press.depths(law.window_mm, law.thickness_mm))


def modulus_sentence(modulus: Modulus | None, twin: Twin) -> str:
    if modulus is None:
        known = twin.parameters.get(MODULUS)
        value = known.value if known else MATERIAL[MODULUS]
        source = "keeps its modulus of" if known else "is assumed to have a modulus of"
        return f"No press has a force (column force_n), so the gel {source} {value:.2g} MPa."
    of = f"{modulus.presses} presses" if modulus.presses > 1 else "one press"
    between = " ({:.2g} to {:.2g})".format(*modulus.ci95) if modulus.ci95 else ""
    off = (
        ""
        if modulus.heldout is None
        else f"; the forces of the others are off by {100 * modulus.heldout:.0f} %"
    )
    return f"The force of {of} gives the gel a modulus of {modulus.value_mpa:.2g} MPa{between}{off}."


class Pasted:
    """Predicts the calibration's difference to rest, moved to the contact by whole pixels.

    It knows nothing of the indenter, its depth or where the light comes from, so a model worth having beats
    it wherever the test's contact differs from the calibration's.
    """

    def __init__(self, pair: PressPhotograph, px_per_mm: float):
        self._pair, self._px_per_mm = pair, px_per_mm

    def image(self, press: Press) -> np.ndarray:
        rest = self._pair.rest
        here, there = (press_px(p, rest.shape, self._px_per_mm) for p in (press, self._pair.press))
        difference = self._pair.image.astype(np.int16) - rest
        moved = shift(difference, round(here[0] - there[0]), round(here[1] - there[1]))
        return np.clip(rest + moved, 0, 255).astype(np.uint8)


def shift(image: np.ndarray, dx: int, dy: int) -> np.ndarray:
    """Moves an image (H, W, C) by whole pixels, right and down; zeros come in."""
    h, w = image.shape[:2]
    out = np.zeros_like(image)
    if abs(dx) < w and abs(dy) < h:
        out[max(dy, 0) : h + min(dy, 0), max(dx, 0) : w + min(dx, 0)] = image[
            max(-dy, 0) : h + min(-dy, 0), max(-dx, 0) : w + min(-dx, 0)
        ]
    return out
