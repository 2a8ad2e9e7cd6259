"""The search for what a finger or an arm lacks: air from the measured pressure, body from the pose."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.ndimage import gaussian_filter1d

from lerobot_pneutac.diagnosis import thresholds as T
from lerobot_pneutac.diagnosis.bootstrap import BlockBootstrap, conditions, out_of_time
from lerobot_pneutac.diagnosis.result import CURVE_LIKE
from lerobot_pneutac.diagnosis.search import Found, Scored, Search, Start, chosen_in, deal_folds
from lerobot_pneutac.study.body_base import COMES_WITH, BodyBase, base_effects, doubt
from lerobot_pneutac.study.body_model import BodyFitter, BodyModel, BodyStructure, InputModel
from lerobot_pneutac.study.body_space import ACTUATIONS, BodySpace
from lerobot_pneutac.study.data_breaks import Break, change_break, mount_break, slip_break
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.laws import family
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.finger.instants import step_rows

MOST_ROWS = 1700  # of the learning part that fits use
SMOOTH_SAMPLES = 2.0
# What changes within minutes, and may stand in for a temperature that the device follows late.
DRIFTS = ("thermal", "p dT", "p lag(dT)", "p exp(-t)", "p path(p)", "p damage(p)")
LATE_TEMPERATURE, LATE_S = "p lag(dT)", 60.0  # the law, and from which time constant it is late at all
LATE_PAUSES_S = (0.0, 15.0)  # between trials, from which a fit of it begins
TRIAL_WIDTHS = ((0.01, 0.02, 0.02, 0.01), (0.04, 0.06, 0.06, 0.02))  # tried, see `BodyStructure.trials`


@dataclass
class Searched:
    """What was found."""

    space: BodySpace  # in which it was searched
    found: Found  # path and final model, of the whole device or of its body
    model: Scored  # the final model, its base made as simple as it may be
    air: Found | None = None  # of the measured pressure, where there is one
    driven: bool = False  # whether the body was driven by the measured pressure
    terms: list[str] = field(default_factory=list)  # effects found, the most important first
    # of each, rise of the mean square error without it
    importance: dict[str, float] = field(default_factory=dict)
    # of each of the body, the model re-fitted without it
    without: dict[str, Scored] = field(default_factory=dict)
    chosen_in: dict[str, float] = field(default_factory=dict)  # of each, share of the votes
    forward: bool = True  # whether it holds for the later part when fitted to the earlier one
    # error over noise of the later part, fitted to the earlier one; None where there is none
    later: float | None = None
    # the same of programs, each by a fit to all others; None where fewer than two are named
    program: float | None = None
    unseen: str = ""  # what the recording does not show of an effect found, a clause; empty where nothing
    # effects of the body without which it fits as well where the measured pressure drives it
    needless: frozenset[str] = frozenset()


class BodySearch:
    """One search of a study; `run` is like `map`, and `report` is called with a line of progress.

    `left_out` has causes that lowered the error and yet were left out, and why, see `body_base.doubt`.
    """

    def __init__(self, study: BodyBase, run: Callable, report: Callable[[str], None]):
        self.study, self.run, self.report = study, run, report
        self.left_out: dict[str, str] = {}
        learn = np.flatnonzero(study.parts.learnt)
        self.rows = learn[:: max(1, len(learn) // MOST_ROWS)]
        if "time_sent_s" in study.recording.samples:
            # What is quick in the air shows in a sample or two after a step alone, in few of all rows.
            steps = step_rows(study.recording)
            self.rows = np.union1d(self.rows, np.intersect1d(np.r_[steps, steps + 1], learn))
        self.unit = study.parts.unit[self.rows]
        self.fold = deal_folds(self.unit, 5, study.seed)
        self.bootstrap = BlockBootstrap(
            np.ones(len(self.rows), bool), self.unit, study.parts.stratum, study.seed
        )
        self.condition = conditions(study.recording)[self.rows]

    def find(self) -> Searched | None:
        """Looks for what the twin lacks; None where the recording was amended: then it must start again."""
        study = self.study
        air = self._air() if study.measured else None
        done = self._body(study.recording, InputModel(start=study.start), air)
        if done is None:
            return None
        if air is not None and np.sqrt(air.final.value) > T.NOISE * max(study.air_noise, 1e-9):
            driven = self._driven(air)
            other = self._body(driven, InputModel(source="measured", start=study.start), None)
            assert other is not None  # a recording is amended by what the command leaves
            done.needless = self._needless(done, other)
            close = other.model.value < T.GAUGE_BETTER * done.model.value
            if close and self._foreseen(other, air) < T.AS_WELL * self._foreseen(done):
                done = replace(other, driven=True)
        done.air = air
        return self._told(done)

    def _foreseen(self, done: Searched, air: Found | None = None) -> float:
        """Mean square error from the command alone, of a body driven by the measured pressure with its air.

        Close to the pose by the gauge is no use where nothing is known of how the pressure comes about.
        """
        model = done.model.model
        twin = self.study.twin_with(model) if air is None else self.study.with_air(model, air.final.model)
        return float((self.study.residual(twin)[self.rows] ** 2).sum(axis=1).mean())

    def _needless(self, done: Searched, driven: Searched) -> frozenset[str]:
        """Effects of `Searched.needless`: their cause lies between the command and the measured pressure."""
        known = {*self.study.twin_effects, *base_effects(self.study)}
        of_air = {family(e) for e in self.study.candidates if get_effect(e).of_air}
        found, enough = (
            {
                e: family(e)
                for e in s.model.model.structure.effects
                if e not in known and family(e) not in of_air
            }
            for s in (done, driven)
        )
        as_well = driven.model.value < T.AS_WELL * done.model.value
        if not as_well or not set(enough.values()) <= set(found.values()):
            return frozenset()
        return frozenset(e for e, kind in found.items() if kind not in enough.values())

    def as_it_is(self) -> Scored:
        study = self.study
        fitter = BodyFitter(study.recording, study.twin, self.rows)
        own = any(n.startswith("bend_") for n in study.twin.parameters)
        switch = study.twin.parameters.get("switch_share")
        input_model = InputModel(start=study.start, switch=switch.value if switch else None)
        structure = BodyStructure(
            tuple(study.twin_effects), input_model, len(study.twin.spine_joint_positions_mm), own
        )
        space = BodySpace(fitter, study.twin_effects, [structure.joints], [], ((),), structure.input_model)
        models = [fitter.fit(structure, v, 12) for v in ({}, fitter.rough(structure))]
        return min((self.score(space.refine_actuation(m)) for m in models), key=lambda s: s.value)

    def take_back_slip(self, found: Scored) -> bool:
        """Corrects a slip of the marker that what a model leaves shows; whether it did."""
        study = self.study
        if len(study.findings) - study.checked >= T.MOST_SLIPS:
            return False
        residual = study.fitted(found.model).residual
        return study.amend(slip_break(study, self.rows, self.bootstrap, self.score, found, residual))

    # ---------------------------------------------------------------- stages

    def engine(self, space: BodySpace, floor: float | None = None, unit: str = "") -> Search:
        """Searches a space; by the study's noise and unit where no others are given."""
        floor, unit = self.study.noise.floor if floor is None else floor, unit or self.study.unit
        report = lambda text: self.report(f"{text} {unit}")  # noqa: E731
        return Search(space, self.bootstrap, self.fold, floor, self.run, report, self.condition)

    def _air(self) -> Found:
        """What lies between command and measured pressure."""
        study = self.study
        fitter = BodyFitter(study.recording, study.twin, self.rows)
        own = tuple(e for e in study.twin_effects if get_effect(e).stage == "pneumatics")
        candidates = [e for e in study.candidates if get_effect(e).stage == "pneumatics"]
        joints = len(study.twin.spine_joint_positions_mm)
        input_model = InputModel(target="pressure", start=study.start)
        space = BodySpace(fitter, own, [joints], candidates, _actuations(own, study.excluded), input_model)
        found = self.engine(space, study.air_noise, "kPa").find()
        refined = self.score(space.refine_air(found.final.model))
        found.final = min(found.final, refined, key=lambda s: s.value)
        return found

    def _driven(self, air: Found) -> Recording:
        """The recording with the best guess of the true pressure: the modelled one and the smoothed rest."""
        study, model = self.study, air.final.model
        fitter = BodyFitter(study.recording, study.twin, self.rows)
        predicted = fitter.predict(model)
        samples = study.recording.samples.copy()
        measured = samples[study.measured].to_numpy(float)
        rest = measured - predicted
        for rows in study.recording.trials().values():
            rest[rows] = gaussian_filter1d(rest[rows], SMOOTH_SAMPLES, axis=0, mode="nearest")
        samples[study.measured] = predicted + rest
        return replace(study.recording, samples=samples)

    def _body(self, recording: Recording, input_model: InputModel, air: Found | None) -> Searched | None:
        """What was found from the pose; None if the recording was amended."""
        study = self.study
        fitter = BodyFitter(recording, study.twin, self.rows)
        of_air = (
            [e for e in study.twin_effects if get_effect(e).of_air]
            if input_model.source == "measured"
            else []
        )
        own = tuple(e for e in study.twin_effects if e not in of_air)
        base = (*own, *(e for e in base_effects(study) if e not in own))
        joints = sorted({len(study.twin.spine_joint_positions_mm), study.joints})
        candidates = [c for c in study.candidates if c not in base and get_effect(c).stage != "pneumatics"]
        actuations, values, switch = _actuations(own, study.excluded), {}, None
        if input_model.source == "measured":
            actuations = ((),)
        elif air is not None:
            gauged = tuple(
                e for e in air.final.model.structure.effects if e not in own and get_effect(e).of_air
            )
            values = {k: v for k, v in air.final.model.values.items() if k.rpartition(".")[0] in gauged}
            switch = air.final.model.structure.input_model.switch
            actuations = (*actuations, gauged) if gauged and gauged not in actuations else actuations
        space = BodySpace(fitter, base, joints, candidates, actuations, input_model, values, switch)
        found = self.engine(space).find()
        if input_model.source == "command" and (
            self.take_back_slip(found.final) or study.amend(change_break(study, self.rows, found.final))
        ):
            self.report(f"{study.findings[-1].partition(':')[0]}; the search starts again")
            return None
        differ = self._trials_differ(space, found)
        if differ and input_model.source == "command" and study.amend(self._mounts(differ.model)):
            self.report("runs differ in how they were mounted; the search starts again")
            return None
        plain = self.simplified(space, found, own)
        if differ:
            # An offset of a run also absorbs what differs from run to run for a reason, such as a payload:
            # the known causes that are needed without offsets stay, and only runs that were left out decide.
            self.report("each run seems to have its own offset; the search starts again with run offsets")
            causes = tuple(e for e in plain.model.structure.effects if e in base_effects(study))
            left_out, space.trials = dict(self.left_out), differ.model.structure.trials
            space.required = space.base
            with_offsets = self.engine(space).find()
            needed = (*own, *(e for e in causes if e not in own))
            simple, fold = self.simplified(space, with_offsets, needed), fitter.trial[self.rows]
            alone, better = (float(s.model.cv_squared(fold).mean()) for s in (plain, simple))
            if better < alone:
                own, found, plain = needed, with_offsets, simple
            else:
                self.left_out, space.trials, space.required = left_out, (), own
        finished = self.without_idle(space, self._refined(space, plain, found), own)
        finished, unseen = self._late_temperature(space, finished)
        finished = self.engine(space).pruned(finished, found, T.WORTH_NAMING)
        for term in (t for t in CURVE_LIKE if t in own and t not in finished.model.structure.effects):
            self.left_out.setdefault(term, self._replaced(term))
        return Searched(space, found, finished, unseen=unseen)

    def _late_temperature(self, space: BodySpace, model: Scored) -> tuple[Scored, str]:
        """The model that follows the temperature late where that predicts better, and whether it is open.

        A lag of minutes goes on in the pauses between trials. A search in which trials begin settled ranks it
        below a drift, or below a temperature without lag, that fits this recording alone.
        """
        structure, values = model.model.structure, model.model.values
        new = (e for e in structure.effects if e not in self.study.twin_effects)
        drifts = [e for e in new if e.partition(" #")[0] in DRIFTS]
        if not drifts or LATE_TEMPERATURE not in space.candidates:
            return model, ""
        values = values | {f"{LATE_TEMPERATURE}.time_s": 2 * LATE_S, f"{LATE_TEMPERATURE}.weight": 0.1}
        with_late = structure.without(*drifts).plus(LATE_TEMPERATURE)
        begins = [replace(structure.input_model, start=pause) for pause in LATE_PAUSES_S]
        engine = self.engine(space)
        fits = engine.fits([(replace(with_late, input_model=begin), values) for begin in begins], 12)
        late = min(fits, key=lambda s: s.value, default=model)
        if late is model or late.model.values[f"{LATE_TEMPERATURE}.time_s"] < LATE_S:
            return model, ""
        late = min(late, self.score(space.refine(late.model)), key=lambda s: s.value)
        if late.value < model.value and engine.is_significant(model, late):
            return late, ""
        if (
            LATE_TEMPERATURE in drifts
            or engine.is_significant(late, model)
            or late.value > model.value * (1 + T.WORTH_OF_NOISE)
        ):
            return model, ""
        return model, (
            "that the device follows the temperature minutes late explains this recording as well, and would "
            "predict another course of the temperature differently"
        )

    def without_idle(self, space: BodySpace, model: Scored, chosen: Sequence[str]) -> Scored:
        """The model without terms that ended where they do nothing, at the same instants of steps.

        A term that is as quick as the samples can show may still be needed, see `Search.is_needed`. A known
        cause of the twin goes too where an effect was found with which it is worth no more than one that
        calibration leaves out: it stood in for that effect.
        """
        own, causes, engine = self.study.twin_effects, base_effects(self.study), self.engine(space)
        for term in model.model.structure.effects:
            effects = model.model.structure.effects
            replaced = term in causes and term in own and not set(effects) <= set(own)
            if not replaced and (term in chosen or not space.idle(model.model, term)):
                continue
            bare = self.score(space.bare(model.model, term))
            worth = replaced and bare.value > (1 + T.WORTH_OF_CAUSE) * model.value
            if worth or engine.is_needed(bare, model):
                continue
            model = bare
            if replaced:
                self.left_out[term] = self._replaced(term)
        return model

    def _replaced(self, term: str) -> str:
        return (
            f"{term.replace('_', ' ')} of the twin hardly lowers the error of this recording once what was "
            "found is added, and is left out then."
        )

    def _refined(self, space: BodySpace, model: Scored, found: Found) -> Scored:
        """The model with its air fitted to the moments after steps, or another actuation if it is worth it.

        Where the actuation was chosen before all terms were known, others are looked for again.
        """
        engine, last = self.engine(space), found.actuated
        if last and set(last.model.structure.effects) == set(model.model.structure.effects):
            others = engine.fits([_with_air_of(model.model, s.model) for s in found.others[:2]], 8)
        else:
            others = engine.other_actuations(model)
        own, *others = self.run(
            lambda s: min(s, self.score(space.refine_air(s.model)), key=lambda s: s.value),
            (model, *others[:2]),
        )
        best = min(others, key=lambda s: s.value, default=own)
        return best if engine.is_worth(own, best) else own

    def _mounts(self, model: BodyModel) -> Break | None:
        """Runs that were mounted differently, by a model in which each run has its own offset; asked once."""
        study = self.study
        if any("motions" in b for b in study.breaks):
            return None
        fitter, offsets = BodyFitter(study.recording, study.twin, self.rows), model.of_trials.shape[1] - 3
        own = replace(model, of_trials=model.of_trials * (np.arange(offsets + 3) >= offsets))
        bare = replace(model, of_trials=np.zeros_like(model.of_trials))
        return mount_break(study, fitter.predict(bare), fitter.predict(own), study.remounted)

    def _trials_differ(self, space: BodySpace, found: Found) -> Scored | None:
        """The final model with what trials have of their own, if that explains a good part of what it leaves.

        Of the widths tried, those that predict best what no fit saw.
        """
        now, noise_mse = found.final, self.study.noise.floor**2
        if now.value < T.CLOSE**2 * noise_mse or self.study.recording.samples["trial"].nunique() < T.FEW_RUNS:
            return None
        structure, values = now.model.structure, now.model.values
        tried = self.engine(space).fits([(replace(structure, trials=w), values) for w in TRIAL_WIDTHS], 8)
        if not tried:
            return None
        best = tried[0]
        differ = now.value - best.value > T.RUNS_WORTH * (now.value - noise_mse)
        return best if differ and self.engine(space).is_significant(now, best) else None

    def simplified(self, space: BodySpace, found: Found, own: tuple[str, ...]) -> Scored:
        """The final model with the paper's base, and without parts of the base, where that is as good."""
        search = self.engine(space)
        final = found.final
        noise_mse = self.study.noise.floor**2
        plain, chosen = self.plain(space, final.model), final
        if plain is not None:
            excess = max(found.base.value - noise_mse, 0.0)
            drop, needed = (
                plain.value - final.value,
                search.is_significant(plain, final),
            )
            if not needed or drop < max(T.PLAIN_OF_EXCESS * excess, T.PLAIN_OF_NOISE * noise_mse):
                chosen = plain
        space.required = own
        chosen = search.pruned(chosen, found)
        while doubts := self.doubts(space, chosen, found.without):
            self.left_out |= doubts
            models = {t: space.without(chosen.model, t) for t in doubts}
            chosen = search.pruned(min(map(self.score, models.values()), key=lambda s: s.value), found)
        return chosen

    def doubts(self, space: BodySpace, fitted: Scored, without: Mapping[str, Scored]) -> dict[str, str]:
        """Causes of a fitted model that may stand in for something else, and why.

        `without` has the model re-fitted without each term that is judged.
        """
        model, fitter, out = fitted.model, space.fitter, {}
        data = fitter.data(model.structure.input_model)
        scale = data.scale[: data.counted]

        def predict(recording: Recording) -> np.ndarray:
            changed = BodyFitter(recording, fitter.twin, fitter.rows)
            return changed.predict(model)[:, : data.counted] * scale

        residual = data.measured[:, : data.counted] * scale - predict(fitter.recording)
        for t in without:
            if t in model.structure.effects and t in (*COMES_WITH, *base_effects(self.study)):
                squared = without[t].cv_squared, fitted.cv_squared
                out[t] = doubt(t, fitter.recording, predict, residual, self.rows, *squared)
        return {t: sentence for t, sentence in out.items() if sentence}

    def plain(self, space: BodySpace, model: BodyModel) -> Scored | None:
        """The model re-fitted with the paper's bend profile; None where it cannot be fitted."""
        structure = replace(model.structure, own_profile=False)
        values = {k: v for k, v in model.values.items() if not k.startswith(("bend_", "curl"))}
        trials = [(structure, values), (structure, values | space.fitter.rough(structure))]
        first = self.engine(space).fits(trials, 12)
        again = [(structure, s.model.values) for s in first]  # the profile's place is taken by slow steps
        return min((*first, *self.engine(space).fits(again, 24)), key=lambda s: s.value, default=None)

    # ---------------------------------------------------------------- what it means

    def _told(self, done: Searched) -> Searched:
        """Which terms count as found, how certain each is, and what is left."""
        study, space, model = self.study, done.space, done.model
        own = set(study.twin_effects)
        terms = [e for e in model.model.structure.effects if e not in own]
        known = done.found.without  # of the finished model, see `_body`
        without = {t: known.get(t) or self.score(space.without(model.model, t)) for t in terms}
        done.without = without
        done.importance = {t: s.value - model.value for t, s in without.items()}
        if done.air is not None and done.driven:
            terms += [e for e in done.air.final.model.structure.effects if e not in own]
            done.importance |= {e: 0.0 for e in terms if e not in done.importance}
        done.terms = sorted(terms, key=lambda t: (t == "base_tilt", -done.importance[t]))
        done.chosen_in = dict.fromkeys(terms, 1.0) | {
            t: share
            for t, share in chosen_in(done.found, self.unit, study.noise.floor, family).items()
            if t in terms
        }
        done.forward, done.later = self._out_of_time(done)
        done.program = self._other_programs(done.model)
        return done

    def score(self, model: BodyModel) -> Scored:
        cv_squared = model.cv_squared(self.fold)
        return Scored(model, cv_squared, self.bootstrap.value(cv_squared))

    def _other_programs(self, model: Scored) -> float | None:
        """Error over noise of programs, each predicted by a fit to all others; None of fewer than two.

        Rows of a condition, such as a load, that no other program has stay in the fit.
        """
        samples, noise_mse = self.study.recording.samples, self.study.noise.floor**2
        if "program" not in samples or noise_mse == 0:
            return None
        fold = np.unique(samples["program"].to_numpy(str)[self.rows], return_inverse=True)[1]
        seen = [np.isin(self.condition, self.condition[fold != k]) for k in range(fold.max() + 1)]
        fold = np.where(np.array(seen)[fold, np.arange(len(fold))], fold, -1)
        rows = fold >= 0
        return float(np.sqrt(model.model.cv_squared(fold)[rows].mean() / noise_mse)) if rows.any() else None

    def _out_of_time(self, done: Searched) -> tuple[bool, float | None]:
        """How the model, fitted to the first 60 % of the rows, predicts the rest.

        Returns:
            Whether at least half of the fall of the error stays there, and the error over the noise; None
            where that is unknown or no later row has a condition that occurred before.
        """
        fold = out_of_time(self.condition, int(T.FORWARD_ROWS * len(self.rows)))
        rows, noise_mse = fold == 0, self.study.noise.floor**2
        if not rows.any():
            return True, None
        after = float(done.model.model.cv_squared(fold)[rows].mean())
        later = float(np.sqrt(after / noise_mse)) if noise_mse > 0 else None
        fall = done.found.base.value - done.model.value
        if not done.terms or fall <= T.WORTH_OF_NOISE * noise_mse:
            return True, later  # the air was found before any term, and with it the base errs no more
        before = float(done.found.base.model.cv_squared(fold)[rows].mean())
        holds = before - after > T.FORWARD_FALL * fall * (before / max(done.found.base.value, 1e-12))
        return holds, later


def _with_air_of(model: BodyModel, other: BodyModel) -> Start:
    """The model with another one's air, which has the same effects besides."""
    structure, values = other.structure, dict(model.values)
    structure = replace(model.structure, effects=structure.effects, input_model=structure.input_model)
    for name, value in other.values.items():
        if (effect := name.rpartition(".")[0]) and get_effect(effect).stage == "pneumatics":
            values[name] = value
    return structure, values


def _actuations(own: tuple[str, ...], excluded: Iterable[str]) -> tuple[tuple[str, ...], ...]:
    """Lines of which nothing is in the twin already, or excluded."""
    return (
        (),
        *(actuation for actuation in ACTUATIONS if actuation and not set(actuation) & {*own, *excluded}),
    )
