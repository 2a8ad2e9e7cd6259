"""Photographs of a gel under judgement; a sample is a photograph.

As one pair of images cannot tell a drift or a shift, some of the photographs beside the calibration pair
train too; of the others one half decides which effects are kept and the other half is looked at by the
report alone.
"""

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import map_coordinates

from lerobot_pneutac.diagnosis.fits import FittedModel
from lerobot_pneutac.diagnosis.parts import Parts
from lerobot_pneutac.diagnosis.result import Outcome, Tested
from lerobot_pneutac.diagnosis.rivals import find_rivals
from lerobot_pneutac.diagnosis.selection import Selection, select
from lerobot_pneutac.diagnosis.steps import Steps
from lerobot_pneutac.diagnosis.verdict import FEW_UNITS, MOST, Evidence, decide
from lerobot_pneutac.study.base import EffectStudy
from pneutac_datasets.recording import blocks
from pneutac_datasets.recording.gel import GelRecording
from pneutac_datasets.recording.noise import NoiseFloor
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.registry import get_effect, of_sensor, sensor_effects
from pneutac_sim.errors import InputError
from pneutac_sim.features import IMAGE_SHAPE
from pneutac_sim.gel import optics
from pneutac_sim.gel.fit import GelFit, fit_photographs
from pneutac_sim.gel.metrics import CONTACT_DISC
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.pair import check_pair
from pneutac_sim.gel.photograph import Predictor, PressPhotograph, session_light
from pneutac_sim.twin import Twin

MOST_TRAINED = 6  # photographs that train; more cost time and pin the light no better
FEW_TRAINED = 2  # below this no drift and no shift can be told
NEEDED = FEW_TRAINED + 2 * FEW_UNITS  # photographs, the calibration pair's among them
NOISE_LIMIT = 1.25  # final error over noise: on generated images of the model's own form it stays below
MAP_GAIN = 4.0  # maps are shown this many times brighter
MAP_PX, MAP_RADII = 121, 3.0  # of the map around a contact


@dataclass
class FittedGel(FittedModel):
    """Light and effects fitted to the training photographs; `residual` (n, 1) is each photograph's own error.

    Attributes:
        fit: what was fitted.
        contact: (n,) mean square error in the contact region, levels^2.
        differences: n of predicted - photographed, int16 (H, W, 3).
        patches: independent residuals in a photograph.
    """

    fit: GelFit | None = None
    contact: np.ndarray | None = None
    differences: list[np.ndarray] | None = None
    patches: float = 1.0

    def independent(self, mask: np.ndarray, least: int = 10) -> float:
        """Light varies over a contact and no faster: each patch of a photograph is worth a sample."""
        return float(mask.sum()) * self.patches


class GelStudy(EffectStudy):
    """A gel and its optics.

    Args:
        twin: of a gel, or of a finger with one.
        recording: of a gel.
        seed: decides which photographs train, and the bootstrap.

    Attributes:
        data: the photographs.

    Raises:
        InputError: there is no good calibration pair, or no photograph to judge by.
    """

    unit = "levels"
    unknown_where = "is in these images"
    more_data = (
        f"Press one ball at {NEEDED} places all over the window, to several depths; note where and how deep."
    )
    repeat = (
        "Press other shapes, such as an edge or a small cylinder: so far the light is known for these alone."
    )
    nothing_left = repeat

    def __init__(self, twin: Twin, recording: Recording, seed: int = 0):
        data = GelRecording.load(recording)
        pair = data.calibration
        check_pair(pair.rest, pair.image, pair.press, data.px_per_mm)
        self.twin, self.recording, self.seed, self.data = twin, recording, seed, data
        self.findings = data.warnings
        self.own = tuple(of_sensor(twin.effects))
        self.candidates, self.untested = [e for e in sensor_effects() if e not in self.own], []
        self.parts = deal_photographs(recording, seed)
        self._stored = seen_by(GelModel.from_twin(twin), data)
        self._gel = replace(self._stored, effects={})
        self._photographs = [s.photograph for s in data.samples]
        self._regions = [p.near(data.px_per_mm, CONTACT_DISC) for p in self._photographs]
        self._known: dict[tuple[str, ...], FittedGel] = {}
        self._steps = Steps()
        how = "images away from contacts, less each image's own smooth drift of light"
        self.noise = NoiseFloor(self._noise(), None, self.unit, how, {})

    # ---------------------------------------------------------------- fits

    def fit_all(self, effects: Iterable[tuple[str, ...]], start: FittedGel | None = None) -> list[FittedGel]:
        """One fit for each set of effects, in order."""
        return [self._fit(tuple(sorted(e)), start) for e in effects]

    def promising(self, fit: FittedGel, candidates: list[str], least: float) -> list[str]:
        """All of them: there are few."""
        return candidates

    def refit(self, effects: Sequence[str], start: FittedGel | None, steps: Steps) -> FittedGel:
        """Light and these effects, fitted to the training photographs."""
        self._steps = steps
        return self._fit(tuple(sorted(effects)), start)

    def _fit(self, effects: tuple[str, ...], start: FittedGel | None) -> FittedGel:
        if effects in self._known:
            return self._known[effects]
        chosen = [p for p, t in zip(self._photographs, self.parts.train, strict=True) if t]
        fit = fit_photographs(self._gel, chosen, effects, near=start and start.fit.gel)
        differences = self._differences(fit.gel)
        regions = zip(differences, self._regions, strict=True)
        height, width = self.data.rest.shape[:2]
        radius_px = float(np.median([s.radius_px for s in self.data.samples]))
        self._known[effects] = found = FittedGel(
            effects=effects,
            residual=np.sqrt(_mean_squares(differences))[:, None],
            count=sum(len(get_effect(e).parameters) for e in effects),
            fit=fit,
            contact=_mean_squares(d[m] for d, m in regions),
            differences=differences,
            patches=max(1.0, height * width / (np.pi * radius_px**2)),
        )
        self._steps.done()
        return found

    def _differences(self, gel: GelModel) -> list[np.ndarray]:
        """Predicted - photographed of every photograph, int16 (H, W, 3)."""
        predictor = Predictor(gel, self.data.calibration.photograph)
        return [
            predictor.image(p.press, p.rest, p.clock).astype(np.int16) - p.image for p in self._photographs
        ]

    # ---------------------------------------------------------------- search

    def search(self, jobs: int, steps: Steps) -> Outcome:
        """Looks for optics effects that the twin lacks; in one process, as a fit takes a second."""
        began, self._steps = time.perf_counter(), steps
        floor = self.noise.value
        found = select(self, self.own, self.candidates, self.parts, floor, self.seed, steps)
        rivals, correlated = find_rivals(self, found, self.candidates, self.parts, floor, self.seed, steps)
        steps.expect("what each effect of the twin is good for", len(self.own))
        taken = {e: self._fit(tuple(x for x in found.base.effects if x != e), found.base) for e in self.own}
        tested = [self._tried(name, fit, found.base) for name, fit in found.first.items()]
        tested.sort(key=lambda t: -t.reduction)
        tested += [
            Tested(name, self.errors(fit), None, None, {}, "taken out of the twin")
            for name, fit in taken.items()
        ]
        evidence = self._evidence(found)
        verdict = decide(evidence)
        if verdict == "unknown_effect" and self.explained(found.final) >= MOST:
            verdict = "insufficient_form"  # what the twin's own effects explain counts too
        labels = ["as it is", *(f"+ {e}" for e in found.added)]
        return Outcome(
            before=found.base,
            after=found.final,
            ladder=list(zip(labels, found.path, strict=True)),
            selected=found.selected,
            tested=tested,
            rivals=rivals,
            correlated=correlated,
            evidence=evidence,
            verdict=verdict,
            twin=self.twin_of(found.final),
            seconds=time.perf_counter() - began,
        )

    def _tried(self, name: str, fit: FittedGel, base: FittedGel) -> Tested:
        share, interval = self.reduction(base, fit)
        return Tested(
            name, self.errors(fit), share, interval, self.parameters(fit, name), "added to the twin"
        )

    def _evidence(self, found: Selection) -> Evidence:
        """What the verdict rests on: errors of test photographs; the noise counts drifts of light too."""
        base, final = found.base, found.final
        floor = max(self.noise.value, self._far(final))
        return Evidence(
            samples=int(self.parts.train.sum()),
            units=min(self.judge.units, self.test.units) if self.parts.has_test else 0,
            moves=True,
            before=self.errors(base)["heldout"] / floor,
            after=self.errors(final)["heldout"] / floor,
            limit=NOISE_LIMIT,
            selected=found.selected,
            removed=self.test.reduction(base.squared, final.squared, floor)[0] if found.selected else 0.0,
            at_bound=self.at_bound(final, found.selected),
            near_miss=[] if found.selected else found.near_miss,
            few_samples=FEW_TRAINED,
        )

    def explained(self, model: FittedGel) -> float:
        """Share of what a contact changes that a model predicts on test photographs."""
        rest = _mean_squares(p.image.astype(float) - p.rest for p in self._photographs)
        return self.test.reduction(rest, model.squared, self.noise.value)[0]

    def _far(self, model: FittedGel) -> float:
        """Error of a model away from contacts on test photographs, where no gel moves, levels."""
        out = []
        for p, d, tested in zip(self._photographs, model.differences, self.parts.test, strict=True):
            far = ~p.near(self.data.px_per_mm)
            if tested and far.mean() > 0.1:
                out.append(np.mean(np.square(d[far].astype(float))))
        return float(np.sqrt(np.mean(out))) if out else 0.0

    def _noise(self) -> float:
        """What is left away from contacts once each photograph's own drift of light is taken off, levels."""
        out = []
        for p in self._photographs:
            far = ~p.near(self.data.px_per_mm)
            if far.mean() > 0.1:
                drift = optics.upsample(session_light(p, self.data.px_per_mm), *p.rest.shape[:2])
                out.append(np.mean(np.square((p.image.astype(float) - p.rest - drift)[far])))
        return float(np.sqrt(np.mean(out))) if out else 0.0

    # ---------------------------------------------------------------- what it tells

    def errors(self, model: FittedGel) -> dict[str, float]:
        """Also in the contact."""
        contact = float(np.sqrt(model.contact[self.parts.test].mean()))
        return super().errors(model) | {"heldout_contact": contact}

    def refusal(self, effect: str) -> str:
        """Why an effect cannot be switched on."""
        if effect not in sensor_effects():
            return f"'{effect}' does not act on a gel's images; give one of {', '.join(sensor_effects())}."
        return self.already_on(effect)

    def twin_of(self, model: FittedGel) -> Twin:
        """The twin with the fitted gel."""
        twin = self.twin.copy()
        for_twin(model.fit.gel, twin).into_twin(twin)
        return twin

    def parameters(self, model: FittedGel, effect: str) -> dict[str, dict]:
        """Value and unit; a fit of light gives no intervals."""
        units = {p.name: p.unit for p in get_effect(effect).parameters}
        values = model.fit.gel.effects[effect]
        return {k: {"value": v, "ci95": None, "unit": units[k]} for k, v in values.items()}

    def at_bound(self, model: FittedGel, effects: Sequence[str]) -> list[str]:
        """Parameters at a bound."""
        return at_bound(model.fit.gel, effects)

    def too_little(self, evidence: Evidence) -> str:
        """How many photographs there are and how many it takes."""
        return (
            f"This recording cannot tell: it has {len(self.data.samples)} images, of which "
            f"{evidence.samples} were fitted and {evidence.units} are left to judge by; it takes {NEEDED}, "
            f"so that {FEW_UNITS} choose the effects and {FEW_UNITS} others test them."
        )

    def how_tested(self, outcome: Outcome) -> str:
        """What was fitted to what."""
        parts = self.parts
        stored = self.details(outcome)["stored"]
        as_stored = "" if stored is None else f"As stored it is {stored:.3g} levels off. "
        chosen = f", effects are chosen on {parts.validation.sum()}" if parts.has_test else ""
        return (
            f"{as_stored}All that follows is re-fitted to {parts.train.sum()} of the {len(parts.train)} "
            f"images{chosen} and judged on the other {parts.test.sum()}."
        )

    def caveats(self, outcome: Outcome) -> list[str]:
        """What was fitted to what."""
        return [self.how_tested(outcome)]

    def details(self, outcome: Outcome) -> dict:
        """What only a gel's `result.json` has."""
        stored, fit = None, outcome.after.fit
        if self._stored.light.any():
            squared = _mean_squares(self._differences(self._stored))
            stored = float(np.sqrt(self.test.value(squared)))
        names = [s.name for s in self.data.samples]
        return {
            "stored": stored,
            "make": fit.make,
            "orientation": str(fit.orientation) if fit.make else "",
            "trained_on": [n for n, t in zip(names, self.parts.train, strict=True) if t],
            "tested_on": [n for n, t in zip(names, self.parts.test, strict=True) if t],
        }

    def pictures(self, outcome: Outcome) -> list[tuple[np.ndarray, str]]:
        """Where in the image the twin fails, left as it is, right with all effects found."""
        models = [outcome.before, outcome.after] if outcome.selected else [outcome.before]
        maps = [self.maps(m) for m in models]
        planes = np.concatenate([np.clip(MAP_GAIN * plane, 0, 255) for plane, _ in maps], 1)
        contacts = np.concatenate([np.clip(128 + MAP_GAIN * c, 0, 255) for _, c in maps], 1)
        return [
            (
                planes.astype(np.uint8),
                f"Root mean square error over the test images, {MAP_GAIN:g} times brighter; left as it is, "
                "right with all effects found.",
            ),
            (
                contacts.astype(np.uint8).repeat(2, 0).repeat(2, 1),
                "Mean of rendered less photographed around the contact, three contact radii each way; grey "
                "is none.",
            ),
        ]

    def maps(self, model: FittedGel) -> tuple[np.ndarray, np.ndarray]:
        """Where a model fails on test photographs, levels.

        Returns:
            Root mean square in the image plane (H, W, 3); and around the contact (121, 121, 3), from -3 to 3
            contact radii, as a signed mean.
        """
        chosen = np.flatnonzero(self.parts.test)
        plane = np.sqrt(np.mean([np.square(model.differences[i].astype(float)) for i in chosen], axis=0))
        t = np.linspace(-MAP_RADII, MAP_RADII, MAP_PX)
        x, y = np.meshgrid(t, t)
        total, count = np.zeros((MAP_PX, MAP_PX, 3)), np.zeros((MAP_PX, MAP_PX, 1))
        for i in chosen:
            s, d = self.data.samples[i], model.differences[i].astype(float)
            at = [s.y_px - 0.5 + y * s.radius_px, s.x_px - 0.5 + x * s.radius_px]
            inside = (at[0] >= 0) & (at[0] <= d.shape[0] - 1) & (at[1] >= 0) & (at[1] <= d.shape[1] - 1)
            shown = np.stack([map_coordinates(d[..., k], at, order=1) for k in range(3)], -1)
            total += shown * inside[..., None]
            count += inside[..., None]
        return plane, total / np.maximum(count, 1)


def deal_photographs(recording: Recording, seed: int) -> Parts:
    """Photographs for training, validation and test; the last two are one where there are few.

    Raises:
        InputError: there is no photograph beside the calibration pair.
    """
    n = len(recording)
    roles = recording.samples["role"].astype(str) if recording.has("role") else np.full(n, "")
    train = np.asarray(roles == "calibration")
    others = np.flatnonzero(~train)
    if not len(others):
        raise InputError("The recording has no image beside the calibration pair, so nothing can be judged.")
    spare = min(MOST_TRAINED - int(train.sum()), len(others) - 2 * FEW_UNITS)
    if len(others) < 2 * FEW_UNITS:  # too few for a verdict; the fits shall be of use all the same
        spare = min(spare + FEW_UNITS, len(others) // 2)
    if spare > 0:
        train[np.random.default_rng([seed, 5]).permutation(others)[:spare]] = True
    rest = np.flatnonzero(~train)
    validation, test = ~train, ~train
    if len(rest) >= 2 * FEW_UNITS:
        samples = recording.samples.iloc[rest]
        half = blocks.assign(samples, np.arange(len(rest)), seed, (0.5, 0.5))
        validation, test = (np.isin(np.arange(n), rest[half == i]) for i in range(2))
    stratum = np.unique(np.asarray(roles), return_inverse=True)[1]
    return Parts(train, validation, test, np.arange(n), stratum)


def _mean_squares(images: Iterable[np.ndarray]) -> np.ndarray:
    return np.array([np.mean(np.square(np.asarray(image, np.float64))) for image in images])


def for_twin(gel: GelModel, twin: Twin) -> GelModel:
    """The gel at the size in which the twin keeps it: 240 x 320, other proportions for a lone gel only."""
    h, w = gel.rest_image.shape[:2]
    if twin.device == "gel" and abs(w / h / (IMAGE_SHAPE[1] / IMAGE_SHAPE[0]) - 1) > 0.02:
        return gel
    return gel.resized(*IMAGE_SHAPE[:2])


def predict(gel: GelModel, data: GelRecording) -> list[np.ndarray]:
    """Predicted image of every sample; the calibration pair tells how the light drifts."""
    pair: PressPhotograph | None = next((s.photograph for s in data.samples if s.role == "calibration"), None)
    predictor = Predictor(gel, pair)
    return [predictor.image(s.press, s.rest, s.clock) for s in data.samples]


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
        < 1e-3 * (p.upper - p.lower)
    ]
