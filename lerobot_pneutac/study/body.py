"""A recording of a finger or an arm under judgement; a sample is a row."""

import time
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import chain

import numpy as np

from lerobot_pneutac.diagnosis import thresholds as T
from lerobot_pneutac.diagnosis.design import predict, read
from lerobot_pneutac.diagnosis.result import (
    PROFILE,
    SET_UP,
    Candidate,
    Contribution,
    FittedModel,
    Outcome,
    Refits,
    Rival,
    Tested,
    family_in,
)
from lerobot_pneutac.diagnosis.search import Found, Scored, Steps, contenders, rivals
from lerobot_pneutac.diagnosis.verdict import Evidence, Mechanism, called, mechanism
from lerobot_pneutac.study.body_base import BodyBase, base_effects
from lerobot_pneutac.study.body_model import BodyFitter, BodyModel
from lerobot_pneutac.study.body_search import LATE_S, LATE_TEMPERATURE, BodySearch, Searched
from lerobot_pneutac.study.body_space import BodySpace
from lerobot_pneutac.study.pair import recorded_min
from pneutac_datasets.recording.wording import joined
from pneutac_sim.effects.laws import family, is_law, starts
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.finger.data import BodyData
from pneutac_sim.twin import Twin

FLOWS = ("valve_lag", "valve_slew", "orifice_flow")  # equations of how a valve limits the flow
OF_TRIALS = (
    "Each run has its own small offset, gain and time shift. They are no part of the device and not in the "
    "twin; the error without them is reported separately."
)

IN_THE_AIR = (
    "What looks like {} lies between the command and the measured pressure: driven by that pressure the body "
    "is as well described without."
)


def _of(parameter: str) -> str:
    return parameter.rpartition(".")[0]


DRIFT = "p exp(-t)"  # the law of one drift, from the recording's beginning on


class BodyStudy(BodyBase):
    """Markers, angles or curvatures of a finger or an arm, and the search for what their twin lacks."""

    # ---------------------------------------------------------------- the verbs

    def search(self, jobs: int, steps: Steps) -> Outcome:
        began = time.perf_counter()
        with ThreadPoolExecutor(jobs) as pool:
            steps.expect("fitting the twin as it is", 1)
            while True:  # again where the recording turned out not to be of one device, seen by one marker
                search = BodySearch(self, pool.map, lambda text: steps.expect(text, 0))
                done = search.find()
                if done is not None:
                    break
            before = search.as_it_is()
            if done.model.model.structure.trials:
                self.findings = [*self.findings, OF_TRIALS]
            self._report_left_out(search, done.model.model)
            steps.done()
            return _Judgement(self, search, before, done).outcome(began)

    def _report_left_out(self, search: BodySearch, model: BodyModel) -> None:
        """Adds a finding for each cause that a search left out although the error falls by it."""
        left_out = (s for t, s in search.left_out.items() if t not in model.structure.effects)
        self.findings = [*self.findings, *left_out]

    def refits(self, effects: Sequence[str], steps: Steps) -> Refits:
        """The twin re-fitted as it is, with the known causes, and with these effects too.

        Known causes are chosen with the effects in place: those without which the cross-validated error rises
        significantly, and of which there is no `doubt`. One that the twin has goes where it is worth
        nothing once the effects are there.
        """
        search = BodySearch(self, map, lambda text: None)
        start = search.as_it_is()
        while search.take_back_slip(start):
            start = search.as_it_is()
        steps.done()
        fitter = BodyFitter(self.recording, self.twin, search.rows)
        causes = [e for e in base_effects(self) if e not in (*self.twin_effects, *effects)]
        structure = replace(start.model.structure, effects=(*self.twin_effects, *causes), own_profile=True)
        joints = [len(self.twin.spine_joint_positions_mm)]
        space = BodySpace(fitter, structure.effects, joints, self.candidates, ((),), structure.input_model)
        engine, values, new = search.engine(space), start.model.values, []
        rich = engine.fits([(structure, values), (structure, values | fitter.rough(structure))], 8)
        for name in effects:
            structure = structure.plus(name)
            new.append(structure.effects[-1])
            values = rich[0].model.values if rich else values
            rich = engine.fits([space.trial(structure, values, name, s) for s in starts(name)], 8)
        rich = [search.score(space.refine_actuation(space.refine(s.model))) for s in rich[:1]] or [start]
        whole = search.simplified(space, Found(start, [start], rich[0]), (*self.twin_effects, *new))
        whole = search.without_idle(space, whole, whole.model.structure.effects)
        self._report_left_out(search, whole.model)
        model, terms = whole.model, [e for e in whole.model.structure.effects if e not in self.twin_effects]
        without = {t: search.score(space.without(model, t)) for t in terms}
        known = [t for t in terms if t not in new]
        if model.structure.own_profile and not start.model.structure.own_profile:
            known.append(PROFILE)
            if (plain := search.plain(space, model)) is not None:
                without[PROFILE] = plain
        base = start
        if known:
            base = without[new[0]] if len(new) == 1 else search.score(space.without(model, *new))
        baseline, after, better = self.fitted(base.model), self.fitted(model), None
        significant = engine.is_worth(base, whole)
        if new and self.test.drop(baseline.squared, after.squared)[1] > 0:
            better = self._better(search, space, base, whole, set(map(family, new)))
        steps.done()
        return Refits(
            before=self.fitted(start.model),
            baseline=baseline,
            after=after,
            known=known,
            contributions=self.contributions(
                after, {t: self.fitted(s.model) for t, s in without.items()}, known
            ),
            significant=significant,
            doubts=search.doubts(space, whole, {t: without[t] for t in new if t in without}),
            better=better and (better[0], self.fitted(better[1].model)),
        )

    def _better(
        self, search: BodySearch, space: BodySpace, base: Scored, whole: Scored, kinds: set[str]
    ) -> tuple[str, Scored] | None:
        """Another mechanism that explains significantly more by itself and with which these add nothing."""
        engine = search.engine(space)
        space.candidates = [e for e in space.candidates if family(e) not in kinds]
        others = engine.fits(space.grow(base.model, 12, 0), 8)
        if not others or not search.bootstrap.significant_drop(whole.cv_squared, others[0].cv_squared):
            return None
        added = [e for e in whole.model.structure.effects if e not in base.model.structure.effects]
        values = others[0].model.values | {k: v for k, v in whole.model.values.items() if _of(k) in added}
        both = engine.fits([(others[0].model.structure.plus(*added), values)], 8)
        if both and engine.is_worth(others[0], both[0]):
            return None
        return others[0].model.structure.effects[-1], others[0]

    def contributions(
        self, after: FittedModel, without: Mapping[str, FittedModel], known: Sequence[str]
    ) -> list[Contribution]:
        """What each term is worth on the test part, by the models re-fitted without it; the largest first."""
        error, out = self.errors(after)["heldout"], []
        for name, model in without.items():
            drop = self.test.drop(model.squared, after.squared)
            out.append(Contribution(name, name in known, self.errors(model)["heldout"], error, drop))
        return sorted(out, key=lambda c: -c.drop[0])


class _Judgement:
    """What a search of a body is worth, judged on test blocks, which nothing was fitted or chosen on.

    `start` is the twin as it is, re-fitted; `before` and `after` are that and the final model on all samples.
    """

    def __init__(self, study: BodyStudy, search: BodySearch, start: Scored, done: Searched):
        self.study, self.search, self.start, self.done = study, search, start, done
        self.before, self.final = study.fitted(start.model), done.model.model
        self.after = self.with_air(self.final)

    def outcome(self, began: float) -> Outcome:
        """The result of the search; `began` by `time.perf_counter`."""
        study, search, start, done = self.study, self.search, self.start, self.done
        floor, helps = study.noise.floor, self.helps()
        not_yet, near_miss = "" if helps else self.not_yet(), []
        if not helps:
            near_miss = done.terms if not_yet else []
            self.after, done.terms = self.before, []
        runs, left = self.run_terms() if helps else None, self.after.squared
        if runs is not None:
            left = (study.residual_with_runs(self.final) ** 2).sum(axis=1)
            runs["error"] = float(np.sqrt(study.test.value(left)))
        evidence = self.evidence(left)
        evidence.near_miss = near_miss
        if done.terms and evidence.at_noise:
            helps, self.after, near_miss, done.terms, runs = False, self.before, done.terms, [], None
            evidence = self.evidence(self.after.squared)
            evidence.near_miss = near_miss if evidence.before is None else []
        if needless := [t for t in done.terms if t in done.needless]:
            named = joined([called(t, self.after.twin) for t in needless])
            study.findings = [*study.findings, IN_THE_AIR.format(named)]
        self.known = self.known_causes() if helps else []
        worth = self.contributions() if helps else []
        others = rivals(done.found, floor, done.terms, family, lambda s: study.fitted(s.model))
        others = [r for r in others if family_in(r.fit.twin, r.rival) != family_in(r.winner.twin, r.effect)]
        others = [r for r in others if self.still_as_good(r)]
        return study.outcome(
            began,
            self.before,
            self.after,
            evidence,
            ladder=[("as it is", self.before), *(self.ladder() if helps else [])],
            tested=self.tested(),
            rivals=others,
            known=self.known,
            baseline=self.baseline() if self.known else None,
            contributions=worth,
            run_terms=runs,
            chosen_in=done.chosen_in,
            base_model=self.base() if helps else {},
            contenders=self.contenders()
            if helps
            else contenders(
                [start], search.bootstrap, study.twin_effects, lambda s: study.fitted(s.model).twin
            ),
            mechanisms=self.mechanisms(evidence, worth),
            not_yet=not_yet,
        )

    def helps(self) -> bool:
        """Whether the error falls significantly where it was searched, and on test blocks too."""
        cv_squared = self.start.cv_squared, self.done.model.cv_squared
        significant = self.search.bootstrap.significant_drop(*cv_squared, self.study.noise.floor**2)
        value = self.study.test.value
        return significant and value(self.after.squared) < value(self.before.squared)

    def with_air(self, model: BodyModel) -> FittedModel:
        """A model of the body, with the air that was found where the measured pressure drove it."""
        study, done = self.study, self.done
        if not done.driven:
            return study.fitted(model)
        assert done.air is not None
        return self.of_twin(study.with_air(model, done.air.final.model), len(model.free))

    def of_twin(self, twin: Twin, count: int = 0) -> FittedModel:
        residual = self.study.residual(twin)
        return FittedModel(effects=tuple(twin.effects), residual=residual, count=count, twin=twin)

    def not_yet(self) -> str:
        """What to record where the error falls, but not significantly; empty where it hardly falls."""
        study, bootstrap, start = self.study, self.search.bootstrap, self.start
        fall = bootstrap.paired(start.cv_squared, self.done.model.cv_squared, bootstrap)
        tested = study.test.value(self.before.squared) - study.test.value(self.after.squared)
        if not self.done.terms or min(fall.value / start.value, tested / start.value) < T.WORTH_OF_CAUSE:
            return ""
        return (
            f"Record about {study.more_to_show(fall)}: they show a fall of the mean square error such as "
            f"this one, {fall.value:.3g} {study.unit}^2 [{fall.low:.3g} to {fall.high:.3g}], with a power of "
            f"{100 * T.POWER:.0f} %."
        )

    def mechanisms(self, evidence: Evidence, worth: Sequence[Contribution]) -> list[Mechanism]:
        """What each cause may be, the largest first; none where the noise was not measured."""
        if evidence.poor or not evidence.noise_known:
            return []
        causes: dict[str, list[Contribution]] = {}  # contributions come with the largest first
        for c in worth:
            if c.name in evidence.selected and c.name not in SET_UP:
                causes.setdefault(family_in(self.after.twin, c.name), []).append(c)
        out = []
        for i, (cause, terms) in enumerate(causes.items()):
            missed = 0.0 if i == 0 else 1 - self.done.chosen_in.get(terms[0].name, 1.0)
            drop = terms[0].drop[0] / self.study.noise.floor**2
            usual = {family(c.name) for c in terms}
            elsewhere = max(evidence.elsewhere, default=0.0) <= T.CLOSE
            in_air = all(get_effect(c.name).of_air for c in terms)
            gauge = shown_by_gauge(self.study, self.done, cause, causes) if in_air else None
            gauge = False if self.done.needless.issuperset(c.name for c in terms) else gauge
            out.append(mechanism(cause, drop, evidence.removed, missed, causes, usual, elsewhere, gauge))
        return out

    def known_causes(self) -> list[str]:
        """Known causes among what the final model needed and the twin lacks."""
        causes = base_effects(self.study)
        own_profile = self.final.structure.own_profile and not self.start.model.structure.own_profile
        return [*(t for t in self.done.terms if t in causes), *([PROFILE] if own_profile else [])]

    def baseline(self) -> FittedModel:
        """The twin with the known causes alone, re-fitted from the command."""
        start, known = self.start.model, self.known
        structure = replace(start.structure, own_profile=start.structure.own_profile or PROFILE in known)
        structure = structure.plus(*(k for k in known if k != PROFILE))
        values = start.values | {k: v for k, v in self.final.values.items() if _of(k) in known}
        fitter = BodyFitter(self.study.recording, self.study.twin, self.search.rows)
        fits = [fitter.fit(structure, v, 12) for v in (values, values | fitter.rough(structure))]
        return self.study.fitted(min(map(self.search.score, fits), key=lambda s: s.value).model)

    def contributions(self) -> list[Contribution]:
        """What each term adds to all others; of the air too where the gauge drove the body."""
        done = self.done
        models = {t: self.with_air(s.model) for t, s in done.without.items() if t in done.terms}
        if PROFILE in self.known and (plain := self.search.plain(done.space, self.final)) is not None:
            models[PROFILE] = self.with_air(plain.model)
        for term, air in done.air.without.items() if done.driven and done.air is not None else ():
            if term in done.terms and term not in models:
                models[term] = self.of_twin(self.study.with_air(self.final, air.model))
        return self.study.contributions(self.after, models, self.known)

    def still_as_good(self, rival: Rival) -> bool:
        """Whether a rival fits as well in its effect's place when all is there that was found after it."""
        effect, other, space, final = rival.effect, rival.rival, self.done.space, self.done.model
        structure, noise_mse = final.model.structure, self.study.noise.floor**2
        if effect not in structure.effects or effect not in self.done.without:
            return True
        if other in structure.effects:
            return False
        values = {f"{other}.{k}": v.value for k, v in rival.fit.twin.effects[other].items()}
        swapped = structure.without(effect).plus(other), final.model.values | values
        fits = self.search.engine(space).fits(
            [swapped, *(space.trial(*swapped, other, s) for s in starts(other))], 8
        )
        if fits and "pneumatics" in {get_effect(e).stage for e in (effect, other)}:
            fits[0] = self.search.score(space.refine_actuation(fits[0].model))
        least = T.AS_GOOD * (self.done.without[effect].value - noise_mse), T.WORTH_OF_NOISE * noise_mse
        return bool(fits) and fits[0].value - final.value < max(least)

    def run_terms(self) -> dict[str, float] | None:
        """Root mean squares over runs of what they have of their own; None where runs do not differ."""
        study, model = self.study, self.final
        if not model.structure.trials:
            return None
        data = BodyFitter(study.recording, study.twin, np.zeros(1, int)).data(model.structure.input_model)
        d, p = len(data.columns), data.inputs.pressure_range_kpa
        offset, gain, zero, clock = model.structure.trials
        travel = float(np.ptp(data.measured * data.scale, axis=0).max())
        rms = np.sqrt((model.of_trials**2).mean(axis=0))
        return {
            "offset": offset * travel * float(np.linalg.norm(rms[: data.counted])),
            "gain": gain * float(rms[d]),
            "pressure_kpa": zero * p * float(rms[d + 1]),
            "clock_s": clock * float(rms[d + 2]),
        }

    def ladder(self) -> list[tuple[str, FittedModel]]:
        out, had = [], set(self.study.twin_effects)
        for i, s in enumerate(self.done.found.path):
            effects = s.model.structure.effects
            new = [e for e in effects if e not in had and (i > 0 or e not in self.done.space.base)]
            label = " + ".join(["how it bends" if i == 0 else "", *new]).strip()
            out.append((label, self.study.fitted(s.model)))
            had |= set(effects)
        return [*out[:-1], ("all that was found", self.after)]

    def contenders(self) -> list[Candidate]:
        """The final model, others of other physics, and the twin as it is, re-fitted.

        Others are up to `MOST_OTHERS` that the search weighed where it accepted its last terms, and the final
        model re-fitted without each of its terms.
        """
        study, start, done = self.study, self.start, self.done
        known = {*done.space.base, *study.twin_effects}
        weighed = (sorted(each, key=lambda s: s.value) for each in reversed(done.found.rivals))
        others = [*reversed(done.found.path), *chain.from_iterable(weighed)]
        scored = _differing([done.model], others, known)[: 1 + T.MOST_OTHERS]
        scored = _differing(scored, done.without.values(), known)
        return contenders(
            [*scored, start],
            self.search.bootstrap,
            known,
            lambda s: (study.fitted(s.model) if s is start else self.with_air(s.model)).twin,
        )

    def base(self) -> dict:
        """How the device bends before any effect."""
        model, done = self.final, self.done
        parts = [e for e in model.structure.effects if e in done.space.base and e not in done.terms]
        values = {k: v for k, v in model.values.items() if "." not in k}
        values |= {k: v for k, v in model.values.items() if _of(k) in parts}
        switch = model.structure.input_model.switch
        return {
            "joints": model.structure.joints,
            "profile": "its own" if model.structure.own_profile else "the paper's",
            "trials_begin": model.structure.input_model.start,
            "switch_share": None if switch is None else float(np.nanmedian(np.array(switch, dtype=float))),
            "driven_by": "measured pressure" if done.driven else "command",
            "parameters": values,
        }

    def tested(self) -> list[Tested]:
        """What each effect does alone: those found, then the best of the others, from the first round."""
        study, done, first = self.study, self.done, {}
        ground = done.found.base.model
        for s in [*done.found.path[1:2], *(done.found.rivals[0] if done.found.rivals else [])]:
            new = [e for e in s.model.structure.effects if e not in ground.structure.effects]
            if len(new) == 1:
                first.setdefault(new[0], study.fitted(s.model))
        bare, out = study.fitted(ground), []
        how = "pose, driven by the measured pressure" if done.driven else "pose, driven by the command"
        for name in (*done.terms, *(e for e in first if e not in done.terms)):
            model = first.get(name)
            if model is None and name in done.importance and name in done.space.candidates:
                structure = ground.structure.plus(name.partition(" #")[0])
                trials = [done.space.trial(structure, ground.values, name, s) for s in starts(name)]
                fits = self.search.engine(done.space).fits(trials, 8)
                model = study.fitted(fits[0].model) if fits else None
            if model is not None:
                out.append(study.alone(name, model, bare, how, model.effects[-1]))
        return out

    def evidence(self, left: np.ndarray) -> Evidence:
        """What the verdict rests on; `left` (n,) are squared errors without what runs have of their own."""
        study, done, test = self.study, self.done, self.study.test
        data = BodyData.of(study.recording, study.twin, source="command")
        seen = data.measured[:, : data.counted]
        constant = ((seen - seen[~study.parts.test].mean(axis=0)) ** 2).sum(axis=1)
        worst = min(test.value(self.before.squared), test.value(constant))
        if self.final.structure.trials:  # what zeros of trials take away, no law did
            own = study.residual_with_runs(done.found.base.model)
            worst = min(worst, test.value((own**2).sum(axis=1)))
        return study.evidence(
            self.before,
            self.after,
            done.terms,
            done.chosen_in,
            worst=worst,
            left=left,
            cancelling=_cancelling(study, self.after, done.terms),
            forward=done.forward,
            later=done.later,
            program=done.program,
            unseen=done.unseen or self.unseen(),
            where=study.where(self.after),
        )

    def unseen(self) -> str:
        """What the recording does not show of an effect found, a clause; empty where it shows all.

        How stiff a finger is to its side, its bending in its plane does not show. How warm a device that
        follows the temperature minutes late begins a run, depends on how long it rested before. A drift that
        is slower than the recording is seen once, and in part.
        """
        recording, model = self.study.recording, self.after
        samples, late = recording.samples, model.twin.effects.get(LATE_TEMPERATURE)
        stated = set(recording.meta.get("trials", {}))
        if late and late["time_s"].value > LATE_S and not set(samples["trial"].astype(str)) <= stated:
            return "how long it rested before each run, which sets how warm it begins, is not recorded"
        times = [v["time_s"].value for n, v in model.twin.effects.items() if n.startswith(DRIFT)]
        if times and max(times) > 60 * recorded_min(recording):
            return (
                f"the device drifts over {max(times):.0f} s, longer than the recording, so that neither the "
                "drift's end nor where it begins on another day is known"
            )
        sideways = samples.get("gravity_y")
        if recording.device != "finger" or "gravity" not in model.effects or sideways is None:
            return ""
        if not recording.has("tip_y_mm") or sideways.abs().max() > T.GRAVITY_CHANGE:
            return ""
        return (
            "the base was never turned to its side, so that how far its weight bends it that way is not known"
        )


def shown_by_gauge(study: "BodyStudy", done: Searched, cause: str, found: Iterable[str]) -> bool | None:
    """Whether the measured pressure shows a cause in the air; None where it does not decide.

    It shows it where its own model has such air, and none that was not found from the pose: a leak can pass
    for a lag there. How a valve limits the flow is one kind, which the pose and the pressure may fit best by
    different equations.
    """
    if done.air is None:
        return None
    final, kind = done.air.final, lambda f: FLOWS[0] if f in FLOWS else f
    seen = {kind(family(e)) for e in final.model.structure.effects if e not in study.twin_effects}
    if not seen:
        return False if np.sqrt(final.value) <= T.NOISE * study.air_noise else None
    return True if kind(cause) in seen <= set(map(kind, found)) else None


def _differing(first: list[Scored], more: Iterable[Scored], known: set[str]) -> list[Scored]:
    """The first, then of the others one of each kind of physics that none before it has."""
    out, kinds = list(first), {frozenset(), *(_kinds(s, known) for s in first)}
    for s in more:
        if _kinds(s, known) not in kinds:
            kinds.add(_kinds(s, known))
            out.append(s)
    return out


def _kinds(scored: Scored, known: set[str]) -> frozenset[str]:
    return frozenset(family(e) for e in scored.model.structure.effects if e not in known)


def _cancelling(study: "BodyStudy", model: FittedModel, terms: Sequence[str]) -> list[str]:
    """Laws each of which moves the device by more than it travels."""
    data = read(study.recording, model.twin)
    seen, out = predict(model.twin, data)[0], []
    travel = np.linalg.norm(np.ptp(data.measured[:, : data.counted], axis=0))
    for name in filter(is_law, terms):
        moved = seen - predict(model.twin.without(name), data)[0]
        if np.linalg.norm(moved, axis=1).max() > travel:
            out.append(name)
    return out
