"""A recording of a finger or an arm under judgement; a sample is a row."""

import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from lerobot_pneutac.diagnosis.candidates import sort_candidates
from lerobot_pneutac.diagnosis.experiment import Separation, predict, separations
from lerobot_pneutac.diagnosis.law_programs import law_program
from lerobot_pneutac.diagnosis.model import FittedModel
from lerobot_pneutac.diagnosis.parts import deal
from lerobot_pneutac.diagnosis.result import Outcome, Rival, Tested
from lerobot_pneutac.diagnosis.search import Scored
from lerobot_pneutac.diagnosis.steps import Steps
from lerobot_pneutac.diagnosis.verdict import Evidence, decide, too_few
from lerobot_pneutac.study import gauge
from lerobot_pneutac.study.base import EffectStudy
from lerobot_pneutac.study.body_model import BodyFitter, BodyModel, Form, Reading
from lerobot_pneutac.study.body_search import BodySearch, Searched, base_effects, left_to_black_box
from lerobot_pneutac.study.body_space import BodySpace
from lerobot_pneutac.study.pair import LONGER, enough_rows
from lerobot_pneutac.study.reading import read
from lerobot_pneutac.study.slips import find_slip
from pneutac_datasets.recording.checks import check
from pneutac_datasets.recording.mounts import on_one_mount
from pneutac_datasets.recording.noise import headline, noise_floor
from pneutac_datasets.recording.recording import Recording
from pneutac_datasets.recording.tracker import where
from pneutac_sim.effects.laws import family, is_law, starts
from pneutac_sim.effects.registry import body_effects, get_effect, of_body
from pneutac_sim.finger.confidence import Z95, confidence
from pneutac_sim.finger.data import BodyData
from pneutac_sim.twin import Twin, Value

REPEAT = "Run the same program twice, an hour apart: what comes back is the device, what does not is the lab."
RESTED_S = 1e4  # a pause at zero pressure after which everything has rested
OF_TRIALS = (
    "Trials differ by small offsets, gains, zeros and clocks of their own, no part of the device: with "
    "what was found, errors are counted beside them (told by its learning rows), before it they are not."
)
EDGE = 1e-3
MOST_SLIPS = 3


class BodyStudy(EffectStudy):
    """Markers, angles or curvatures of a finger or an arm.

    Args:
        twin: of the recording's device.
        recording: of a finger or an arm.
        seed: decides the parts and every bootstrap.
        adding: the effects that are to be tried; empty where all are.

    Attributes:
        measured: columns of measured pressure, empty where it tells nothing.
        start: how trials are taken to begin, before a search asks.
        joints: of the spine, tried beside the twin's own number.

    Raises:
        InputError: the recording has too few rows to fit the twin at all, or is of another device.
    """

    unknown_where = "moves your {device}"
    more_data, repeat = LONGER, REPEAT
    nothing_left = "Nothing needs to be recorded; go to higher pressure to find where the twin ends."

    def __init__(self, twin: Twin, recording: Recording, seed: int = 0, adding: Sequence[str] = ()):
        self.twin, self.seed = twin, seed
        self.recording, self.findings = check(recording)
        self.parts = deal(self.recording, seed)
        self.own = tuple(of_body(twin.effects))
        self.candidates, self.untested = sort_candidates(self.recording, twin)
        if any(self.refusal(e) for e in adding):
            return
        largest = max(body_effects(), key=lambda e: len(get_effect(e).parameters))
        enough_rows(twin, self.recording, [*self.own, *(adding or [largest])], self.parts.train)
        self.recording, moved = on_one_mount(self.recording, twin, self.parts.train)
        self.findings = self.findings + moved
        self._checked = len(self.findings)
        self.noise = noise_floor(self.recording)
        self.unit = self.noise.unit
        self.measured = gauge.measured_columns(self.recording)
        data = BodyData.of(self.recording, twin, source="command")
        starts_vented = np.isinf(data.inputs.dt_s).sum() and not np.array_equal(data.inputs.rows[:1], [0])
        known = twin.parameters.get("pause_s")
        self.start: str | float = known.value if known else "vented" if starts_vented else "held"
        self.joints = 8 if twin.device == "finger" else len(twin.spine_joint_positions_mm)

    @property
    def air_noise(self) -> float:
        """Noise of the measured pressure, kPa."""
        return gauge.sensor_noise(self.recording, self.measured)

    # ---------------------------------------------------------------- models

    def fitted(self, model: BodyModel) -> FittedModel:
        """A model of the search, run on all samples from the command."""
        twin = self._twin(model)
        fitter = BodyFitter(self.recording, self.twin, np.zeros(1, int))
        data = fitter.data(model.form.reading)
        residual = (data.measured - fitter.predict(model))[:, : data.counted]
        names = [model.pipeline.names[i] for i in model.free]
        edge = (model.v < EDGE) | (model.v > 1 - EDGE)
        bound = [
            n for n, i, e, v in zip(names, model.free, edge, model.v, strict=True)
            if e and "." in n and n.rpartition(".")[0] not in base_effects(self)
            and (model.bounds.upper if v > 0.5 else model.bounds.lower)[i] != model.pipeline.specs[i].neutral
        ]  # fmt: skip
        return FittedModel(
            effects=model.form.effects, residual=residual, count=len(names), twin=twin, at_bound=bound
        )

    def _twin(self, model: BodyModel) -> Twin:
        """The twin with a model's parameters, their intervals, and how its recordings begin."""
        fitter = BodyFitter(self.recording, self.twin, np.zeros(1, int))
        edge = (model.v < EDGE) | (model.v > 1 - EDGE)
        adjacent = np.ones(len(model.residual), bool)
        more = np.zeros(model.jacobian.shape[1] - len(edge), bool)
        sd = confidence(model.jacobian, model.residual, adjacent, np.r_[edge, more]).sd[: len(edge)]
        low = model.bounds.value(np.clip(model.v - Z95 * sd, 0, 1), model.free)
        high = model.bounds.value(np.clip(model.v + Z95 * sd, 0, 1), model.free)
        names = [model.pipeline.names[i] for i in model.free]
        ci95 = {n: (float(a), float(b)) for n, a, b in zip(names, low, high, strict=True)}
        twin = model.pipeline.update(fitter.twin_with(model.form.joints), model.theta, ci95)
        reading = model.form.reading
        if reading.switch is not None:
            twin.parameters["switch_share"] = Value(
                float(np.nanmedian(np.array(reading.switch, dtype=float)))
            )
        if reading.start != "held":
            pause = RESTED_S if reading.start == "vented" else float(reading.start)
            twin.parameters["pause_s"] = Value(pause)
        return replace(twin, arrays={}, gel={}, history=[])

    def as_it_is(self, search: BodySearch) -> Scored:
        """The twin with its own effects, re-fitted."""
        fitter = BodyFitter(self.recording, self.twin, search.rows)
        own = any(n.startswith("bend_") for n in self.twin.parameters)
        switch = self.twin.parameters.get("switch_share")
        reading = Reading(start=self.start, switch=switch.value if switch else None)
        form = Form(tuple(self.own), reading, len(self.twin.spine_joint_positions_mm), own)
        space = BodySpace(fitter, self.own, [form.joints], [], ((),), form.reading)
        models = [fitter.fit(form, v, 12) for v in ({}, fitter.rough(form))]
        found = min((search._score(space.settle_line(m)) for m in models), key=lambda s: s.value)
        return self._slipped(search, found) or found

    def _slipped(self, search: BodySearch, found: Scored) -> Scored | None:
        """The same with a slip of the marker taken back; None where there surely is none."""
        was, model = (self.recording, self.findings), found.model
        columns, _ = headline(self.recording)
        J = model.jacobian.reshape(len(search.rows), -1, model.jacobian.shape[1])[:, : len(columns)]
        residual, trial = self.fitted(model).residual, np.asarray(self.recording.samples["trial"])
        slip = find_slip(residual, trial, search.rows, J.reshape(-1, J.shape[2]), self.noise.value)
        if slip is None or len(was[1]) - self._checked >= MOST_SLIPS:
            return None
        row, shift = slip
        samples = self.recording.samples.copy()
        samples.loc[samples.index[row:], columns] -= shift
        moved = ", ".join(f"{c} by {x:.3g}" for c, x in zip(columns, shift, strict=True))
        self.recording = replace(self.recording, samples=samples)
        self.findings = [
            *was[1],
            f"The marker slipped in {where(self.recording, row)}: from there on everything is seen "
            f"elsewhere, {moved}; rows from {row + 1} on are moved back for this judgement.",
        ]
        without = self.as_it_is(search)
        if search.judge.drop(found.crossed, without.crossed)[1] > 0:
            return without
        self.recording, self.findings = was
        return None

    def residual(self, twin: Twin) -> np.ndarray:
        """(n, k) measured minus predicted from the commanded pressure, each step at its own instant."""
        data = read(self.recording, twin)
        return data.measured[:, : data.counted] - predict(twin, data)[0]

    # ---------------------------------------------------------------- the verbs

    def search(self, jobs: int, steps: Steps) -> Outcome:
        """Looks for what the twin lacks."""
        began = time.perf_counter()
        with ThreadPoolExecutor(jobs) as pool:
            search = BodySearch(self, pool.map, lambda text: steps.expect(text, 0))
            steps.expect("fitting the twin as it is", 1)
            before = self.as_it_is(search)
            done = search.find()
            if done.model.model.form.trials:
                self.findings = [*self.findings, OF_TRIALS]
            steps.done()
            return self._outcome(search, before, done, began)

    def _outcome(self, search: BodySearch, start: Scored, done: Searched, began: float) -> Outcome:
        before = self.fitted(start.model)
        after = self._after(done, before)
        helps = search.judge.drop(start.crossed, done.model.crossed)[1] > 0
        helps = helps and self.test.value(after.squared) < self.test.value(before.squared)
        if not helps:
            after, done.terms = before, []
        else:
            done.black_box = left_to_black_box(self, after.residual)
        if not done.terms and helps is False:
            done.black_box = left_to_black_box(self, before.residual)
        evidence = self._evidence(before, after, done)
        ladder = [("as it is", before)]
        if helps:
            ladder += self._ladder(done, after)
        return Outcome(
            before=before,
            after=after,
            ladder=ladder,
            selected=done.terms,
            tested=self._tested(search, done, before),
            rivals=self._rivals(done),
            correlated=[],
            evidence=evidence,
            verdict=decide(evidence),
            twin=after.twin,
            seconds=time.perf_counter() - began,
            chosen_in=done.chosen_in,
            base_model=self._base(done) if helps else {},
        )

    def _after(self, done: Searched, before: FittedModel) -> FittedModel:
        if not done.driven:
            return self.fitted(done.model.model)
        body = self._twin(done.model.model)
        assert done.air is not None
        air = self._twin(done.air.final.model)
        body.effects = body.effects | {k: v for k, v in air.effects.items() if get_effect(k).of_air}
        return FittedModel(
            effects=tuple(body.effects),
            residual=self.residual(body),
            count=len(done.model.model.free),
            twin=body,
        )

    def _ladder(self, done: Searched, after: FittedModel) -> list[tuple[str, FittedModel]]:
        out, had = [], set(self.own)
        for i, s in enumerate(done.found.path):
            new = [e for e in s.model.form.effects if e not in had and (i > 0 or e not in done.space.base)]
            out.append(
                (" + ".join(["how it bends", *new] if i == 0 else ["", *new]).strip(), self.fitted(s.model))
            )
            had |= set(s.model.form.effects)
        return [*out[:-1], ("all that was found", after)]

    def _base(self, done: Searched) -> dict:
        """How it bends, in numbers."""
        model = done.model.model
        values = {k: v for k, v in model.values.items() if "." not in k}
        parts = [e for e in model.form.effects if e in done.space.base and e not in done.terms]
        values |= {k: v for k, v in model.values.items() if k.rpartition(".")[0] in parts}
        switch = model.form.reading.switch
        return {
            "joints": model.form.joints,
            "profile": "its own" if model.form.own else "the paper's",
            "trials_begin": model.form.reading.start,
            "switch_share": None if switch is None else float(np.nanmedian(np.array(switch, dtype=float))),
            "driven_by": "measured pressure" if done.driven else "command",
            "parameters": values,
        }

    def _tested(self, search: BodySearch, done: Searched, before: FittedModel) -> list[Tested]:
        """What each effect does alone: those found, then the best of the others, from the first round."""
        first: dict[str, FittedModel] = {}
        base = set(done.found.base.model.form.effects)
        rounds = [*done.found.path[1:2], *(done.found.rivals[0] if done.found.rivals else [])]
        for s in rounds:
            new = [e for e in s.model.form.effects if e not in base]
            if len(new) == 1:
                first.setdefault(new[0], self.fitted(s.model))
        ground = self.fitted(done.found.base.model)
        out = []
        how = "pose, driven by the measured pressure" if done.driven else "pose, driven by the command"
        for name in (*done.terms, *(e for e in first if e not in done.terms)):
            model = first.get(name)
            if model is None and name in done.importance and name in done.space.candidates:
                form = done.found.base.model.form.plus(name.partition(" #")[0])
                fits = search._search(done.space, self.noise.value).fits(
                    [done.space.trial(form, done.found.base.model.values, name, s) for s in starts(name)], 8
                )
                model = self.fitted(fits[0].model) if fits else None
            if model is None:
                continue
            share, interval = self.test.reduction(ground.squared, model.squared, self.noise.value)
            errors = {"heldout": float(np.sqrt(self.test.value(model.squared)))}
            out.append(Tested(name, errors, share, interval, self.parameters(model, model.effects[-1]), how))
        return out

    def _rivals(self, done: Searched) -> list[Rival]:
        """Models that were as good where a term was accepted, with another in its place."""
        out = []
        for taken, others, before in zip(
            done.found.path[1:], done.found.rivals, done.found.path, strict=False
        ):
            room = max(before.value - self.noise.value**2, 0.0)
            new = [e for e in taken.model.form.effects if e not in before.model.form.effects]
            for s in others:
                instead = [e for e in s.model.form.effects if e not in taken.model.form.effects]
                as_good = s.value - taken.value < 0.02 * room
                if as_good and len(new) == 1 and len(instead) == 1 and new[0] in done.terms:
                    if family(instead[0]) != family(new[0]):
                        share = s.value / max(taken.value, 1e-30) - 1
                        out.append(
                            Rival(new[0], instead[0], share, self.fitted(s.model), self.fitted(taken.model))
                        )
        return out[:3]

    def _evidence(self, before: FittedModel, after: FittedModel, done: Searched) -> Evidence:
        """What the verdict rests on: errors of test blocks, which nothing was fitted or chosen on."""
        test, floor = self.test, max(self.noise.value, 1e-12)
        data = BodyData.of(self.recording, self.twin, source="command")
        constant = data.measured[:, : data.counted] - data.measured[~self.parts.test, : data.counted].mean(
            axis=0
        )
        worst = min(test.value(before.squared), test.value((constant**2).sum(axis=1)))
        if done.model.model.form.trials:  # what zeros of trials take away, no law did
            worst = min(worst, test.value(self.fitted(done.found.base.model).squared))
        left = test.value(after.squared) - floor**2
        removed = 1 - max(left, 0.0) / (worst - floor**2) if worst > 1.02 * floor**2 else 0.0
        agreed = [done.chosen_in.get(t, 1.0) for t in done.terms[:1]]
        return Evidence(
            poor=bool(self.too_little()),
            before=float(np.sqrt(worst)) / floor,
            after=float(np.sqrt(test.value(after.squared))) / floor,
            selected=done.terms,
            removed=float(np.clip(removed, -1, 1)) if done.terms else 0.0,
            at_bound=[n for n in after.at_bound if n.rpartition(".")[0] in done.terms],
            cancelling=self._cancelling(after, done.terms),
            left_to_black_box=done.black_box,
            forward=done.forward,
            agreed=min(agreed, default=1.0),
            noise_known=self.noise.known,
        )

    def _cancelling(self, model: FittedModel, terms: Sequence[str]) -> list[str]:
        """Laws each of which moves the device by more than it travels."""
        data = read(self.recording, model.twin)
        seen, out = predict(model.twin, data)[0], []
        travel = np.linalg.norm(np.ptp(data.measured[:, : data.counted], axis=0))
        for law in filter(is_law, terms):
            others = {k: v for k, v in model.twin.effects.items() if k != law}
            moved = seen - predict(replace(model.twin, effects=others), data)[0]
            if np.linalg.norm(moved, axis=1).max() > travel:
                out.append(law)
        return out

    def refit(self, effects: Sequence[str], start: FittedModel | None, steps: Steps) -> FittedModel:
        """All parameters of the twin and of these effects, fitted to all but the test part.

        With new effects the body's own base is tried beside the paper's; the simpler is kept unless the other
        is surely better.
        """
        search = BodySearch(self, map, lambda text: None)
        if start is None:
            self._before = self.as_it_is(search)
            steps.done()
            return self.fitted(self._before.model)
        fitter = BodyFitter(self.recording, self.twin, search.rows)
        new = [e for e in effects if e not in self.own]
        base = (*self.own, *(e for e in base_effects(self) if e not in self.own and e not in new))
        space = BodySpace(
            fitter,
            base,
            [len(self.twin.spine_joint_positions_mm)],
            [],
            ((),),
            self._before.model.form.reading,
        )
        found = []
        for own, ground in ((self._before.model.form.own, self.own), (True, base)):
            form = replace(self._before.model.form, effects=tuple(ground), own=own)
            values = self._before.model.values
            for name in new:
                form = form.plus(name)
                fits = [space.trial(form, values, name, s) for s in starts(name)]
                best = search._search(space, self.noise.value).fits(fits, 8)
                if best:
                    values = best[0].model.values
            models = [space.settle(s.model) for s in best[:1]]
            found += [search._score(space.settle_line(m)) for m in models]
        plain, rich = found[0], found[-1]
        drop, low, _ = search.judge.drop(plain.crossed, rich.crossed)
        best = rich if low > 0 and drop > 0.03 * self.noise.value**2 else plain
        self._crossed = self._before.crossed, best.crossed, search.judge
        steps.done()
        return self.fitted(best.model)

    def fall(self, before: FittedModel, after: FittedModel) -> tuple[float, float, float]:
        """Fall of the mean square error on blocks that no fit saw: value, lower 1 % and upper 99 % bound."""
        a, b, judge = self._crossed
        return judge.drop(a, b)

    def refusal(self, effect: str) -> str:
        """Why an effect cannot be switched on."""
        if get_effect(effect).stage not in get_effect("creep").stages:
            return f"'{effect}' does not bend a body; give one of {', '.join(body_effects())}."
        untested = {u.name: f"{self.recording.folder}: effect '{effect}' {u.reason}." for u in self.untested}
        return self.already_on(effect) or untested.get(effect, "")

    def twin_of(self, model: FittedModel) -> Twin:
        """The fitted body with the gel, pictures and networks of the twin that was given."""
        kept = {k: v for k, v in self.twin.effects.items() if k not in of_body(self.twin.effects)}
        given = self.twin.copy()
        return replace(
            model.twin,
            effects=kept | model.twin.effects,
            gel=given.gel,
            arrays=given.arrays,
            history=given.history,
        )

    # ---------------------------------------------------------------- what it tells

    def parameters(self, model: FittedModel, effect: str) -> dict[str, dict]:
        """Parameters of one effect with interval and unit."""
        units = {p.name: p.unit for p in get_effect(effect).parameters}
        return {
            k: {"value": v.value, "ci95": list(v.ci95) if v.ci95 else None, "unit": units.get(k, "")}
            for k, v in model.twin.effects.get(effect, {}).items()
        }

    def size(self, model: FittedModel, effect: str) -> str:
        """What the effect does to the prediction that another gain and offset could not."""
        data = read(self.recording, model.twin)
        others = {k: v for k, v in model.twin.effects.items() if k != effect}
        seen, plain = (predict(t, data)[0] for t in (model.twin, replace(model.twin, effects=others)))
        ground = np.concatenate([plain, np.ones((len(plain), 1))], axis=1)
        left = seen - ground @ np.linalg.lstsq(ground, seen, rcond=None)[0]
        what = {"mm": "tip", "rad": "bend", "1/m": "curvature"}[self.unit]
        moved = np.linalg.norm(left, axis=1)
        typically = f"{np.sqrt((moved**2).mean()):.2g} {self.unit}"
        return f"That moves its {what} by {typically} typically and {moved.max():.2g} {self.unit} at most."

    def experiment(self, model: FittedModel, effect: str) -> str:
        """By the law's own program where it is one and was found."""
        constants = {k: v.value for k, v in model.twin.effects.get(effect, {}).items()}
        program = law_program(self.recording, effect, constants) if constants else None
        return program.advice if program else super().experiment(model, effect)

    def at_bound(self, model: FittedModel, effects: Sequence[str]) -> list[str]:
        """Parameters stopped by a bound."""
        return list(model.at_bound)

    @property
    def _moves(self) -> bool:
        """Whether the commanded pressure moves at all."""
        command = self.recording.samples[self.recording.pressure_columns].to_numpy(float)
        return bool(np.ptp(command, axis=0).max() > 1e-3)

    def too_little(self) -> str:
        """Why nothing can be told."""
        if not self._moves:
            return (
                "This recording cannot tell: the commanded pressure never moves, so nothing about bending "
                "can be learnt from it."
            )
        samples, units = int((~self.test.mask).sum()), self.test.units
        if not too_few(samples, units):
            return ""
        return (
            f"This recording is too short to tell anything: {samples} samples to fit and "
            f"{units} pieces of time to test on."
        )

    def caveats(self, outcome: Outcome) -> list[str]:
        """What is not explained, what the pressure tells, and whether there was a test part."""
        e, out = outcome.evidence, []
        if outcome.selected and e.objections:
            out.append(f"Not the whole truth: {'; '.join(e.objections)}.")
        if e.unfinished:
            out.append(
                f"Unfinished: {100 * e.left_to_black_box:.0f} % of what is left still follows the inputs, as "
                "a black box shows; a form is missing that neither library nor laws have."
            )
        if not e.noise_known:
            out.append(
                "The noise was neither declared nor measured by repeated programs; what a black box still "
                "removes takes its place."
            )
        if not self.measured:
            out.append(self._pressure_note())
        if not self.parts.has_test:
            out.append(
                "The recording is too short for a part of its own for the report; the errors are optimistic."
            )
        return out

    def _pressure_note(self) -> str:
        logged = [c.replace("cmd_", "") for c in self.recording.pressure_columns]
        if not all(map(self.recording.has, logged)):
            return (
                "The pressure was not measured, so a slow valve and a creeping body hide each other: a lag "
                f"may be creep in part. Log {', '.join(logged)} to tell them apart."
            )
        if self._moves:
            return (
                "The measured pressure hardly moves while the command does and was left aside; a slow valve "
                "and a creeping body hide each other: a lag may be creep in part."
            )
        moved = max(np.ptp(self.recording.column(c)) for c in logged)
        if moved > max(1e-3, 10 * gauge.sensor_noise(self.recording, logged)):
            return (
                "The measured pressure moves although the commanded one never does, so the model had nothing "
                "to follow: check that pressure_cmd_kpa is what was asked for."
            )
        return "The measured pressure does not move either."

    def how_tested(self, outcome: Outcome) -> str:
        """On what the candidates were tried."""
        if not self.measured:
            return "Effects of air and body are tried on the pose alike; no measured pressure is of use."
        return (
            "Effects of the air are tried on the measured pressure and on the pose, all others on the pose."
        )

    def separation(self, rival: Rival) -> Separation | None:
        """The experiment that tells two models apart best."""
        a, b, names = rival.winner.twin, rival.fit.twin, (rival.effect, rival.rival)
        return next(iter(separations(self.recording, a, b, self.noise.value, names)), None)

    def details(self, outcome: Outcome) -> dict:
        """What only a body's `result.json` has."""
        return {"measured_pressure": bool(self.measured), "base_model": outcome.base_model}
