"""Demonstrations under judgement: which physics a twin lacks to explain what arm, gauge and touch did.

A sample is a frame; whole episodes are learnt from or held out. Errors are those of `demonstration_fit`.
"""

import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cached_property, partial

import numpy as np

from lerobot_pneutac.diagnosis import thresholds as T
from lerobot_pneutac.diagnosis.bootstrap import BlockBootstrap, Parts
from lerobot_pneutac.diagnosis.result import FittedModel, Outcome, Rival, Tested
from lerobot_pneutac.diagnosis.search import Found, Scored, Search, Steps, Structure, chosen_in, rivals
from lerobot_pneutac.study.base import EffectStudy, with_unit
from lerobot_pneutac.study.demonstration_fit import (
    AIR,
    COMPLIANCE,
    LATE,
    MAD,
    STIFFNESS,
    TOUCH,
    DemonstrationModel,
    DemonstrationSpace,
    EpisodeData,
    Fitter,
    Strength,
    command_signals,
    episode_data,
    latency_s,
)
from pneutac_datasets.demonstrations.imprint import Dragging, brightness, rest_image
from pneutac_datasets.demonstrations.reading import Demonstrations
from pneutac_datasets.recording.noise import NoiseFloor
from pneutac_sim.effects.laws import family, is_law, law
from pneutac_sim.effects.registry import body_effects, get_effect, of_body
from pneutac_sim.executor import Progress, no_progress
from pneutac_sim.finger.quantities import rms
from pneutac_sim.twin import Twin

UNIT = "mm at the tip"
OF_AIR = ("dead_time", "valve_lag", "valve_slew", "leak")
CREEP = "creep"
OF_BODY = (CREEP, "power_law_memory(p)", "hysteresis", "stiffening", "friction")
UNSEEN = ("another friction of the gel", "another stiffness of the finger", "another weight of the object")
ENOUGH = 10  # demonstrations, from which on most effects show


def of_air(effect: str) -> bool:
    """Whether arm and gauge show an effect; touch shows the others."""
    return effect == LATE or (effect != COMPLIANCE and get_effect(effect).of_air)


def bends(effect: str) -> bool:
    """Whether an effect of the twin can be re-fitted to demonstrations: one of air, drive or material."""
    e = law(effect) if is_law(effect) else body_effects()[effect]
    return e.stage in ("pneumatics", "drive", "material") and not e.columns and not e.of_markers


def stopped(name: str) -> bool:
    """Whether a bound stops an effect: the weights of a series may well be zero."""
    return not name.partition(".")[2].startswith(("weight", "delay", "vent_growth", "fill", "band"))


def frame_noise(fitter: Fitter, remainder: float | None) -> NoiseFloor:
    """What differs from frame to frame; or the `remainder`, mm, where that is known and more.

    Of each signal by the median size of its third differences over the root of 20, their gain on white noise:
    motion has little of them.
    """
    columns: dict[str, list[np.ndarray]] = {"flange": [], "pressure.pos": [], "imprint": []}
    for e in fitter.episodes:
        columns["flange"].append(1e3 * np.sqrt(3) * np.diff(e.flange_m, 3, axis=0).ravel())
        columns["pressure.pos"].append(fitter.mm_per_kpa * np.diff(e.pressure_kpa, 3))
        strong = e.imprint > 0.5 * e.imprint.max()
        columns["imprint"].append(fitter.mm_per_rad * np.diff(e.imprint[strong], 3) / fitter.slope)
    sizes = {k: float(MAD * np.median(np.abs(np.concatenate(v))) / np.sqrt(20)) for k, v in columns.items()}
    value = float(np.sqrt(sum(s**2 for s in sizes.values())))
    if remainder is not None and remainder > value:
        how = "what the twin left of the demonstrations that it was last fitted to, at most"
        return NoiseFloor(remainder, None, UNIT, how, sizes, True)
    return NoiseFloor(value, None, UNIT, "what differs from frame to frame", sizes, False)


class DemonstrationStudy(EffectStudy):
    """Episodes of one task, which are replayed in the twin's world once an error is asked for.

    Arguments are those of `study_of`; `progress` is called with how many episodes are replayed.

    Attributes:
        remainder: the most, by its 95 % interval, that the twin left of the demonstrations that it was last
            fitted to; None where it was to none.
        known: how strong the imprints were that the twin was last fitted to; None where they were none of
            this task.
        strengths: how strong they are here, by the identity of a model's twin.
        charged: touch is charged with how much stronger or fainter they are.
        by_level: creep was named by that too.
    """

    unit = UNIT
    nothing_left = "Nothing needs to be recorded."
    recording: Demonstrations  # pyright: ignore[reportIncompatibleVariableOverride]

    def __init__(
        self,
        twin: Twin,
        recording: Demonstrations,
        seed: int = 0,
        adding: Sequence[str] = (),
        progress: Progress = no_progress,
    ):
        self.twin, self.recording, self.seed = twin, recording, seed
        self.twin_effects = tuple(of_body(twin.effects))
        tried = dict.fromkeys((LATE, *OF_AIR, *OF_BODY, *(e for e in self.twin_effects if bends(e))))
        self.candidates = [e for e in tried if not adding or e in adding]
        self._last = ([{}] + [h for h in twin.history if h.get("unit") == UNIT])[-1]
        self.known = Strength.known(self._last, recording.task)
        self.strengths: dict[int, Strength] = {}
        self.charged = self.by_level = False
        self.light = self.known and self.known.light
        self.remainder = self._last.get("heldout_ci95", [None, None])[1]
        self._progress = progress
        self.findings = [*recording.warnings]
        if dragging := Dragging.of(recording.episodes):
            self.findings.append(dragging.sentence(Dragging.known(twin.history, recording.task)))

    @cached_property
    def episodes(self) -> list[EpisodeData]:
        """Each as replayed in the twin's world, which takes seconds."""
        return episode_data(self.twin, self.recording, self._progress, self.light)

    @cached_property
    def owner(self) -> np.ndarray:
        """(N,) which episode each frame is of."""
        return np.repeat(np.arange(len(self.episodes)), list(map(len, self.episodes)))

    @cached_property
    def parts(self) -> Parts:  # pyright: ignore[reportIncompatibleVariableOverride]
        count = len(self.episodes)
        order = np.random.default_rng([self.seed, 5]).permutation(count)
        away = order[: min(max(1, round(T.HELD_OUT * count)), count - 1)]
        test = np.isin(self.owner, away)
        return Parts(~test, ~test, test, self.owner, np.zeros(count, int))

    @cached_property
    def fitter(self) -> Fitter:
        """Fits models to the episodes that are learnt from."""
        return Fitter(self.twin, self.episodes, self.parts.train)

    @cached_property
    def bare_air(self) -> DemonstrationModel:
        return self.fitter.base(AIR)

    @cached_property
    def bare_touch(self) -> DemonstrationModel:
        return self.fitter.base(TOUCH)

    @cached_property
    def noise(self) -> NoiseFloor:  # pyright: ignore[reportIncompatibleVariableOverride]
        return frame_noise(self.fitter, self.remainder)

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
        found = (*air.structure.effects, *touch.structure.effects)
        twin = replayed.twin_with(touch, touch.intervals(fold))
        return FittedModel(
            effects=tuple(dict.fromkeys((*self.twin_effects, *found))),
            residual=self._residual(fitter, touch, twin),
            count=len(air.unit) + len(touch.unit),
            twin=twin,
            at_bound=[n for n in (*air.at_bound, *touch.at_bound) if stopped(n)],
        )

    def _residual(self, fitter: Fitter, touch: DemonstrationModel, twin: Twin) -> np.ndarray:
        """(N, 5) of the model of a twin; where compliance is judged, touch is charged with its strength."""
        residual, curves = fitter.predict(touch.structure, touch.values)
        growth = self.known.growth if self.known else touch.values["growth"]
        self.strengths[id(twin)] = fitter.strength(touch, growth)
        if self.charged and (log_ratio := self.stronger_by(twin)):
            more = curves["imprint"] * (1 - np.exp(-log_ratio)) / fitter.slope * fitter.mm_per_rad
            contact = np.concatenate([e.contact for e in fitter.episodes])
            residual[:, TOUCH] += np.where(contact, more, 0.0)[:, None]
        return residual

    def stronger_by(self, twin: Twin) -> float:
        """Logarithm of how much stronger imprints are than was known, of a twin whose residual is known.

        0 where that is no more than those of one finger differ by.
        """
        return self.strengths[id(twin)].log_ratio(self.known) if self.known else 0.0

    def residual(self, twin: Twin) -> np.ndarray:
        fitter = self.world_of(twin)
        return self._residual(fitter, fitter.base(TOUCH), twin)

    def refit(self, effects: Sequence[str], start: FittedModel | None, steps: Steps) -> FittedModel:
        """The twin with these effects fitted, its own where they are named again."""
        fold, candidates_of = self.owner[self.parts.train], effects[len(self.twin_effects) :]
        if start is None:
            steps.done()
            self._errors = [self.bare_air.cv_squared(fold) + self.bare_touch.cv_squared(fold)]
            return self.bare
        air = self._with(self.fitter, [e for e in candidates_of if of_air(e)], AIR, self.bare_air)
        fitter = self.world_of(self.fitter.twin_with(air, {})) if air.structure.effects else self.fitter
        touch = self._with(fitter, [e for e in candidates_of if not of_air(e)], TOUCH, fitter.base(TOUCH))
        self._errors.append(air.cv_squared(fold) + touch.cv_squared(fold))
        steps.done()
        return self.fitted(air, touch, fitter)

    @cached_property
    def bare(self) -> FittedModel:
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
        return fitter.fit((Structure(tuple(effects)), values), columns, 60)

    def errors(self, model: FittedModel) -> dict[str, float]:
        parts = {"arm_and_gauge": AIR, "touch": TOUCH}
        return super().errors(model) | {k: rms(model.residual[:, c]) for k, c in parts.items()}

    def noted(self, model: FittedModel) -> dict:
        """How strong imprints are, which later demonstrations are held against."""
        strength = self.strengths.get(id(model.twin))
        if strength is None:
            return {}
        own = np.mean([brightness(rest_image(e)) for e in self.recording.episodes], 0)
        return {"imprint": strength.stored(self.recording.task, own if self.light is None else self.light)}

    def signals(self) -> np.ndarray:
        return command_signals(self.episodes)

    def removed(self, worst: float, left: float, floor: float) -> float:
        return 1 - max(left - floor**2, 0.0) / (worst - floor**2) if worst > floor**2 else 1.0

    def prepare(self, selected: Sequence[str], breaks: Sequence[dict]) -> None:
        """Errors include the strength of imprints where that was among what was found."""
        self.charged = COMPLIANCE in selected

    def significant(self, before: FittedModel, after: FittedModel) -> bool:
        """Whether the error falls significantly on episodes that their fit did not see."""
        return self._learnt().drop(*self._errors)[1] > 0

    def _learnt(self) -> BlockBootstrap:
        owner = self.owner[self.parts.train]
        return BlockBootstrap(np.ones(len(owner), bool), owner, self.parts.stratum, self.seed)

    # ---------------------------------------------------------------- the verbs

    def search(self, jobs: int, steps: Steps) -> Outcome:
        began = time.perf_counter()
        steps.expect("fitting arm and gauge", 2)
        air = self._stage(jobs, steps, self.fitter, self.bare_air, AIR)
        tried = air
        if not self._worth(air, self.bare_air, self.fitter, AIR):
            air = Found(air.base, air.path[:1], air.base)
        steps.done()
        fitter = self.fitter
        if air.final.model.structure.effects:
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
        base, instead = found.base.model, found.final.model.structure.effects
        if self.known is None or CREEP not in self.candidates or CREEP in map(family, instead):
            return found
        stronger = fitter.strength(base, self.known.growth).log_ratio(self.known) > 0
        if not stronger or set(air.final.model.structure.effects) - {LATE}:  # a slow valve makes them so too
            return found
        creep = fitter.fit((Structure((CREEP,)), base.values | fitter.start(CREEP)), TOUCH, 60)
        cv_squared = creep.cv_squared(self.owner[self.parts.train])
        taken = Scored(creep, cv_squared, self._learnt().value(cv_squared))
        before, now, after = (
            np.append(s.cv_squared, self._heldout(s.model, fitter, TOUCH)).mean()
            for s in (found.base, found.final, taken)
        )
        if before < (1 + T.WORTH_OF_LEFT) * after or after > (1 + T.WORTH_OF_LEFT) * now:
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
            report = lambda text: steps.expect(text, 0)  # noqa: E731
            search = Search(space, self._learnt(), fold, float(floor), pool.map, report)
            found = search.find()
            found.final = space.pruned(found.final, search.score, partial(self._least, columns))
            found.final = self._confirmed(found, search, space)
            return found

    def _confirmed(self, found: Found, search: Search, space: DemonstrationSpace) -> Scored:
        """What a stage found, without the terms that do not lower the error of the held-out episodes too.

        Of few episodes that are learnt from, one that stands out may bring in a term that the others lack.
        """
        now = found.final
        while terms := now.model.structure.effects:
            without = [search.score(space.without(now.model, e)) for e in terms]
            error, *errors = (
                self._heldout(s.model, space.fitter, space.columns).mean() for s in (now, *without)
            )
            if min(errors) > error:
                return now if now is found.final or search.is_worth(found.base, now) else found.base
            now = without[int(np.argmin(errors))]
        return now

    def _worth(self, found: Found, base: DemonstrationModel, fitter: Fitter, columns: slice) -> bool:
        """Whether what a stage found lowers the error of the held-out episodes too, by a good part."""
        before, after = (self._heldout(m, fitter, columns).mean() for m in (base, found.final.model))
        return bool(found.final.model.structure.effects) and before - after > T.WORTH_OF_LEFT * after

    def _heldout(self, model: DemonstrationModel, fitter: Fitter, columns: slice) -> np.ndarray:
        """(n,) squared errors of the frames of the held-out episodes."""
        residual = fitter.predict(model.structure, model.values)[0][self.parts.test, columns]
        return (residual**2).sum(1)

    def _least(self, columns: slice, left: float) -> float:
        """Fall of the mean square error below which a term does not count, where `left` is left with it."""
        last = self._last.get("touch" if columns == TOUCH else "arm_and_gauge")
        return T.WORTH_OF_LAST * last**2 if last is not None else T.WORTH_OF_LEFT * left

    # ---------------------------------------------------------------- sentences

    def twin_of(self, model: FittedModel) -> Twin:
        return model.twin

    def refusal(self, effect: str) -> str:
        if effect in self.candidates:
            return ""
        if effect == COMPLIANCE:
            return f"'{COMPLIANCE}' is found by a diagnosis only; give its folder with --from."
        known = ", ".join(dict.fromkeys((LATE, *OF_AIR, *OF_BODY, *self.twin_effects)))
        return f"Demonstrations cannot show '{effect}'; give one of {known}."

    def parameters(self, model: FittedModel, effect: str) -> dict[str, dict]:
        if effect == COMPLIANCE:
            known = model.twin.parameters.get(STIFFNESS)
            return {STIFFNESS: with_unit(known, "N m/rad")} if known else {}
        if effect != LATE:
            return super().parameters(model, effect)
        known = model.twin.parameters.get("command_latency_s")
        return {"latency_s": with_unit(known, "s")} if known else {}

    def at_bound(self, model: FittedModel, effects: Sequence[str]) -> list[str]:
        return [n for n in model.at_bound if n.rpartition(".")[0] in effects]

    def describe(self, model: FittedModel, effect: str) -> str:
        if effect == LATE:
            late = latency_s(model.twin)
            return f"Your commands act {late:.2g} s late, those to the arm and those to the air."
        if effect == COMPLIANCE:
            share = model.twin.parameter(STIFFNESS) / self.twin.parameter(STIFFNESS)
            return (
                f"Your finger is {'softer' if share < 1 else 'stiffer'} than when the twin was fitted to "
                f"demonstrations: judged by its imprints it presses with {share:.2g} times the force."
            )
        if effect in self.twin_effects:
            was, now = self.twin.effects[effect], model.twin.effects[effect]
            changes = ", ".join(
                f"{k} {was[k].value:.3g} -> {v.value:.3g}"
                for k, v in now.items()
                if k in was and v.value != was[k].value
            )
            kind = family(effect).replace("_", " ")
            return f"Your finger's {kind} differs from the twin's ({effect}: {changes})."
        return super().describe(model, effect)

    def cause(self, model: FittedModel, effect: str) -> str:
        if effect == LATE:
            return f"a delay of {latency_s(model.twin):.2g} s of all commands"
        if effect == COMPLIANCE:
            share = model.twin.parameter(STIFFNESS) / self.twin.parameter(STIFFNESS)
            return f"a finger that presses with {share:.2g} times the force"
        if effect in self.twin_effects:
            return f"a change of the twin's {family(effect).replace('_', ' ')}"
        return super().cause(model, effect)

    def confusable_with(self, effects: Sequence[str]) -> str:
        """What touch alone cannot separate from changes of the contact, which has no fitted model."""
        body = [e for e in effects if e != COMPLIANCE and not of_air(e)]
        kinds = dict.fromkeys(family(e).replace("_", " ") for e in body)
        sentences = []
        if kinds:
            sentences.append(
                f"Touch cannot distinguish {' and '.join(kinds)} from {', '.join(UNSEEN[:-1])} or "
                f"{UNSEEN[-1]}; a bench recording of the finger can."
            )
        if COMPLIANCE in effects:
            sentences.append(
                "A gel that has hardened makes imprints as faint; one that has softened, or more creep than "
                "touch shows, makes them as strong. A press of known force on the gel decides."
            )
        return " ".join(sentences)

    def experiment(self, model: FittedModel, effect: str) -> str:
        if effect == LATE:
            return (
                "Command a step of the arm and of the pressure in one frame, and hold still before and after."
            )
        if effect == COMPLIANCE:
            return "Record the finger on the bench with a known weight at its tip, in a column payload_g."
        return super().experiment(model, effect)

    def amount_recorded(self) -> tuple[float, str, str]:
        return float(len(self.episodes)), "demonstration", "of the same task"

    def too_little(self) -> str:
        n = len(self.episodes)
        few = f"{n} demonstrations are too few to find what is missing. {self.more_data}"
        return "" if n >= T.DEMONSTRATIONS else few

    @property
    def more_data(self) -> str:
        n = len(self.episodes)
        more = f"{ENOUGH} demonstrations or more" if n < ENOUGH else f"more than these {n} demonstrations"
        return f"Record {more} that press and hold, at two pressures."

    @property
    def repeat(self) -> str:
        return self.more_data

    def how_tested(self, outcome: Outcome) -> str:
        return "Each candidate is fitted to arm, gauge and touch together and judged on whole episodes."


def demonstration_outcome(
    study: "DemonstrationStudy", air: Found, touch: Found, fitter: Fitter, tested: list[Tested], began: float
) -> Outcome:
    """The result of a search, tested on held-out episodes; `began` by `time.perf_counter`.

    `fitter` is of the replays with the air that was found, behind which the body was searched by touch.
    """
    before = study.bare
    models, base = [air.final.model, touch.final.model], touch.base.model
    after = study.fitted(models[0], models[1], fitter)
    lower = study.test.value(after.squared) < study.test.value(before.squared)
    if not (lower or study.by_level):
        models, after, fitter = [study.bare_air, study.bare_touch], before, study.fitter
    selected = [e for m in models for e in m.structure.effects]
    ladder = [("as it is", before)]
    if models[0].structure.effects:
        ladder.append((" + ".join(models[0].structure.effects), study.fitted(models[0], base, fitter)))
    if models[1].structure.effects:
        ladder.append((" + ".join(selected), after))
    pressing = pressing_as(study, after, models[1], fitter, selected)
    if pressing is not None:
        selected, after = [*selected, COMPLIANCE], pressing
        study.prepare(selected, ())
        before = study.fitted(study.bare_air, study.bare_touch, study.fitter)
        ladder = [("as it is", before), *ladder[1:], (" + ".join(selected), after)]
    others = rivals(
        touch,
        study.noise.by_column["imprint"],
        selected,
        family,
        lambda s: study.fitted(air.final.model, s.model, fitter),
    )
    if study.by_level:
        others.insert(0, _stiffer(study, study.fitted(models[0], base, fitter), after))
    votes = {}
    for found in (air, touch):
        votes |= chosen_in(found, study.owner[study.parts.train], study.noise.floor, family)
    chosen = {t: votes.get(t, 1.0) for t in selected}
    floor = max(study.noise.floor, 1e-12)
    evidence = study.evidence(before, after, selected, chosen, floor=floor)
    return study.outcome(
        began, before, after, evidence, ladder=ladder, tested=tested, rivals=others, chosen_in=chosen
    )


def pressing_as(
    study: "DemonstrationStudy",
    found: FittedModel,
    touch: DemonstrationModel,
    fitter: Fitter,
    selected: Sequence[str],
) -> FittedModel | None:
    """The same with a finger that presses as hard as its imprints are strong; None where it does.

    Imprints that are stronger where a slow valve or more of the body was found may come from that.
    """
    log_ratio, strength = study.stronger_by(found.twin), study.strengths[id(found.twin)]
    if study.known is None or not log_ratio or (log_ratio > 0 and set(selected) - {LATE}):
        return None
    twin = strength.pressing(found.twin, study.known)
    study.strengths[id(twin)] = strength
    uncharged = fitter.predict(touch.structure, touch.values)[0]
    return replace(found, twin=twin, residual=uncharged, count=found.count + 1)


def _stiffer(study: "DemonstrationStudy", plain: FittedModel, found: FittedModel) -> Rival:
    """A stiffer finger in place of creep that was named by the imprints' level too."""
    assert study.known is not None
    twin = study.strengths[id(plain.twin)].pressing(plain.twin, study.known)
    worse = study.test.value(plain.squared) / study.test.value(found.squared) - 1
    return Rival(CREEP, COMPLIANCE, worse, replace(plain, twin=twin), found)


def tested_alone(
    study: "DemonstrationStudy", found: Found, behind: tuple[DemonstrationModel, Fitter] | None
) -> list[Tested]:
    """Each candidate alone, of arm and gauge, or of touch behind a model of the air on its replays."""
    before = study.bare
    out, first = [], [*found.path[1:2], *(found.rivals[0] if found.rivals else [])]
    for s in sorted(first, key=lambda s: s.value):
        if len(s.model.structure.effects) != 1:
            continue
        name = s.model.structure.effects[0]
        if behind is None:
            model = study.fitted(s.model, study.bare_touch, study.fitter)
            how, ground = "arm and gauge", study.fitter.predict(s.model.structure, s.model.values, AIR)[0]
            model.residual = np.concatenate([ground[:, AIR], before.residual[:, TOUCH]], 1)
        else:
            model, how = study.fitted(behind[0], s.model, behind[1]), "touch"
        out.append(study.alone(name, model, before, how))
    return out
