"""Photographs of a gel under judgement; a sample is a photograph."""

import time
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from lerobot_pneutac.diagnosis.result import Outcome, Rival, Tested
from lerobot_pneutac.diagnosis.search import Found, Scored, Search
from lerobot_pneutac.diagnosis.steps import Steps
from lerobot_pneutac.diagnosis.verdict import MOST, Evidence, decide, too_few
from lerobot_pneutac.diagnosis.votes import AS_GOOD, chosen_in
from lerobot_pneutac.study import gel_maps
from lerobot_pneutac.study.base import EffectStudy
from lerobot_pneutac.study.gel_model import at_bound, for_twin, kept, seen_by
from lerobot_pneutac.study.gel_noise import away, noise
from lerobot_pneutac.study.gel_parts import (
    APART,
    FOLDS,
    NEEDED,
    deal_photographs,
    photograph_folds,
    sort_candidates,
)
from lerobot_pneutac.study.gel_press import contenders
from lerobot_pneutac.study.gel_space import FittedGel, GelSpace, Trial, mean_squares
from pneutac_datasets.recording.gel import GelRecording
from pneutac_datasets.recording.noise import NoiseFloor
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.registry import get_effect, of_sensor, sensor_effects
from pneutac_sim.finger.quantities import root_mean
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.pair import check_pair
from pneutac_sim.twin import Twin


class GelStudy(EffectStudy):
    """A gel and its optics.

    Args:
        twin: of a gel, or of a finger with one.
        recording: of a gel.
        seed: decides folds, the photographs of the report, and the bootstrap.

    Attributes:
        data: the photographs.
        space: fits sets of effects to them.

    Raises:
        InputError: there is no good calibration pair, or no photograph to judge by.
    """

    unit = "levels"
    more_data = (
        f"Press one ball at {NEEDED} places all over the window, to several depths; note where and how deep."
    )
    repeat = (
        "Press other shapes, such as an edge or a small cylinder: so far the light is known for these alone."
    )
    nothing_left = repeat

    def __init__(self, twin: Twin, recording: Recording, seed: int = 0):
        data = GelRecording.load(recording)
        for pair in data.presses:
            check_pair(pair.rest, pair.image, pair.press, data.px_per_mm)
        self.twin, self.recording, self.seed, self.data = twin, recording, seed, data
        self.findings = data.warnings
        self.own = tuple(of_sensor(twin.effects))
        self.candidates, self.untested = sort_candidates(data, self.own)
        self.parts = deal_photographs(recording, seed)
        self._stored = seen_by(GelModel.from_twin(twin), data)
        fold = photograph_folds(self.parts, seed)
        gel = replace(self._stored, effects=kept(self._stored.effects))
        self.space = GelSpace(data, gel, twin, self.parts.train, fold, self.own, self.candidates)
        how = "images away from contacts, less each image's own smooth drift of light"
        self.noise = NoiseFloor(noise(self.space.photographs, data.px_per_mm), None, self.unit, how, {})

    # ---------------------------------------------------------------- the verbs

    def refit(self, effects: Sequence[str], start: FittedGel | None, steps: Steps) -> FittedGel:
        """Light and these effects, fitted to all photographs that are not kept for the report."""
        model = self.space.fit(Trial(tuple(sorted(effects)), start and start.fit.gel))
        steps.done()
        return model

    def search(self, jobs: int, steps: Steps) -> Outcome:
        """Looks for optics effects that the twin lacks; in one process."""
        began, space = time.perf_counter(), self.space
        engine = Search(
            space,
            self.judge,
            space.fold,
            self.noise.floor,
            tell=lambda text: steps.expect(f"{text} {self.unit}", 0),
        )
        steps.expect("the twin as it is, and with each effect", 1 + len(self.candidates))
        space.steps = steps
        found = engine.find()
        base, final = found.base.model, found.final.model
        alone = {e: space.fit(space.plus(base, e)) for e in self.candidates}
        steps.expect("what each effect of the twin is good for", len(self.own))
        taken = {e: space.without(base, e) for e in self.own}
        votes = chosen_in(found, self.parts.unit, self.noise.floor, str)
        added = [e for e in _in_order_found(found) if e not in self.own]
        selected = sorted(added, key=lambda e: -found.without[e].value)
        evidence = self._evidence(base, final, selected, votes, alone)
        verdict = decide(evidence)
        if verdict == "unknown_effect" and self.explained(final) >= MOST:
            verdict = "insufficient_form"  # what the twin's own effects explain counts too
        return Outcome(
            before=base,
            after=final,
            ladder=self._ladder(base, added),
            selected=selected,
            tested=self._tested(base, alone, taken),
            rivals=self._rivals(found),
            evidence=evidence,
            verdict=verdict,
            twin=self.twin_of(final),
            seconds=time.perf_counter() - began,
            chosen_in={e: votes[e] for e in selected},
            contenders=contenders(found, self.judge, self.twin_of),
        )

    def _ladder(self, base: FittedGel, added: list[str]) -> list[tuple[str, FittedGel]]:
        out = [("as it is", base)]
        for name in added:
            out.append((f"+ {name}", self.space.fit(self.space.plus(out[-1][1], name))))
        return out

    def _tested(
        self, base: FittedGel, alone: dict[str, FittedGel], taken: dict[str, FittedGel]
    ) -> list[Tested]:
        """Each candidate alone, the best first; then the twin without each of its own effects."""
        tested = []
        for name, fit in alone.items():
            share, interval = self.reduction(base, fit)
            values = self.parameters(fit, name)
            tested.append(Tested(name, self.errors(fit), share, interval, values, "added to the twin"))
        tested.sort(key=lambda t: -t.reduction)
        return tested + [
            Tested(name, self.errors(fit), None, None, {}, "taken out of the twin")
            for name, fit in taken.items()
        ]

    def _rivals(self, found: Found) -> list[Rival]:
        """Models as good, as far as can be told, with another effect in the place of a found one."""
        out = []
        for before, taken, others in zip(found.path[:-1], found.path[1:], found.rivals, strict=True):
            new = set(taken.model.effects) - set(before.model.effects)
            if len(new) != 1 or not new <= set(found.final.model.effects):
                continue
            for other in others:
                instead = set(other.model.effects) - set(before.model.effects)
                if len(instead) == 1 and self._as_good(before, taken, other):
                    share = other.value / max(taken.value, 1e-30) - 1
                    out.append(Rival(*new, *instead, share, other.model, taken.model))
        return sorted(out, key=lambda r: r.difference)

    def _as_good(self, before: Scored, taken: Scored, other: Scored) -> bool:
        """Whether another model helps for sure, and the one that was taken does not surely help more."""
        more, low, _ = self.judge.drop(other.crossed, taken.crossed)
        room = max(before.value - self.noise.floor**2, 0.0)
        return self.judge.drop(before.crossed, other.crossed)[1] > 0 and (low <= 0 or more < AS_GOOD * room)

    def _evidence(
        self,
        base: FittedGel,
        final: FittedGel,
        selected: list[str],
        votes: dict[str, float],
        alone: dict[str, FittedGel],
    ) -> Evidence:
        """Errors of photographs that no fit saw, over a noise that counts drifts of light too."""
        floor = max(self.noise.floor, self._far(final))
        room = self.judge.value(base.squared) - self.noise.floor**2
        falls = {e: self.judge.drop(base.squared, fit.squared)[0] for e, fit in alone.items()}
        return Evidence(
            poor=bool(self.too_little()),
            before=self.errors(base)["heldout"] / floor,
            after=self.errors(final)["heldout"] / floor,
            selected=selected,
            removed=self.test.reduction(base.squared, final.squared, floor)[0] if selected else 0.0,
            at_bound=self.at_bound(final, selected),
            near_miss=[] if selected else [e for e, fall in falls.items() if fall > MOST * room > 0],
            agreed=votes[selected[0]] if selected else 1.0,
        )

    def explained(self, model: FittedGel) -> float:
        """Share of what a contact changes that a model predicts on test photographs."""
        rest = mean_squares(p.image.astype(float) - p.rest for p in self.space.photographs)
        return self.test.reduction(rest, model.squared, self.noise.floor)[0]

    def _far(self, model: FittedGel) -> float:
        """Error of a model away from contacts on test photographs, levels."""
        space, shown = self.space, np.flatnonzero(self.parts.test)
        differences = space.differences(model.gels)
        return away(
            [space.photographs[i] for i in shown], [differences[i] for i in shown], self.data.px_per_mm
        )

    # ---------------------------------------------------------------- what it tells

    def errors(self, model: FittedGel) -> dict[str, float]:
        """Also in the contact."""
        return super().errors(model) | {
            "train": root_mean(model.seen[self.parts.train]),
            "heldout_contact": root_mean(model.contact[self.parts.test]),
        }

    def refusal(self, effect: str) -> str:
        """Why an effect cannot be switched on."""
        why = next((u.reason for u in self.untested if u.name == effect), "")
        if why:
            return f"'{effect}' {why}."
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

    def too_little(self) -> str:
        """How many photographs there are and how many it takes."""
        images, judged = len(self.data.samples), self.test.units
        if not too_few(images, judged, NEEDED):
            return ""
        return (
            f"This recording cannot tell: it has {images} images, of which {judged} "
            f"can be judged by; it takes {NEEDED}, the calibration pair's among them."
        )

    def how_tested(self, outcome: Outcome) -> str:
        """What was fitted to what."""
        parts, stored = self.parts, self._stored_error
        n, tested = len(parts.train), parts.test.sum()
        as_stored = "" if stored is None else f"As stored it is {stored:.3g} levels off. "
        if parts.has_test:
            return (
                f"{as_stored}All that follows is re-fitted to {parts.train.sum()} of the {n} images, chosen "
                f"by {FOLDS}-fold cross-validation among them, and judged on the other {tested}."
            )
        return (
            f"{as_stored}With {n} images, fewer than {APART}, none are kept for the report alone: effects "
            f"are chosen and judged on {tested}, each predicted by a fit without its fifth of them, so the "
            "errors are a little optimistic."
        )

    def as_written(self, parameters: dict[str, dict]) -> dict[str, float]:
        """Values alone, as there is no interval."""
        return {k: p["value"] for k, p in parameters.items()}

    @cached_property
    def _stored_error(self) -> float | None:
        """Error of the twin's gel as it is stored, on test photographs; None where it has no light."""
        if not self._stored.light.any():
            return None
        differences = self.space.differences([self._stored] * len(self.data.samples))
        return float(np.sqrt(self.test.value(mean_squares(differences))))

    def details(self, outcome: Outcome) -> dict:
        """What only a gel's `result.json` has."""
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
        return gel_maps.pictures([self.data.samples[i] for i in shown], [[d[i] for i in shown] for d in each])


def _in_order_found(found: Found) -> list[str]:
    """Effects of the final model in the order in which they came."""
    came = [e for step in found.path for e in step.model.effects]
    return [e for e in dict.fromkeys(came) if e in found.final.model.effects]
