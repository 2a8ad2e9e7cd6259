"""Demonstrations under judgement: which physics a twin lacks to explain what arm, gauge and touch did.

A sample is a frame; whole episodes are learnt from or held out. Errors are those of `demonstration_fit`.
"""

import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property, partial

import numpy as np

from lerobot_pneutac.diagnosis.bootstrap import Resampler
from lerobot_pneutac.diagnosis.model import FittedModel
from lerobot_pneutac.diagnosis.parts import Parts
from lerobot_pneutac.diagnosis.result import Outcome
from lerobot_pneutac.diagnosis.search import Found, Scored, Search, Trial
from lerobot_pneutac.diagnosis.steps import Steps
from lerobot_pneutac.study.demonstration_data import episode_data
from lerobot_pneutac.study.demonstration_fit import AIR, LATE, TOUCH, Fitter
from lerobot_pneutac.study.demonstration_model import DemonstrationModel, Form
from lerobot_pneutac.study.demonstration_noise import frame_noise
from lerobot_pneutac.study.demonstration_outcome import demonstration_outcome, tested_alone
from lerobot_pneutac.study.demonstration_space import DemonstrationSpace
from lerobot_pneutac.study.demonstration_strength import COMPLIANCE, Strength
from lerobot_pneutac.study.demonstration_words import (
    CREEP,
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
        fitter: fits models to the episodes that are learnt from, as replayed in the twin's world.
        owner: (N,) which episode each frame is of.
        remainder: the most, by its 95 % interval, that the twin left of the demonstrations that it was last
            fitted to; None where it was to none.
        known: how strong the imprints were that the twin was last fitted to; None where they were none of
            this task.
        strengths: how strong they are here, by the identity of a model's twin.
        charged: touch is charged with how much stronger or fainter they are.
        by_level: creep was named by that too.
        bare_air, bare_touch: the twin as it is, on `fitter`.
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
        self.strengths: dict[int, Strength] = {}
        self.charged = self.by_level = False
        self.light = self.known and self.known.light
        episodes = episode_data(twin, recording, progress, self.light)
        self.owner = np.repeat(np.arange(len(episodes)), list(map(len, episodes)))
        order = np.random.default_rng([seed, 5]).permutation(len(episodes))
        away = order[: min(max(1, round(HELD_OUT * len(order))), len(order) - 1)]
        test = np.isin(self.owner, away)
        self.parts = Parts(~test, ~test, test, self.owner, np.zeros(len(episodes), int))
        self.fitter = Fitter(twin, episodes, self.parts.train)
        self.bare_air, self.bare_touch = self.fitter.base(AIR), self.fitter.base(TOUCH)
        self.remainder = self._last.get("heldout_ci95", [None, None])[1]
        self.noise = frame_noise(self.fitter, self.remainder)
        self.findings = [*recording.warnings]
        if dragging := Dragging.of(recording.episodes):
            self.findings.append(dragging.sentence(Dragging.known(twin.history, recording.task)))

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
        self.strengths[id(twin)] = fitter.strength(touch, growth)
        if self.charged and (apart := self.stronger_by(twin)):
            more = curves["imprint"] * (1 - np.exp(-apart)) / fitter.slope * fitter.mm_per_rad
            contact = np.concatenate([e.contact for e in fitter.episodes])
            residual[:, TOUCH] += np.where(contact, more, 0.0)[:, None]
        return residual

    def stronger_by(self, twin: Twin) -> float:
        """Logarithm of how much stronger imprints are than was known, of a twin whose residual is known.

        0 where that is no more than those of one finger differ by.
        """
        return self.strengths[id(twin)].apart(self.known) if self.known else 0.0

    def residual(self, twin: Twin) -> np.ndarray:
        """(N, 5) measured minus predicted by another twin of this finger."""
        fitter = self.world_of(twin)
        return self._residual(fitter, fitter.base(TOUCH), twin)

    def refit(self, effects: Sequence[str], start: FittedModel | None, steps: Steps) -> FittedModel:
        """The twin with these effects fitted, its own where they are named again."""
        fold, asked = self.owner[self.parts.train], effects[len(self.own) :]
        if start is None:
            steps.done()
            self._errors = [self.bare_air.crossed(fold) + self.bare_touch.crossed(fold)]
            return self.bare
        air = self._with(self.fitter, [e for e in asked if of_air(e)], AIR, self.bare_air)
        fitter = self.world_of(self.fitter.twin_with(air, {})) if air.form.effects else self.fitter
        touch = self._with(fitter, [e for e in asked if not of_air(e)], TOUCH, fitter.base(TOUCH))
        self._errors.append(air.crossed(fold) + touch.crossed(fold))
        steps.done()
        return self.fitted(air, touch, fitter)

    @cached_property
    def bare(self) -> FittedModel:
        """The twin as it is."""
        return self.fitted(self.bare_air, self.bare_touch, self.fitter)

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
        strength = self.strengths.get(id(model.twin))
        if strength is None:
            return {}
        own = np.mean([brightness(rest_image(e)) for e in self.recording.episodes], 0)
        return {"imprint": strength.kept(self.recording.task, own if self.light is None else self.light)}

    def prepare(self, selected: Sequence[str], breaks: Sequence[dict]) -> None:
        """Errors include the strength of imprints where that was among what was found."""
        self.charged = COMPLIANCE in selected

    def significant(self, before: FittedModel, after: FittedModel) -> bool:
        """Whether the error falls significantly on episodes that their fit did not see."""
        return self._learnt().drop(*self._errors)[1] > 0

    def _learnt(self) -> Resampler:
        owner = self.owner[self.parts.train]
        return Resampler(np.ones(len(owner), bool), owner, self.parts.stratum, self.seed)

    # ---------------------------------------------------------------- the verbs

    def search(self, jobs: int, steps: Steps) -> Outcome:
        """Looks for what the twin lacks: in its air by arm and gauge, then in its body by touch."""
        began = time.perf_counter()
        steps.expect("fitting arm and gauge", 2)
        air = self._stage(jobs, steps, self.fitter, self.bare_air, AIR)
        tried = air
        if not self._worth(air, self.bare_air, self.fitter, AIR):
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
        tested = tested_alone(self, tried, None) + tested_alone(self, touch, (air.final.model, fitter))
        if not self._worth(touch, base, fitter, TOUCH):
            touch = Found(touch.base, touch.path[:1], touch.base)
        touch = self._nearer(air, touch, fitter)
        return demonstration_outcome(self, air, touch, fitter, tested, began)

    def _nearer(self, air: Found, found: Found, fitter: Fitter) -> Found:
        """More creep, where imprints are stronger than was known and it explains a part of their course.

        A stiffer finger raises the level alone, creep also bends the course of a hold: a tenth of the error
        of all episodes, each unseen by its fit, is enough where the level speaks for it too, and what was
        found instead must be better by as much.
        """
        base, instead = found.base.model, found.final.model.form.effects
        if self.known is None or CREEP not in self.candidates or CREEP in map(family, instead):
            return found
        stronger = fitter.strength(base, self.known.growth).apart(self.known) > 0
        if not stronger or set(air.final.model.form.effects) - {LATE}:  # a slow valve makes them so too
            return found
        creep = fitter.fit(Trial(Form((CREEP,)), base.values | fitter.start(CREEP)), TOUCH, 60)
        crossed = creep.crossed(self.owner[self.parts.train])
        taken = Scored(creep, crossed, self._learnt().value(crossed))
        before, now, after = (
            np.append(s.crossed, self._heldout(s.model, fitter, TOUCH)).mean()
            for s in (found.base, found.final, taken)
        )
        if before < (1 + WORTH_OF_LEFT) * after or after > (1 + WORTH_OF_LEFT) * now:
            return found
        self.by_level = True
        return Found(found.base, [found.base, taken], taken, [[]])

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

    def _worth(self, found: Found, base: DemonstrationModel, fitter: Fitter, columns: slice) -> bool:
        """Whether what a stage found lowers the error of the held-out episodes too, by a good part."""
        before, after = (self._heldout(m, fitter, columns).mean() for m in (base, found.final.model))
        return bool(found.final.model.form.effects) and before - after > WORTH_OF_LEFT * after

    def _heldout(self, model: DemonstrationModel, fitter: Fitter, columns: slice) -> np.ndarray:
        """(n,) squared errors of the frames of the held-out episodes."""
        residual = fitter.predict(model.form, model.values)[0][self.parts.test, columns]
        return (residual**2).sum(1)

    def _least(self, columns: slice, left: float) -> float:
        """Fall of the mean square error below which a term does not count, where `left` is left with it."""
        last = self._last.get("touch" if columns == TOUCH else "arm_and_gauge")
        return WORTH * last**2 if last is not None else WORTH_OF_LEFT * left
