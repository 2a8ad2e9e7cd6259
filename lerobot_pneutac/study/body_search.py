"""The search for what a finger or an arm lacks: air from the measured pressure, body from the pose."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import gaussian_filter1d

from lerobot_pneutac.diagnosis.bootstrap import Resampler
from lerobot_pneutac.diagnosis.parts import conditions, out_of_time
from lerobot_pneutac.diagnosis.search import WORTH_OF_FLOOR, Found, Scored, Search, Trial
from lerobot_pneutac.diagnosis.votes import chosen_in, deal_folds
from lerobot_pneutac.study.body_model import BodyFitter, BodyModel, Reading
from lerobot_pneutac.study.body_space import LINES, BodySpace
from lerobot_pneutac.study.one_device import keep_one_device, move_back
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.laws import family
from pneutac_sim.effects.registry import get_effect

if TYPE_CHECKING:
    from lerobot_pneutac.study.body import BodyStudy

MOST_ROWS = 1700  # of the learning part that fits use
JOINTS = 8  # tried where the twin has fewer
SMOOTH_SAMPLES = 2.0
TRIAL_WIDTHS = ((0.01, 0.02, 0.02, 0.01), (0.04, 0.06, 0.06, 0.02))  # tried, see `Form.trials`
AS_WELL = 1.1  # of the mean square error from the command: what a body driven by the gauge may leave more
NEAR = 1.4  # times the noise: what is nearer needs no trials that differ


@dataclass
class Searched:
    """What was found.

    Attributes:
        space: in which it was searched.
        found: path and final model, of the whole device or of its body.
        model: the final model, its base made as simple as it may be.
        air: of the measured pressure, where there is one.
        driven: whether the body was driven by the measured pressure.
        terms: effects found, the most important first.
        importance: of each, rise of the mean square error without it.
        without: of each of the body, the model re-fitted without it.
        chosen_in: of each, share of the votes.
        forward: whether it holds for the later part when fitted to the earlier one.
        black_box: share of what is left that a black box removes.
    """

    space: BodySpace
    found: Found
    model: Scored
    air: Found | None = None
    driven: bool = False
    terms: list[str] = field(default_factory=list)
    importance: dict[str, float] = field(default_factory=dict)
    without: dict[str, Scored] = field(default_factory=dict)
    chosen_in: dict[str, float] = field(default_factory=dict)
    forward: bool = True
    black_box: float = 0.0


class BodySearch:
    """One search of a study.

    Args:
        study: of a finger or an arm.
        run: like `map`, perhaps in parallel.
        tell: called with a line of progress.
    """

    def __init__(self, study: "BodyStudy", run: Callable, tell: Callable[[str], None]):
        self.study, self.run, self.tell = study, run, tell
        learn = np.flatnonzero(study.parts.learnt)
        self.rows = learn[:: max(1, len(learn) // MOST_ROWS)]
        self.unit = study.parts.unit[self.rows]
        self.fold = deal_folds(self.unit, 5, study.seed)
        self.judge = Resampler(np.ones(len(self.rows), bool), self.unit, study.parts.stratum, study.seed)
        self.condition = conditions(study.recording)[self.rows]

    def find(self) -> Searched | None:
        """Looks for what the twin lacks; None where the recording was amended, so that it must begin anew."""
        study = self.study
        air = self._air() if study.measured else None
        done = self._body(study.recording, Reading(start=study.start), air)
        if done is None:
            return None
        if air is not None and np.sqrt(air.final.value) > 1.3 * max(study.air_noise, 1e-9):
            driven = self._driven(air)
            other = self._body(driven, Reading(source="measured", start=study.start), None)
            assert other is not None  # a recording is amended by what the command leaves
            close = other.model.value < 0.9 * done.model.value
            if close and self._foreseen(other, air) < AS_WELL * self._foreseen(done):
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

    # ---------------------------------------------------------------- stages

    def engine(self, space: BodySpace, floor: float | None = None, unit: str = "") -> Search:
        """Searches a space; by the study's noise and unit where no others are given."""
        floor, unit = self.study.noise.floor if floor is None else floor, unit or self.study.unit
        tell = lambda text: self.tell(f"{text} {unit}")  # noqa: E731
        return Search(space, self.judge, self.fold, floor, self.run, tell, self.condition)

    def _air(self) -> Found:
        """What lies between command and measured pressure."""
        study = self.study
        fitter = BodyFitter(study.recording, study.twin, self.rows)
        own = tuple(e for e in study.own if get_effect(e).stage == "pneumatics")
        candidates = [e for e in study.candidates if get_effect(e).stage == "pneumatics"]
        joints = len(study.twin.spine_joint_positions_mm)
        reading = Reading(target="pressure", start=study.start)
        space = BodySpace(fitter, own, [joints], candidates, _lines(own, study.excluded), reading)
        found = self.engine(space, study.air_noise, "kPa").find()
        settled = self.score(space.settle_air(found.final.model))
        found.final = min(found.final, settled, key=lambda s: s.value)
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

    def _body(self, recording: Recording, reading: Reading, air: Found | None) -> Searched | None:
        """What the pose tells; None where the recording was amended."""
        study = self.study
        fitter = BodyFitter(recording, study.twin, self.rows)
        of_air = [e for e in study.own if get_effect(e).of_air] if reading.source == "measured" else []
        own = tuple(e for e in study.own if e not in of_air)
        base = (*own, *(e for e in base_effects(study) if e not in own))
        joints = sorted({len(study.twin.spine_joint_positions_mm), study.joints})
        candidates = [c for c in study.candidates if c not in base and get_effect(c).stage != "pneumatics"]
        lines, values = _lines(own, study.excluded), {}
        if reading.source == "measured":
            lines = ((),)
        elif air is not None:
            told = tuple(e for e in air.final.model.form.effects if e not in own and get_effect(e).of_air)
            values = {k: v for k, v in air.final.model.values.items() if k.rpartition(".")[0] in told}
            lines = (*lines, told) if told and told not in lines else lines
        space = BodySpace(fitter, base, joints, candidates, lines, reading, values)
        found = self.engine(space).find()
        if reading.source == "command" and (
            move_back(study, self, found.final) or keep_one_device(study, self, found.final)
        ):
            self.tell(f"{study.findings[-1].partition(':')[0]}; the search begins anew")
            return None
        widths, plain = self._trials_differ(space, found), self.simplified(space, found, own)
        if widths:
            # An offset of a run also absorbs what differs from run to run for a reason, such as a payload:
            # the known causes that are needed without offsets stay, and only runs that were left out decide.
            self.tell("each run seems to have an offset of its own; the search begins anew with that")
            causes = tuple(e for e in plain.model.form.effects if e in base_effects(study))
            space.trials, space.kept = widths, space.base
            with_offsets = self.engine(space).find()
            fold = fitter.trial[self.rows]
            alone, better = (float(f.final.model.crossed(fold).mean()) for f in (found, with_offsets))
            if better < alone:
                own = (*own, *(e for e in causes if e not in own))
                found, plain = with_offsets, self.simplified(space, with_offsets, own)
            else:
                space.trials = ()
        return Searched(space, found, self._without_idle(space, self._settled(space, plain), own))

    def _without_idle(self, space: BodySpace, model: Scored, own: tuple[str, ...]) -> Scored:
        """The model without terms that ended where they do nothing, at the same instants of steps."""
        for term in model.model.form.effects:
            if term not in own and space.idle(model.model, term):
                form, values = model.model.form.without(term), model.model.values
                model = self.score(space.fitter.fit(form, values, 8))
        return model

    def _settled(self, space: BodySpace, model: Scored) -> Scored:
        """The model with its air fitted to the moments after steps, or another line if surely better.

        The line was chosen before all terms were known.
        """
        best = model
        for air in (model, *self.engine(space).other_lines(model)[:2]):
            settled = self.score(space.settle_air(air.model))
            best = min(best, air, settled, key=lambda s: s.value)
        better = best.model.form == model.model.form or self.judge.surely(model.crossed, best.crossed)
        return best if better else model

    def _trials_differ(self, space: BodySpace, found: Found) -> tuple[float, ...]:
        """Widths of what trials have of their own if that explains a good part of what a search leaves.

        Of the widths tried, those that predict best what no fit saw.
        """
        now, floor2 = found.final, self.study.noise.floor**2
        if now.value < NEAR**2 * floor2 or self.study.recording.samples["trial"].nunique() < 4:
            return ()
        form, values = now.model.form, now.model.values
        tried = self.engine(space).fits([Trial(replace(form, trials=w), values) for w in TRIAL_WIDTHS], 8)
        if not tried:
            return ()
        best = tried[0]
        differ = now.value - best.value > 0.3 * (now.value - floor2)
        return best.model.form.trials if differ and self.judge.surely(now.crossed, best.crossed) else ()

    def simplified(self, space: BodySpace, found: Found, own: tuple[str, ...]) -> Scored:
        """The final model with the paper's base, and without parts of the base, where that is as good."""
        search = self.engine(space)
        final = found.final
        floor2 = self.study.noise.floor**2
        plain, kept = self.plain(space, final.model), final
        if plain is not None:
            room = max(found.base.value - floor2, 0.0)
            drop, needed = plain.value - final.value, self.judge.surely(plain.crossed, final.crossed)
            if not needed or drop < max(0.01 * room, 0.03 * floor2):
                kept = plain
        space.kept = own
        return search.pruned(kept, found)

    def plain(self, space: BodySpace, model: BodyModel) -> Scored | None:
        """The model re-fitted with the paper's bend profile; None where it cannot be fitted."""
        form = replace(model.form, own=False)
        values = {k: v for k, v in model.values.items() if not k.startswith(("bend_", "curl"))}
        trials = [Trial(form, values), Trial(form, values | space.fitter.rough(form))]
        first = self.engine(space).fits(trials, 12)
        again = [Trial(form, s.model.values) for s in first]  # the profile's place is taken by slow steps
        return min((*first, *self.engine(space).fits(again, 24)), key=lambda s: s.value, default=None)

    # ---------------------------------------------------------------- what it means

    def _told(self, done: Searched) -> Searched:
        """Which terms count as found, how sure each is, and what is left."""
        study, space, model = self.study, done.space, done.model
        own = set(study.own)
        terms = [e for e in model.model.form.effects if e not in own]
        without = dict(self.run(lambda t: (t, self.score(space.without(model.model, t))), terms))
        done.without = without
        done.importance = {t: s.value - model.value for t, s in without.items()}
        if done.air is not None and done.driven:
            terms += [e for e in done.air.final.model.form.effects if e not in own]
            done.importance |= {e: 0.0 for e in terms if e not in done.importance}
        done.terms = sorted(terms, key=lambda t: (t == "base_tilt", -done.importance[t]))
        done.chosen_in = dict.fromkeys(terms, 1.0) | {
            t: share
            for t, share in chosen_in(done.found, self.unit, study.noise.floor, family).items()
            if t in terms
        }
        done.forward = self._holds_forward(done)
        return done

    def score(self, model: BodyModel) -> Scored:
        """A model with its worth."""
        crossed = model.crossed(self.fold)
        return Scored(model, crossed, self.judge.value(crossed))

    def _holds_forward(self, done: Searched) -> bool:
        """Fitted to the first 60 % of the rows, at least half of the fall of the error stays in the rest."""
        if not done.terms:
            return True
        fold = out_of_time(self.condition, int(0.6 * len(self.rows)))
        later = fold == 0
        if not later.any():
            return True
        before, after = (float(s.model.crossed(fold)[later].mean()) for s in (done.found.base, done.model))
        fall = done.found.base.value - done.model.value
        if fall <= WORTH_OF_FLOOR * self.study.noise.floor**2:
            return True  # the air was found before any term, and with it the base errs no more
        return before - after > 0.5 * fall * (before / max(done.found.base.value, 1e-12))


def base_effects(study: "BodyStudy") -> tuple[str, ...]:
    """Known causes that a study's recording shows, see `known_causes`."""
    return tuple(e for e in known_causes(study.recording) if e not in study.excluded)


def known_causes(recording: Recording) -> tuple[str, ...]:
    """Effects that belong to how any body bends: its mount, weight, load and stretch, as far as they show."""
    out = []
    tip = all(recording.has(f"tip_{a}_mm") for a in "xz")
    if tip:
        out.append("base_tilt")
    known = all(recording.has(f"gravity_{a}") for a in "xyz")
    if known and tip:
        g = recording.samples[[f"gravity_{a}" for a in "xyz"]].to_numpy(float)
        if np.ptp(g, axis=0).max() > 0.1:
            out.append("gravity")
        if recording.has("payload_g") and np.ptp(recording.column("payload_g")) > 1e-3:
            out.append("payload")
    if tip:
        out.append("elongation")
    return tuple(out)


def _lines(own: tuple[str, ...], excluded: Iterable[str]) -> tuple[tuple[str, ...], ...]:
    """Lines of which nothing is in the twin already, or excluded."""
    return ((), *(line for line in LINES if line and not set(line) & {*own, *excluded}))
