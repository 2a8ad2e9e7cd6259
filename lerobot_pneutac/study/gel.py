"""Photographs of a gel under judgement; a sample is a photograph."""

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lerobot_pneutac.diagnosis.fits import FittedModel
from lerobot_pneutac.diagnosis.result import Outcome, Tested
from lerobot_pneutac.diagnosis.rivals import find_rivals
from lerobot_pneutac.diagnosis.selection import Selection, select
from lerobot_pneutac.diagnosis.steps import Steps
from lerobot_pneutac.diagnosis.verdict import FEW_UNITS, MOST, Evidence, decide
from lerobot_pneutac.study import gel_maps
from lerobot_pneutac.study.base import EffectStudy
from lerobot_pneutac.study.gel_model import at_bound, for_twin, seen_by
from lerobot_pneutac.study.gel_parts import FEW_TRAINED, NEEDED, deal_photographs
from pneutac_datasets.recording.gel import GelRecording
from pneutac_datasets.recording.noise import NoiseFloor
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.registry import get_effect, of_sensor, sensor_effects
from pneutac_sim.gel import optics
from pneutac_sim.gel.fit import GelFit, fit_photographs
from pneutac_sim.gel.metrics import CONTACT_DISC
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.pair import check_pair
from pneutac_sim.gel.photograph import Predictor, session_light
from pneutac_sim.twin import Twin

NOISE_LIMIT = 1.25  # final error over noise: on generated images of the model's own form it stays below


@dataclass(kw_only=True)
class FittedGel(FittedModel):
    """Light and effects fitted to the training photographs; `residual` (n, 1) is each photograph's own error.

    Attributes:
        fit: what was fitted.
        contact: (n,) mean square error in the contact region, levels^2.
        differences: n of predicted - photographed, int16 (H, W, 3).
        patches: independent residuals in a photograph.
    """

    fit: GelFit
    contact: np.ndarray
    differences: list[np.ndarray]
    patches: float

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
            twin=self.twin,
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

    def as_written(self, parameters: dict[str, dict]) -> dict[str, float]:
        """Values alone, as there is no interval."""
        return {k: p["value"] for k, p in parameters.items()}

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
        tested = [s for s, t in zip(self.data.samples, self.parts.test, strict=True) if t]
        differences = [[d for d, t in zip(m.differences, self.parts.test, strict=True) if t] for m in models]
        return gel_maps.pictures(tested, differences)


def _mean_squares(images: Iterable[np.ndarray]) -> np.ndarray:
    return np.array([np.mean(np.square(np.asarray(image, np.float64))) for image in images])
