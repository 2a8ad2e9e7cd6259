"""A recording of a finger or an arm under judgement; a sample is a row."""

import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from lerobot_pneutac.diagnosis.candidates import sort_candidates
from lerobot_pneutac.diagnosis.experiment import predict
from lerobot_pneutac.diagnosis.model import FittedModel
from lerobot_pneutac.diagnosis.parts import deal
from lerobot_pneutac.diagnosis.result import PROFILE, Contribution, Outcome, Refits
from lerobot_pneutac.diagnosis.search import Found, Scored, Trial
from lerobot_pneutac.diagnosis.steps import Steps
from lerobot_pneutac.study import gauge
from lerobot_pneutac.study.body_model import BodyFitter, BodyModel, Form, Reading
from lerobot_pneutac.study.body_outcome import body_outcome
from lerobot_pneutac.study.body_search import BodySearch, Searched, base_effects
from lerobot_pneutac.study.body_space import BodySpace
from lerobot_pneutac.study.body_words import BodyWords
from lerobot_pneutac.study.one_device import move_back
from lerobot_pneutac.study.pair import device_moves, enough_rows
from lerobot_pneutac.study.reading import read
from pneutac_datasets.recording.checks import check
from pneutac_datasets.recording.mounts import on_one_mount
from pneutac_datasets.recording.noise import noise_floor
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.laws import family, starts
from pneutac_sim.effects.registry import body_effects, get_effect, of_body
from pneutac_sim.finger.confidence import Z95, confidence
from pneutac_sim.finger.data import BodyData
from pneutac_sim.twin import Twin, Value

RESTED_S = 1e4  # a pause at zero pressure after which everything has rested
OF_TRIALS = (
    "Each run has its own small offset, gain and time shift. They are no part of the device and not in the "
    "twin; the error without them is reported separately."
)
EDGE = 1e-3


def _of(parameter: str) -> str:
    """The effect that a parameter of a pipeline belongs to."""
    return parameter.rpartition(".")[0]


class BodyStudy(BodyWords):
    """Markers, angles or curvatures of a finger or an arm.

    Args:
        twin: of the recording's device.
        recording: of a finger or an arm.
        seed: decides the parts and every bootstrap.
        adding: the effects that are to be tried; empty where all are.

    Attributes:
        measured: columns of measured pressure, empty where it tells nothing.
        checked: number of findings before a search.
        start: how trials are taken to begin, before a search asks.
        joints: of the spine, tried beside the twin's own number.
        breaks: corrections of the recording for this judgement, see `apply_break`.

    Raises:
        InputError: the recording has too few rows to fit the twin at all, or is of another device.
    """

    def __init__(self, twin: Twin, recording: Recording, seed: int = 0, adding: Sequence[str] = ()):
        self.twin, self.seed, self._given = twin, seed, recording
        self.breaks: tuple[dict, ...] = ()
        device_moves(recording)
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
        self.checked = len(self.findings)
        self.noise = noise_floor(self.recording)
        self.unit = self.noise.unit
        self.measured = gauge.measured_columns(self.recording)
        data = BodyData.of(self.recording, twin, source="command")
        starts_vented = np.isinf(data.inputs.dt_s).sum() and not np.array_equal(data.inputs.rows[:1], [0])
        known = twin.parameters.get("pause_s")
        self.start: str | float = known.value if known else "vented" if starts_vented else "held"
        self.joints = 8 if twin.device == "finger" else len(twin.spine_joint_positions_mm)

    @property
    def given_rows(self) -> int:
        """Rows of the recording as it was given."""
        return len(self._given)

    @property
    def air_noise(self) -> float:
        """Noise of the measured pressure, kPa."""
        return gauge.sensor_noise(self.recording, self.measured)

    def prepare(self, selected: Sequence[str], breaks: Sequence[dict]) -> None:
        """Corrects the recording as a written diagnosis did."""
        for correction in breaks:
            self.apply_break(correction)

    def apply_break(self, correction: dict) -> None:
        """Corrects the recording where it is not of one device seen by one marker.

        Args:
            correction: `from_row` and `shift` (mm or rad by column) of a marker that slipped, or `first_row`
                and `last_row` of what stands on one side of a change for good.
        """
        if "shift" in correction:
            samples = self.recording.samples.copy()
            for name, shift in correction["shift"].items():
                samples.loc[samples.index[correction["from_row"] :], name] -= shift
            self.recording = replace(self.recording, samples=samples)
        else:
            rows = np.arange(len(self.recording))
            keep = (rows >= correction["first_row"]) & (rows <= correction["last_row"])
            self.recording = self.recording.keep(keep)
            self.parts = deal(self.recording, self.seed)
        self.breaks = (*self.breaks, correction)

    # ---------------------------------------------------------------- models

    def fitted(self, model: BodyModel) -> FittedModel:
        """A model of the search on all samples: from the command as its twin runs, else by the gauge."""
        twin = self.twin_with(model)
        if model.form.reading.source == "command":
            residual = self.residual(twin)
        else:
            residual = self.residual_with_runs(model)
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

    def residual_with_runs(self, model: BodyModel) -> np.ndarray:
        """(n, k) measured minus predicted, with what single runs have of their own."""
        fitter = BodyFitter(self.recording, self.twin, np.zeros(1, int))
        data = fitter.data(model.form.reading)
        return (data.measured - fitter.predict(model))[:, : data.counted]

    def twin_with(self, model: BodyModel) -> Twin:
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

    def with_air(self, body: BodyModel, air: BodyModel) -> Twin:
        """The twin of a body that the measured pressure drove, with the air before it."""
        twin, of_air = self.twin_with(body), self.twin_with(air).effects
        return replace(twin, effects=twin.effects | {k: v for k, v in of_air.items() if get_effect(k).of_air})

    def as_it_is(self, search: BodySearch) -> Scored:
        """The twin with its own effects, re-fitted."""
        fitter = BodyFitter(self.recording, self.twin, search.rows)
        own = any(n.startswith("bend_") for n in self.twin.parameters)
        switch = self.twin.parameters.get("switch_share")
        reading = Reading(start=self.start, switch=switch.value if switch else None)
        form = Form(tuple(self.own), reading, len(self.twin.spine_joint_positions_mm), own)
        space = BodySpace(fitter, self.own, [form.joints], [], ((),), form.reading)
        models = [fitter.fit(form, v, 12) for v in ({}, fitter.rough(form))]
        return min((search.score(space.settle_line(m)) for m in models), key=lambda s: s.value)

    def residual(self, twin: Twin) -> np.ndarray:
        """(n, k) measured minus predicted from the commanded pressure, each step at its own instant."""
        data = read(self.recording, twin)
        return data.measured[:, : data.counted] - predict(twin, data)[0]

    # ---------------------------------------------------------------- the verbs

    def search(self, jobs: int, steps: Steps) -> Outcome:
        """Looks for what the twin lacks."""
        began = time.perf_counter()
        with ThreadPoolExecutor(jobs) as pool:
            steps.expect("fitting the twin as it is", 1)
            search, done = self._searched(pool.map, lambda text: steps.expect(text, 0))
            before = self.as_it_is(search)
            if done.model.model.form.trials:
                self.findings = [*self.findings, OF_TRIALS]
            steps.done()
            return body_outcome(self, search, before, done, began)

    def _searched(self, run, tell) -> tuple[BodySearch, Searched]:
        """A search, begun anew where the recording turned out not to be of one device, seen by one marker."""
        while True:
            search = BodySearch(self, run, tell)
            done = search.find()
            if done is not None:
                return search, done

    def refits(self, effects: Sequence[str], steps: Steps) -> Refits:
        """The twin re-fitted as it is, with the known causes, and with these effects too.

        Known causes are chosen with the effects in place: those without which the cross-validated error rises
        significantly.
        """
        search = BodySearch(self, map, lambda text: None)
        start = self.as_it_is(search)
        while move_back(self, search, start):
            start = self.as_it_is(search)
        steps.done()
        fitter = BodyFitter(self.recording, self.twin, search.rows)
        causes = [e for e in base_effects(self) if e not in (*self.own, *effects)]
        form = replace(start.model.form, effects=(*self.own, *causes), own=True)
        joints = [len(self.twin.spine_joint_positions_mm)]
        space = BodySpace(fitter, form.effects, joints, self.candidates, ((),), form.reading)
        engine, values, new = search.engine(space), start.model.values, []
        rich = engine.fits([Trial(form, values), Trial(form, values | fitter.rough(form))], 8)
        for name in effects:
            form = form.plus(name)
            new.append(form.effects[-1])
            values = rich[0].model.values if rich else values
            rich = engine.fits([space.trial(form, values, name, s) for s in starts(name)], 8)
        rich = [search.score(space.settle_line(space.settle(s.model))) for s in rich[:1]] or [start]
        whole = search.simplified(space, Found(start, [start], rich[0]), (*self.own, *new))
        model, terms = whole.model, [e for e in whole.model.form.effects if e not in self.own]
        without = {t: search.score(space.without(model, t)) for t in terms}
        known = [t for t in terms if t not in new]
        if model.form.own and not start.model.form.own:
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
            better=better and (better[0], self.fitted(better[1].model)),
        )

    def _better(
        self, search: BodySearch, space: BodySpace, base: Scored, whole: Scored, kinds: set[str]
    ) -> tuple[str, Scored] | None:
        """Another mechanism that explains significantly more by itself and beside which these add nothing."""
        engine = search.engine(space)
        space.candidates = [e for e in space.candidates if family(e) not in kinds]
        others = engine.fits(space.grow(base.model, 12, 0), 8)
        if not others or not search.judge.surely(whole.crossed, others[0].crossed):
            return None
        added = [e for e in whole.model.form.effects if e not in base.model.form.effects]
        values = others[0].model.values | {k: v for k, v in whole.model.values.items() if _of(k) in added}
        both = engine.fits([Trial(others[0].model.form.plus(*added), values)], 8)
        if both and engine.is_worth(others[0], both[0]):
            return None
        return others[0].model.form.effects[-1], others[0]

    def contributions(
        self, after: FittedModel, without: Mapping[str, FittedModel], known: Sequence[str]
    ) -> list[Contribution]:
        """What each term is worth on the test part, by the models re-fitted without it; the largest first."""
        error, out = self.errors(after)["heldout"], []
        for name, model in without.items():
            drop = self.test.drop(model.squared, after.squared)
            out.append(Contribution(name, name in known, self.errors(model)["heldout"], error, drop))
        return sorted(out, key=lambda c: -c.drop[0])

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
            fitted_to={"change": "added", "recording": str(self.recording.folder), "seed": self.seed},
        )
