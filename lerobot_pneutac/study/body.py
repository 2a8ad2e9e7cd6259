"""A recording of a finger or an arm under judgement; a sample is a row."""

import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from lerobot_pneutac.diagnosis.candidates import sort_candidates
from lerobot_pneutac.diagnosis.experiment import predict
from lerobot_pneutac.diagnosis.model import FittedModel
from lerobot_pneutac.diagnosis.parts import deal
from lerobot_pneutac.diagnosis.result import Outcome
from lerobot_pneutac.diagnosis.search import Scored
from lerobot_pneutac.diagnosis.steps import Steps
from lerobot_pneutac.study import gauge
from lerobot_pneutac.study.body_model import BodyFitter, BodyModel, Form, Reading
from lerobot_pneutac.study.body_outcome import body_outcome
from lerobot_pneutac.study.body_search import BodySearch, Searched, base_effects
from lerobot_pneutac.study.body_space import BodySpace
from lerobot_pneutac.study.body_words import BodyWords
from lerobot_pneutac.study.one_device import move_back
from lerobot_pneutac.study.pair import enough_rows
from lerobot_pneutac.study.reading import read
from pneutac_datasets.recording.checks import check
from pneutac_datasets.recording.mounts import on_one_mount
from pneutac_datasets.recording.noise import noise_floor
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.laws import starts
from pneutac_sim.effects.registry import body_effects, get_effect, of_body
from pneutac_sim.finger.confidence import Z95, confidence
from pneutac_sim.finger.data import BodyData
from pneutac_sim.twin import Twin, Value

RESTED_S = 1e4  # a pause at zero pressure after which everything has rested
OF_TRIALS = (
    "Trials differ by small offsets, gains, zeros and clocks of their own, no part of the device: with "
    "what was found, errors are counted beside them (told by its learning rows), before it they are not."
)
EDGE = 1e-3


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

    Raises:
        InputError: the recording has too few rows to fit the twin at all, or is of another device.
    """

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
    def air_noise(self) -> float:
        """Noise of the measured pressure, kPa."""
        return gauge.sensor_noise(self.recording, self.measured)

    # ---------------------------------------------------------------- models

    def fitted(self, model: BodyModel) -> FittedModel:
        """A model of the search, run on all samples from the command."""
        twin = self.twin_with(model)
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

    def refit(self, effects: Sequence[str], start: FittedModel | None, steps: Steps) -> FittedModel:
        """All parameters of the twin and of these effects, fitted to all but the test part.

        With new effects the body's own base is tried beside the paper's; the simpler is kept unless the other
        is surely better.
        """
        search = BodySearch(self, map, lambda text: None)
        if start is None:
            self._before = self.as_it_is(search)
            while move_back(self, search, self._before):
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
                best = search.engine(space).fits(fits, 8)
                if best:
                    values = best[0].model.values
            models = [space.settle(s.model) for s in best[:1]]
            found += [search.score(space.settle_line(m)) for m in models]
        plain, rich = found[0], found[-1]
        needed = search.judge.surely(plain.crossed, rich.crossed)
        best = rich if needed and plain.value - rich.value > 0.03 * self.noise.floor**2 else plain
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
