"""Demonstrations under judgement: which physics a twin lacks to explain what arm, gauge and touch did.

A sample is a frame; whole episodes are learnt from or held out. Errors are those of `demonstration_model`.
"""

import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cached_property, partial

import numpy as np

from lerobot_pneutac.diagnosis.black_box import share_left
from lerobot_pneutac.diagnosis.bootstrap import Resampler
from lerobot_pneutac.diagnosis.model import FittedModel
from lerobot_pneutac.diagnosis.parts import Parts
from lerobot_pneutac.diagnosis.result import Outcome, Tested
from lerobot_pneutac.diagnosis.search import Found, Search, Trial
from lerobot_pneutac.diagnosis.steps import Steps
from lerobot_pneutac.diagnosis.verdict import Evidence, decide
from lerobot_pneutac.diagnosis.votes import chosen_in, rivals
from lerobot_pneutac.study.demonstration_data import command_signals, episode_data
from lerobot_pneutac.study.demonstration_model import (
    AIR,
    LATE,
    TOUCH,
    DemonstrationModel,
    Fitter,
    Form,
)
from lerobot_pneutac.study.demonstration_noise import frame_noise
from lerobot_pneutac.study.demonstration_space import DemonstrationSpace
from lerobot_pneutac.study.demonstration_strength import COMPLIANCE, Strength
from lerobot_pneutac.study.demonstration_words import (
    OF_AIR,
    OF_BODY,
    UNIT,
    DemonstrationWords,
    bends,
    of_air,
    stopped,
)
from pneutac_datasets.demonstrations.replay.dragging import Dragging
from pneutac_datasets.demonstrations.replay.imprint import brightness, rest_image
from pneutac_datasets.demonstrations.replay.reading import Demonstrations
from pneutac_datasets.recording.noise import NoiseFloor
from pneutac_sim.effects.laws import family
from pneutac_sim.effects.registry import of_body
from pneutac_sim.finger.quantities import rms
from pneutac_sim.progress import Progress, no_progress
from pneutac_sim.twin import Twin

HELD_OUT = 0.3  # share of the episodes
# Least fall of the mean square error that counts: of what the twin left of the demonstrations that it was
# last fitted to, by which others of the same finger may differ; where it was to none, of what is left.
WORTH, WORTH_OF_LEFT = 0.3, 0.1


class DemonstrationStudy(DemonstrationWords):
    """Episodes of one task.

    Args:
        twin: of the finger.
        recording: the episodes.
        seed: decides which are held out, and every bootstrap.
        adding: the effects that are to be tried; empty where all are.
        progress: is told how many episodes are replayed.

    Attributes:
        owner: (N,) which episode each frame is of.
        remainder: the most, by its 95 % interval, that the twin left of the demonstrations that it was last
            fitted to; None where it was to none.
        known: how strong the imprints were that the twin was last fitted to; None where they were none of
            this task.
    """

    def __init__(
        self,
        twin: Twin,
        recording: Demonstrations,
        seed: int = 0,
        adding: Sequence[str] = (),
        progress: Progress = no_progress,
    ):
        self.twin, self.recording, self.seed = twin, recording, seed
        self.own = tuple(of_body(twin.effects))
        tried = dict.fromkeys((LATE, *OF_AIR, *OF_BODY, *(e for e in self.own if bends(e))))
        self.candidates = [e for e in tried if not adding or e in adding]
        self._last = ([{}] + [h for h in twin.history if h.get("unit") == UNIT])[-1]
        self.known = Strength.known(self._last, recording.task)
        self._strengths: dict[int, Strength] = {}  # by the identity of a model's twin
        self.charged, self.light = False, self.known and self.known.light
        self._progress = progress
        episodes = recording.episodes
        self.owner = np.repeat(np.arange(len(episodes)), list(map(len, episodes)))
        order = np.random.default_rng([seed, 5]).permutation(len(episodes))
        away = order[: min(max(1, round(HELD_OUT * len(order))), len(order) - 1)]
        test = np.isin(self.owner, away)
        self.parts = Parts(~test, ~test, test, self.owner, np.zeros(len(episodes), int))
        self.remainder = self._last.get("heldout_ci95", [None, None])[1]
        self.findings = [*recording.warnings]
        if dragging := Dragging.of(recording.episodes):
            self.findings.append(dragging.sentence(Dragging.known(twin.history, recording.task)))

    @cached_property
    def fitter(self) -> Fitter:
        """Fits models to the episodes that are learnt from; they are replayed when it is first asked for."""
        episodes = episode_data(self.twin, self.recording, self._progress, self.light)
        return Fitter(self.twin, episodes, self.parts.train)

    @cached_property
    def noise(self) -> NoiseFloor:  # pyright: ignore[reportIncompatibleVariableOverride]
        """What the frames' own noise adds to the errors."""
        return frame_noise(self.fitter, self.remainder)

    @cached_property
    def _bare_air(self) -> DemonstrationModel:
        return self.fitter.base(AIR)

    @cached_property
    def _bare_touch(self) -> DemonstrationModel:
        return self.fitter.base(TOUCH)

    def world_of(self, twin: Twin) -> Fitter:
        """Fits models to the episodes that are learnt from, as replayed in the world of a twin."""
        if twin is self.twin:
            return self.fitter
        episodes = episode_data(twin, self.recording, light=self.light)
        return Fitter(twin, episodes, self.parts.train)

    # ---------------------------------------------------------------- models

    def fitted(self, air: DemonstrationModel, touch: DemonstrationModel, fitter: Fitter) -> FittedModel:
        """A model on all frames: its air's, and its body's on replays with that air."""
        fold = self.owner[self.parts.train]
        twin = self.fitter.twin_with(air, air.intervals(fold))
        replayed = Fitter(twin, fitter.episodes, fitter.rows) if fitter.twin is not twin else fitter
        found = (*air.form.effects, *touch.form.effects)
        twin = replayed.twin_with(touch, touch.intervals(fold))
        return FittedModel(
            effects=tuple(dict.fromkeys((*self.own, *found))),
            residual=self._residual(fitter, touch, twin),
            count=len(air.unit) + len(touch.unit),
            twin=twin,
            at_bound=[n for n in (*air.at_bound, *touch.at_bound) if stopped(n)],
        )

    def _residual(self, fitter: Fitter, touch: DemonstrationModel, twin: Twin) -> np.ndarray:
        """(N, 5) of the model of a twin; where compliance is judged, touch is charged with its strength."""
        residual, curves = fitter.predict(touch.form, touch.values)
        growth = self.known.growth if self.known else touch.values["growth"]
        self._strengths[id(twin)] = fitter.strength(touch, growth)
        if self.charged and (apart := self.stronger_by(twin)):
            more = curves["imprint"] * (1 - np.exp(-apart)) / fitter.slope * fitter.mm_per_rad
            contact = np.concatenate([e.contact for e in fitter.episodes])
            residual[:, TOUCH] += np.where(contact, more, 0.0)[:, None]
        return residual

    def stronger_by(self, twin: Twin) -> float:
        """Logarithm of how much stronger imprints are than was known, of a twin whose residual is known.

        0 where that is no more than those of one finger differ by.
        """
        return self._strengths[id(twin)].apart(self.known) if self.known else 0.0

    def residual(self, twin: Twin) -> np.ndarray:
        """(N, 5) measured minus predicted by another twin of this finger."""
        fitter = self.world_of(twin)
        return self._residual(fitter, fitter.base(TOUCH), twin)

    def refit(self, effects: Sequence[str], start: FittedModel | None, steps: Steps) -> FittedModel:
        """The twin with these effects fitted, its own where they are named again."""
        fold, asked = self.owner[self.parts.train], effects[len(self.own) :]
        if start is None:
            steps.done()
            self._errors = [self._bare_air.crossed(fold) + self._bare_touch.crossed(fold)]
            return self._bare
        air = self._with(self.fitter, [e for e in asked if of_air(e)], AIR, self._bare_air)
        fitter = self.world_of(self.fitter.twin_with(air, {})) if air.form.effects else self.fitter
        touch = self._with(fitter, [e for e in asked if not of_air(e)], TOUCH, fitter.base(TOUCH))
        self._errors.append(air.crossed(fold) + touch.crossed(fold))
        steps.done()
        return self.fitted(air, touch, fitter)

    @cached_property
    def _bare(self) -> FittedModel:
        """The twin as it is."""
        return self.fitted(self._bare_air, self._bare_touch, self.fitter)

    @staticmethod
    def _with(
        fitter: Fitter, effects: list[str], columns: slice, base: DemonstrationModel
    ) -> DemonstrationModel:
        if not effects:
            return base
        values = dict(base.values)
        for e in effects:
            values |= fitter.start(e)
        return fitter.fit(Trial(Form(tuple(effects)), values), columns, 60)

    def errors(self, model: FittedModel) -> dict[str, float]:
        """Root mean square errors, beside the usual ones of arm and gauge and of touch, of all episodes."""
        parts = {"arm_and_gauge": AIR, "touch": TOUCH}
        return super().errors(model) | {k: rms(model.residual[:, c]) for k, c in parts.items()}

    def noted(self, model: FittedModel) -> dict:
        """How strong imprints are, which later demonstrations are held against."""
        strength = self._strengths.get(id(model.twin))
        if strength is None:
            return {}
        own = np.mean([brightness(rest_image(e)) for e in self.recording.episodes], 0)
        return {"imprint": strength.kept(self.recording.task, own if self.light is None else self.light)}

    def judges(self, selected: Sequence[str]) -> None:
        """Errors are told with the strength of imprints where that was among what was found."""
        self.charged = COMPLIANCE in selected

    def fall(self, before: FittedModel, after: FittedModel) -> tuple[float, float, float]:
        """Fall of the mean square error on episodes that no fit saw."""
        return self._learnt().drop(*self._errors)

    def _learnt(self) -> Resampler:
        owner = self.owner[self.parts.train]
        return Resampler(np.ones(len(owner), bool), owner, self.parts.stratum, self.seed)

    # ---------------------------------------------------------------- the verbs

    def search(self, jobs: int, steps: Steps) -> Outcome:
        """Looks for what the twin lacks: in its air by arm and gauge, then in its body by touch."""
        began = time.perf_counter()
        steps.expect("fitting arm and gauge", 2)
        air = self._stage(jobs, steps, self.fitter, self._bare_air, AIR)
        tried = air
        if not self._worth(air, self._bare_air, self.fitter, AIR):
            air = Found(air.base, air.path[:1], air.base)
        steps.done()
        fitter = self.fitter
        if air.final.model.form.effects:
            steps.expect("replaying with that", 0)
            fitter = self.world_of(self.fitter.twin_with(air.final.model, {}))
        base = fitter.base(TOUCH)
        steps.expect("fitting touch", 0)
        touch = self._stage(jobs, steps, fitter, base, TOUCH)
        steps.done()
        tested = self._tested(tried, None) + self._tested(touch, (air.final.model, fitter))
        if not self._worth(touch, base, fitter, TOUCH):
            touch = Found(touch.base, touch.path[:1], touch.base)
        return self._outcome(air, touch, fitter, tested, began)

    def _stage(
        self, jobs: int, steps: Steps, fitter: Fitter, base: DemonstrationModel, columns: slice
    ) -> Found:
        candidates = [e for e in self.candidates if of_air(e) == (columns == AIR)]
        candidates = [] if self.too_little() else candidates
        noise = self.noise.by_column
        floor = np.hypot(noise["flange"], noise["pressure.pos"]) if columns == AIR else noise["imprint"]
        fold = self.owner[self.parts.train]
        with ThreadPoolExecutor(jobs) as pool:
            space = DemonstrationSpace(fitter, base, candidates, columns)
            tell = lambda text: steps.expect(text, 0)  # noqa: E731
            search = Search(space, self._learnt(), fold, float(floor), pool.map, tell)
            found = search.find()
            found.final = space.pruned(found.final, search.score, partial(self._least, columns))
            return found

    def _outcome(
        self, air: Found, touch: Found, fitter: Fitter, tested: list[Tested], began: float
    ) -> Outcome:
        before = self._bare
        models, base = [air.final.model, touch.final.model], touch.base.model
        after = self.fitted(models[0], models[1], fitter)
        if not self._lower(before, after):
            models, after, fitter = [self._bare_air, self._bare_touch], before, self.fitter
        selected = [e for m in models for e in m.form.effects]
        ladder = [("as it is", before)]
        if models[0].form.effects:
            ladder.append((" + ".join(models[0].form.effects), self.fitted(models[0], base, fitter)))
        if models[1].form.effects:
            ladder.append((" + ".join(selected), after))
        pressing = self._pressing(after, models[1], fitter, selected)
        if pressing is not None:
            selected, after = [*selected, COMPLIANCE], pressing
            self.judges(selected)
            before = self.fitted(self._bare_air, self._bare_touch, self.fitter)
            ladder = [("as it is", before), *ladder[1:], (" + ".join(selected), after)]
        votes = {}
        for found in (air, touch):
            votes |= chosen_in(found, self.owner[self.parts.train], self.noise.value, family)
        chosen = {t: votes.get(t, 1.0) for t in selected}
        evidence = self._evidence(before, after, selected, chosen)
        return Outcome(
            before=before,
            after=after,
            ladder=ladder,
            selected=selected,
            tested=tested,
            rivals=rivals(
                touch,
                self.noise.by_column["imprint"],
                selected,
                family,
                lambda s: self.fitted(air.final.model, s.model, fitter),
            ),
            evidence=evidence,
            verdict=decide(evidence),
            twin=after.twin,
            seconds=time.perf_counter() - began,
            chosen_in=chosen,
        )

    def _pressing(
        self, found: FittedModel, touch: DemonstrationModel, fitter: Fitter, selected: Sequence[str]
    ) -> FittedModel | None:
        """The same with a finger that presses as hard as its imprints are strong; None where it does.

        Imprints that are stronger where a slow valve or more of the body was found may tell of that.
        """
        apart, strength = self.stronger_by(found.twin), self._strengths[id(found.twin)]
        if self.known is None or not apart or (apart > 0 and set(selected) - {LATE}):
            return None
        twin = strength.pressing(found.twin, self.known)
        self._strengths[id(twin)] = strength
        uncharged = fitter.predict(touch.form, touch.values)[0]
        return replace(found, twin=twin, residual=uncharged, count=found.count + 1)

    def _lower(self, before: FittedModel, after: FittedModel) -> bool:
        return self.test.value(after.squared) < self.test.value(before.squared)

    def _worth(self, found: Found, base: DemonstrationModel, fitter: Fitter, columns: slice) -> bool:
        """Whether what a stage found lowers the error of the held-out episodes too, by a good part."""
        squared = (
            (fitter.predict(m.form, m.values)[0][:, columns] ** 2).sum(1) for m in (base, found.final.model)
        )
        before, after = map(self.test.value, squared)
        return bool(found.final.model.form.effects) and before - after > WORTH_OF_LEFT * after

    def _least(self, columns: slice, left: float) -> float:
        """Fall of the mean square error below which a term does not count, where `left` is left with it."""
        last = self._last.get("touch" if columns == TOUCH else "arm_and_gauge")
        return WORTH * last**2 if last is not None else WORTH_OF_LEFT * left

    def _evidence(self, before, after, selected, chosen) -> Evidence:
        floor = max(self.noise.value, 1e-12)
        worst, left = self.test.value(before.squared), self.test.value(after.squared)
        room = worst - floor**2
        removed = 1 - max(left - floor**2, 0.0) / room if selected and room > 0 else float(bool(selected))
        signals, train, test = command_signals(self.fitter.episodes), self.parts.train, self.parts.test
        return Evidence(
            poor=bool(self.too_little()),
            before=float(np.sqrt(worst)) / floor,
            after=float(np.sqrt(left)) / floor,
            selected=selected,
            removed=float(np.clip(removed, -1, 1)),
            at_bound=[n for n in after.at_bound if n.rpartition(".")[0] in selected],
            left_to_black_box=share_left(after.residual, signals, train, test, floor),
            agreed=min([chosen[t] for t in selected[:1]], default=1.0),
            noise_known=self.noise.known,
        )

    def _tested(self, found: Found, behind: tuple[DemonstrationModel, Fitter] | None) -> list[Tested]:
        before = self._bare
        out, first = [], [*found.path[1:2], *(found.rivals[0] if found.rivals else [])]
        for s in sorted(first, key=lambda s: s.value):
            if len(s.model.form.effects) != 1:
                continue
            name = s.model.form.effects[0]
            if behind is None:
                model = self.fitted(s.model, self._bare_touch, self.fitter)
                how, ground = "arm and gauge", self.fitter.predict(s.model.form, s.model.values, AIR)[0]
                model.residual = np.concatenate([ground[:, AIR], before.residual[:, TOUCH]], 1)
            else:
                model, how = self.fitted(behind[0], s.model, behind[1]), "touch"
            share, interval = self.reduction(before, model)
            errors = {"heldout": float(np.sqrt(self.test.value(model.squared)))}
            out.append(Tested(name, errors, share, interval, self.parameters(model, name), how))
        return out
