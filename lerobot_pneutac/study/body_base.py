"""A recording of a finger or an arm, its parts, its twin and its sentences; a sample is a row."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy.stats import linregress, ttest_1samp, wilcoxon

from lerobot_pneutac.diagnosis import thresholds as T
from lerobot_pneutac.diagnosis.bootstrap import BlockBootstrap, conditions, deal
from lerobot_pneutac.diagnosis.design import (
    Separation,
    predict,
    predictions,
    read,
    separations,
)
from lerobot_pneutac.diagnosis.law_programs import law_program
from lerobot_pneutac.diagnosis.result import FittedModel, Outcome, Rival, Untested
from lerobot_pneutac.diagnosis.verdict import PROFILE, called, too_few
from lerobot_pneutac.study.base import EffectStudy
from lerobot_pneutac.study.body_model import BodyFitter, BodyModel
from lerobot_pneutac.study.data_breaks import Break, without_break
from lerobot_pneutac.study.pair import device_moves, enough_rows, longer, recorded_min
from pneutac_datasets.recording.checks import check
from pneutac_datasets.recording.mounts import align_mounts
from pneutac_datasets.recording.noise import headline, noise_floor
from pneutac_datasets.recording.pressures import supply_limits
from pneutac_datasets.recording.recording import Recording
from pneutac_datasets.recording.wording import joined, listed, plural
from pneutac_sim.effects.body_effect import BodyEffect
from pneutac_sim.effects.laws import family, is_law, law, law_names
from pneutac_sim.effects.registry import body_effects, get_effect, of_body
from pneutac_sim.features import CHAMBERS
from pneutac_sim.finger.data import BodyData
from pneutac_sim.finger.inputs import conditions_of
from pneutac_sim.finger.instants import RESTED_S, pauses_read, step_rows, unknown_pauses
from pneutac_sim.least_squares import Z95, confidence
from pneutac_sim.twin import Twin, Value


def sort_candidates(recording: Recording, twin: Twin) -> tuple[list[str], list[Untested]]:
    """Effects to try and those that cannot be tried; what the twin has already is in neither."""
    names, untested = [], []
    known = conditions_of(recording.samples, recording.device)
    marked = any(recording.has(f"tip_{a}_mm") for a in "xyz")
    for name, effect in (body_effects() | {n: law(n) for n in law_names()}).items():
        if (name in twin.effects and not is_law(name)) or (effect.several and CHAMBERS[recording.device] < 2):
            continue
        if is_law(name) and not can_act(name, recording, marked, known):
            continue
        if name == "curvature_reading" and name not in known_causes(recording):
            continue  # no curvature was read
        missing = [c for c in effect.columns if c not in known]
        if any(c.startswith("other_") for c in missing):
            continue  # there is no other chamber on record, so none whose effect could be missing
        constant = [
            c
            for c in effect.columns
            if c in T.LEAST_CHANGE and recording.has(c) and np.ptp(recording.column(c)) < T.LEAST_CHANGE[c]
        ]
        if missing:
            untested.append(Untested(name, f"cannot be tested, record column {', '.join(missing)}"))
        elif constant:
            untested.append(Untested(name, f"cannot be tested, column {constant[0]} hardly changes: vary it"))
        elif effect.of_markers and not marked:
            untested.append(Untested(name, "cannot be tested on angles, record tip_x_mm, tip_y_mm, tip_z_mm"))
        else:
            names.append(name)
    return names, untested


def can_act(name: str, recording: Recording, marked: bool, known: set[str]) -> bool:
    """Whether a law can show in a recording; one that cannot is not worth a word."""
    effect = law(name)
    if any(c not in known for c in effect.columns):
        return False
    if any(
        np.ptp(recording.column(c)) < T.LEAST_CHANGE.get(c, 0.1) for c in effect.columns if recording.has(c)
    ):
        return False
    if name == "round(p)" and levels(recording.commands) <= T.FEW_LEVELS:
        return False  # between so few pressures it is any curve
    if name.startswith("bend"):
        return not marked
    return marked or not effect.of_markers or name == "tracker_lag"


def levels(command_kpa: np.ndarray) -> int:
    """How many pressures, or sets of them, hold nearly all rows (n, chambers) of a command."""
    step = max(T.SAME_LEVEL * float(np.abs(command_kpa).max()), 1e-9)
    rows = np.sort(np.unique(np.round(command_kpa / step), axis=0, return_counts=True)[1])[::-1]
    return 1 + int(np.searchsorted(np.cumsum(rows), T.MOSTLY_HELD * len(command_kpa)))


MAD = 1.4826


def measured_columns(recording: Recording) -> list[str]:
    """Columns of measured pressure, empty where one is missing or has no information."""
    columns = [c.replace("pressure_cmd", "pressure") for c in recording.pressure_columns]
    for command, measured in zip(recording.pressure_columns, columns, strict=True):
        if not recording.has(measured):
            return []
        p, m = recording.column(command).astype(float), recording.column(measured).astype(float)
        if np.ptp(p) <= T.STANDS_KPA or np.ptp(m) < T.DEAF_GAUGE * np.ptp(p):
            return []
    return columns


def sensor_noise(recording: Recording, columns: list[str]) -> float:
    """Noise of the measured pressures together, kPa.

    From second differences, whose variance is six times that of white noise; their median is blind to steps.
    """
    total = 0.0
    for rows in recording.trials().values():
        p = recording.samples[columns].to_numpy(float)[rows]
        if len(p) >= 20:
            d = np.diff(p, 2, axis=0)
            total = max(total, float(((MAD * np.median(np.abs(d), axis=0)) ** 2).sum() / 6))
    return float(np.sqrt(total))


def features(study: "BodyBase") -> np.ndarray:
    """(n, f) causal signals of the command and the conditions, for a black box."""
    data = BodyData.of(study.recording, study.twin, source="command", start=study.start)
    u, dt = data.inputs.pressure_kpa / data.inputs.pressure_range_kpa, data.inputs.dt_s
    columns = [u]
    for name, values in (
        *(
            ("lag(p)", {"weight": 1.0, "scale_kpa": 1.0, "time_s": t})
            for t in (0.05, 0.15, 0.5, 1.5, 5.0, 20.0, 80.0)
        ),
        *(("play(p)", {"weight": 1.0, "scale_kpa": 1.0, "width_kpa": w}) for w in (0.05, 0.2)),
    ):
        effect = law(name)
        x = np.array(u)
        theta = np.array([values[p.name] for p in effect.parameters])
        effect.run(x, dt, theta, np.zeros((len(x), 0)), np.zeros(effect.state_size(x.shape[1])))
        columns.append(x - u)
    columns = [c[data.inputs.rows] for c in columns]
    for name in ("temperature_c", "payload_g", "gravity_x", "gravity_y", "gravity_z"):
        if study.recording.has(name):
            columns.append(study.recording.column(name).astype(float)[:, None])
    return np.concatenate(columns, axis=1)


def beyond_gain(seen: np.ndarray, plain: np.ndarray) -> np.ndarray:
    """How far predictions (n, k) lie from others, (n,), whose gain and offset are fitted to them."""
    ground = np.concatenate([plain, np.ones((len(plain), 1))], axis=1)
    return np.linalg.norm(seen - ground @ np.linalg.lstsq(ground, seen, rcond=None)[0], axis=1)


OUTPUT = {"mm": "tip", "rad": "bend", "1/m": "curvature"}  # by the unit of its error
SHORT_PAUSE_S = 1.0  # in a shorter one the air itself is still that of the run before
# Families that air and body may both cause.
LATE = ("creep", "relaxation", "overshoot", "valve_lag", "ringing", "leak")
REPEAT = "Repeat one test after an hour. Differences between the two come from the setup, not the device."
MOVES = "Record ten minutes in which the commanded pressure moves: steps, slow and fast ramps and long holds."


class BodyBase(EffectStudy):
    """Markers, angles or curvatures of a finger or an arm; arguments are those of `study_of`.

    Attributes:
        measured: columns of measured pressure, empty where it has no information.
        remounted: trials that were mounted differently and moved, see `mounts`.
        checked: number of findings before a search.
        start: how trials are taken to begin, before a search asks.
        joints: of the spine, tried besides the twin's own number.
        breaks: corrections of the recording for this judgement, see `data_breaks`.

    Raises:
        InputError: the recording has too few rows to fit the twin at all, or is of another device.
    """

    def __init__(self, twin: Twin, recording: Recording, seed: int = 0, adding: Sequence[str] = ()):
        self.twin, self.seed, self._given = twin, seed, recording
        self.breaks: tuple[dict, ...] = ()
        device_moves(recording)
        self.recording, self.findings = check(recording)
        self.parts = deal(self.recording, seed)
        self.twin_effects = tuple(of_body(twin.effects))
        self.candidates, self.untested = sort_candidates(self.recording, twin)
        if any(self.refusal(e) for e in adding):
            return
        largest = max(body_effects(), key=lambda e: len(get_effect(e).parameters))
        enough_rows(twin, self.recording, [*self.twin_effects, *(adding or [largest])], self.parts.train)
        before, columns = self.recording, headline(self.recording)[0]
        self.recording, moved = align_mounts(before, twin.length_mm, self.parts.train)
        differs = (self.recording.samples[columns] != before.samples[columns]).any(axis=1)
        self.remounted = set(before.samples["trial"][differs])
        self.findings = self.findings + moved
        self.checked = len(self.findings)
        self.noise = noise_floor(self.recording)
        self.unit = self.noise.unit
        self.measured = measured_columns(self.recording)
        data = BodyData.of(self.recording, twin, source="command")
        starts_vented = np.isinf(data.inputs.dt_s).sum() and not np.array_equal(data.inputs.rows[:1], [0])
        known = twin.parameters.get("pause_s")
        self.start: str | float = known.value if known else "vented" if starts_vented else "held"
        self.joints = 8 if twin.device == "finger" else len(twin.spine_joint_positions_mm)

    @property
    def given_rows(self) -> int:
        return len(self._given)

    @cached_property
    def across_trials(self) -> BlockBootstrap:
        trial = np.unique(np.asarray(self.recording.samples["trial"]), return_inverse=True)[1]
        return BlockBootstrap(self.parts.test, trial, np.zeros(trial.max() + 1, int), self.seed + 2)

    def amount_recorded(self) -> tuple[float, str, str]:
        return recorded_min(self.recording), "minute", "of the same programs"

    @property
    def air_noise(self) -> float:
        """Noise of the measured pressure, kPa."""
        return sensor_noise(self.recording, self.measured)

    def prepare(self, selected: Sequence[str], breaks: Sequence[dict]) -> None:
        for correction in breaks:
            self.apply_break(correction)

    def amend(self, found: Break | None) -> bool:
        """Corrects the recording for this judgement and reports why; whether there was a break."""
        if found is not None:
            self.apply_break(found.correction)
            self.findings = [*self.findings, found.finding]
        return found is not None

    def apply_break(self, correction: dict) -> None:
        self.recording = without_break(self.recording, correction)
        if "first_row" in correction:
            self.parts = deal(self.recording, self.seed)
        self.breaks = (*self.breaks, correction)

    def fitted(self, model: BodyModel) -> FittedModel:
        """A model of the search on all samples: from the command as its twin runs, else by the gauge."""
        twin = self.twin_with(model)
        if model.structure.input_model.source == "command":
            residual = self.residual(twin)
        else:
            residual = self.residual_with_runs(model)
        names = [model.pipeline.names[i] for i in model.free]
        edge = (model.v < T.AT_BOUND) | (model.v > 1 - T.AT_BOUND)
        bound = [
            n for n, i, e, v in zip(names, model.free, edge, model.v, strict=True)
            if e and "." in n and n.rpartition(".")[0] not in base_effects(self)
            and (model.bounds.upper if v > 0.5 else model.bounds.lower)[i] != model.pipeline.specs[i].neutral
        ]  # fmt: skip
        return FittedModel(
            effects=model.structure.effects, residual=residual, count=len(names), twin=twin, at_bound=bound
        )

    def residual_with_runs(self, model: BodyModel) -> np.ndarray:
        """(n, k) measured minus predicted, with what single runs have of their own."""
        fitter = BodyFitter(self.recording, self.twin, np.zeros(1, int))
        data = fitter.data(model.structure.input_model)
        return (data.measured - fitter.predict(model))[:, : data.counted]

    def twin_with(self, model: BodyModel) -> Twin:
        """The twin with a model's parameters, their intervals, and how its recordings begin."""
        fitter = BodyFitter(self.recording, self.twin, np.zeros(1, int))
        edge = (model.v < T.AT_BOUND) | (model.v > 1 - T.AT_BOUND)
        adjacent = np.ones(len(model.residual), bool)
        more = np.zeros(model.jacobian.shape[1] - len(edge), bool)
        sd = confidence(model.jacobian, model.residual, adjacent, np.r_[edge, more]).sd[: len(edge)]
        low = model.bounds.value(np.clip(model.v - Z95 * sd, 0, 1), model.free)
        high = model.bounds.value(np.clip(model.v + Z95 * sd, 0, 1), model.free)
        names = [model.pipeline.names[i] for i in model.free]
        ci95 = {n: (float(a), float(b)) for n, a, b in zip(names, low, high, strict=True)}
        twin = model.pipeline.update(fitter.twin_with(model.structure.joints), model.theta, ci95)
        input_model = model.structure.input_model
        switch = input_model.switch
        if "time_sent_s" in self.recording.samples:
            switch = 0.5  # recordings without send times are read with each step at its own instant
        if switch is not None:
            twin.parameters["switch_share"] = Value(float(np.nanmedian(np.array(switch, dtype=float))))
        if input_model.start != "held":
            start = RESTED_S if input_model.start == "vented" else input_model.start
            twin.parameters["pause_s"] = Value(float(np.median(np.array(start, dtype=float))))
        return replace(twin, arrays={}, gel={}, history=[])

    def with_air(self, body: BodyModel, air: BodyModel) -> Twin:
        """The twin of a body that the measured pressure drove, with the air before it."""
        twin, of_air = self.twin_with(body), self.twin_with(air).effects
        return replace(twin, effects=twin.effects | {k: v for k, v in of_air.items() if get_effect(k).of_air})

    def residual(self, twin: Twin, recording: Recording | None = None) -> np.ndarray:
        """(n, k) measured minus predicted from the commanded pressure, each step at its own instant."""
        data = read(recording or self.recording, twin)
        return data.measured[:, : data.counted] - predict(twin, data)[0]

    def where(self, model: FittedModel) -> str:
        """How commands must be logged for the error to stay at the noise, see `Evidence.where`.

        What is quick in the air needs the instant of each command. Where they are logged, the error without
        them is known; where they are not, they were fitted together with it.
        """
        samples, sent = self.recording.samples, "time_sent_s"
        if sent not in samples:
            quick = any(get_effect(e).stage == "pneumatics" for e in model.effects)
            steps = len(step_rows(self.recording))
            return "where the times of commands are not logged" if quick and steps else ""
        if self.noise.value is None:
            return ""
        without = replace(self.recording, samples=samples.drop(columns=sent))
        squared = (self.residual(model.twin, without) ** 2).sum(axis=1)
        left = self.test.value(squared) ** 0.5 / self.noise.floor
        times = f"where the times of commands are logged (without them {left:.2g} times the noise)"
        return times if left > T.NOISE else ""

    def refusal(self, effect: str) -> str:
        asked = get_effect(effect)
        if not isinstance(asked, BodyEffect):
            return f"'{effect}' does not bend a body; give one of {', '.join(body_effects())}."
        if asked.several and CHAMBERS[device := self.recording.device] < 2:
            return f"'{effect}' acts only where there are several chambers; this {device} has one."
        untested = {u.name: f"{self.recording.folder}: effect '{effect}' {u.reason}." for u in self.untested}
        return self.already_on(effect) or untested.get(effect, "")

    def twin_of(self, model: FittedModel) -> Twin:
        """The fitted body with the gel, pictures and networks of the twin that was given."""
        sensor_effects = {k: v for k, v in self.twin.effects.items() if k not in of_body(self.twin.effects)}
        given = self.twin.copy()
        return replace(
            model.twin,
            effects=sensor_effects | model.twin.effects,
            gel=given.gel,
            arrays=given.arrays,
            history=given.history,
            fitted_to={"change": "added", "recording": str(self.recording.folder), "seed": self.seed},
        )

    def signals(self) -> np.ndarray:
        return features(self)

    # ---------------------------------------------------------------- sentences

    @property
    def more_data(self) -> str:
        return longer(self.recording) if self._moves else MOVES

    @property
    def repeat(self) -> str:
        """What separates setup and device, by what equal runs of the recording show already."""
        session, noise = self.noise.session, self.noise.value
        if session is None or noise is None:
            return REPEAT
        if session > T.NOISE * noise:
            differ = f"Equal runs of this recording differ by {session:.3g} {self.unit} (noise {noise:.3g})"
            return f"{differ}: log what changes between them, such as the mount, temperature or rest before."
        agree = f"Equal runs of this recording agree within {session:.3g} {self.unit}"
        return f"{agree}, so it is the device and not the setup: add an effect of your own that describes it."

    @property
    def nothing_left(self) -> str:
        """The range is all that could grow, unless the supply ends there."""
        more = self._supply or "; go to higher pressure to find where the twin ends"
        return f"Nothing needs to be recorded{more}."

    @property
    def _supply(self) -> str:
        """Where the supply ends, as the end of a sentence; empty where nothing shows it."""
        ends = supply_limits(self.recording).values()
        return f": the supply ends at {listed(f'{kpa:.3g}' for kpa in ends)} kPa" if ends else ""

    def cause(self, model: FittedModel, effect: str) -> str:
        return called(effect) if effect == PROFILE else super().cause(model, effect)

    @property
    def recorded(self) -> str:
        samples = self.recording.samples
        kpa = self.recording.commands
        few = levels(kpa)
        out = [f"at {few} pressures " * (few <= T.FEW_LEVELS) + f"up to {kpa.max():.3g} kPa"]
        step_s = np.diff(samples["time_s"].to_numpy(float), prepend=np.inf)
        change_kpa = np.abs(np.diff(kpa, axis=0, prepend=kpa[:1])).max(axis=1)
        within = step_s > 0
        within &= np.r_[False, np.diff(np.unique(samples["trial"], return_inverse=True)[1]) == 0]
        if change_kpa[within].max(initial=0.0) < T.SMOOTH * kpa.max():
            rate = np.quantile(change_kpa[within] / step_s[within], 0.99)
            out.append(f"changing by up to {rate:.2g} kPa/s")
        axes = [f"gravity_{a}" for a in "xyz"]
        if all(map(self.recording.has, axes)):
            ways = len(np.unique(np.round(samples[axes].to_numpy(float), 1), axis=0))
            out.append(f"gravity in {plural(ways, 'direction')}")
        for name, unit in (("payload_g", "g"), ("temperature_c", "°C")):
            if self.recording.has(name):
                values = self.recording.column(name).astype(float)
                low, high = f"{values.min():.3g}", f"{values.max():.3g}"
                span = low if low == high else f"{low} to {high}"
                out.append(f"{name.partition('_')[0]} of {span} {unit}")
                if name == "payload_g" and not self._heaviest_everywhere():
                    out[-1] += " (not in every direction)"
        return ", ".join(out)

    def _heaviest_everywhere(self) -> bool:
        """Whether the heaviest payload was recorded in every direction of gravity in which anything was."""
        way = conditions(self.recording, ())
        payload_g = self.recording.column("payload_g").astype(float)
        heaviest = payload_g > payload_g.max() - T.LEAST_CHANGE["payload_g"]
        return len(np.unique(way[heaviest])) == len(np.unique(way))

    def confusable_with(self, effects: Sequence[str]) -> str:
        """The finding that lags of air and of body cannot be distinguished, where such a lag was found."""
        late = [e for e in effects if family(e) in LATE or get_effect(e).stage == "pneumatics"]
        missing = (f for f in self.findings if "no measured pressure" in f)
        return next(missing, "") if late else ""

    def size(self, model: FittedModel, effect: str) -> str:
        """What the effect does to the prediction that another gain and offset could not."""
        data = read(self.recording, model.twin)
        seen, plain = (predict(t, data)[0] for t in (model.twin, model.twin.without(effect)))
        what = OUTPUT[self.unit]
        moved = beyond_gain(seen, plain)
        if moved.max() < 1e-6:  # such as a turned base, which an offset does as well
            return ""
        typically = f"{np.sqrt((moved**2).mean()):.2g} {self.unit}"
        return f"That moves its {what} by {typically} typically and {moved.max():.2g} {self.unit} at most."

    def idle(self, model: FittedModel, effect: str) -> bool:
        """Whether an effect moves the prediction by less than `thresholds.IDLE_OF_NOISE` of the noise."""
        if effect not in model.twin.effects:
            return False
        data = read(self.recording, model.twin)
        seen, plain = (predict(t, data)[0] for t in (model.twin, model.twin.without(effect)))
        return bool(
            np.sqrt(((seen - plain) ** 2).sum(axis=1).mean()) < T.IDLE_OF_NOISE * (self.noise.value or 0.0)
        )

    def experiment(self, model: FittedModel, effect: str) -> str:
        """By the law's own program where it is one and was found."""
        constants = {k: v.value for k, v in model.twin.effects.get(effect, {}).items()}
        program = law_program(self.recording, effect, constants) if constants else None
        if program is None:
            advice = super().experiment(model, effect)
            return f"{advice} Go no higher{self._supply}." if self._supply else advice
        supply = f" Go no higher{self._supply}." if self._supply else ""
        without, data = model.twin.without(effect), read(self.recording, model.twin)
        pair = predictions(self.recording, program, model.twin, without)
        if pair is None:
            return program.advice + supply
        here, there = (
            float(np.sqrt((beyond_gain(seen, plain) ** 2).mean()))
            for seen, plain in (
                (predict(t, data)[0] for t in (model.twin, without)),
                (p[0] for p in pair[:2]),
            )
        )
        if there <= here:
            shows = f"This recording shows {here:.2g} {self.unit} of it, as much as its own program would"
            return f"{shows}: another day, by other programs, decides."
        times = f" ({there / self.noise.value:.2g} times the noise)" if self.noise.value else ""
        moves = f"There it moves the {OUTPUT[self.unit]} by {there:.2g} {self.unit} typically{times}"
        rest = f"in this recording by {here:.2g} {self.unit}, as no other gain or offset could"
        return f"{program.advice}{supply} {moves}, {rest}."

    def at_bound(self, model: FittedModel, effects: Sequence[str]) -> list[str]:
        return list(model.at_bound)

    @property
    def _moves(self) -> bool:
        command = self.recording.samples[self.recording.pressure_columns].to_numpy(float)
        return bool(np.ptp(command, axis=0).max() > T.STANDS_KPA)

    def too_little(self) -> str:
        if not self._moves:
            return (
                "This recording cannot decide: the commanded pressure never moves, so nothing about bending "
                "can be learnt from it."
            )
        samples, units = int((~self.test.mask).sum()), self.test.units
        if not too_few(samples, units):
            return ""
        return (
            f"This recording is too short to decide anything: {samples} samples to fit and "
            f"{units} pieces of time to test on."
        )

    def caveats(self, outcome: Outcome) -> list[str]:
        """What the log of pressures and commands leaves open."""
        return [*self._unsent(outcome), *self._unread(), *self._unpaused(outcome)]

    def to_log(self, outcome: Outcome) -> str:
        if not self._unpaused(outcome):
            return ""
        return (
            "State in recording.json, under `trials`, how long the device rested before each run, and "
            "diagnose again; `pneutac measure` logs it."
        )

    def _unpaused(self, outcome: Outcome) -> list[str]:
        """That what was found goes on in pauses between runs that nobody logged."""
        twin = outcome.after.twin
        pause = twin.parameters.get("pause_s")
        if pause is None or pause.value >= RESTED_S or not len(unknown_pauses(self.recording)):
            return []
        short, long = (
            predict(twin, BodyData.of(self.recording, twin, source="command", start=s))[0]
            for s in (SHORT_PAUSE_S, RESTED_S)
        )
        moved = float(np.linalg.norm(short - long, axis=1).max())
        if moved < max(3 * (self.noise.value or 0.0), 1e-9):
            return []
        own = pauses_read(self.recording, read(self.recording, twin))
        runs, what = plural(len(own), "run"), OUTPUT[self.unit]
        return [
            f"How long the device rested before {runs} is not recorded, and what was found goes on "
            f"meanwhile: between a pause of {SHORT_PAUSE_S:g} s and a long one its {what} differs by up to "
            f"{moved:.2g} {self.unit}. A pause was fitted to each, the shortest of {own.min():.2g} s and the "
            f"longest of {own.max():.2g} s; of a run to come it is not known."
        ]

    def _unsent(self, outcome: Outcome) -> list[str]:
        """That a quick effect of the air was found without the times at which commands were sent."""
        samples = self.recording.samples
        quick = [e for e in outcome.selected if get_effect(e).stage == "pneumatics"]
        if not quick or "time_sent_s" in samples or not len(step_rows(self.recording)):
            return []
        row = 1e3 * float(np.median(np.diff(samples["time_s"].to_numpy(float))))
        return [
            f"When commands were sent is not logged, so each step's instant between two samples ({row:.0f} "
            f"ms) was fitted together with {joined([e.replace('_', ' ') for e in quick])}: what takes less "
            "than that is not determined, and the error on a recording with column time_sent_s may be "
            "larger. Log it."
        ]

    def _unread(self) -> list[str]:
        """What the pressure log leaves open, where there is one."""
        logged = [c.replace("cmd_", "") for c in self.recording.pressure_columns]
        if self.measured or not all(map(self.recording.has, logged)):
            return []
        if self._moves:
            return [
                "The measured pressure hardly moves while the command does and was left out, so a slow "
                "valve and a creeping body cannot be distinguished."
            ]
        moved = max(np.ptp(self.recording.column(c)) for c in logged)
        if moved > max(T.STANDS_KPA, 10 * sensor_noise(self.recording, logged)):
            return [
                "The measured pressure moves although the commanded one never does: check that "
                "pressure_cmd_kpa is what was commanded."
            ]
        return ["The measured pressure does not move either."]

    def how_tested(self, outcome: Outcome) -> str:
        if not self.measured:
            return "Effects of air and body are both tried on the pose; no measured pressure is usable."
        return (
            "Effects of the air are tried on the measured pressure and on the pose, all others on the pose."
        )

    def separation(self, rival: Rival) -> Separation | None:
        a, b, names = rival.winner.twin, rival.fit.twin, (rival.effect, rival.rival)
        return next(iter(separations(self.recording, a, b, self.noise.floor, names)), None)

    def details(self, outcome: Outcome) -> dict:
        return {
            "measured_pressure": bool(self.measured),
            "base_model": outcome.base_model,
            "data_breaks": list(self.breaks),
        }


def base_effects(study: "BodyBase") -> tuple[str, ...]:
    """Known causes that a study's recording shows, see `known_causes`."""
    return tuple(e for e in known_causes(study.recording) if e not in study.excluded)


def known_causes(recording: Recording) -> tuple[str, ...]:
    """What any body may show of how it is made, mounted and read: tilt, weight, load, stretch, curvature."""
    out = []
    tip = all(recording.has(f"tip_{a}_mm") for a in "xz")
    if tip:
        out.append("base_tilt")
    known = all(recording.has(f"gravity_{a}") for a in "xyz")
    if known and tip:
        g = recording.samples[[f"gravity_{a}" for a in "xyz"]].to_numpy(float)
        if np.ptp(g, axis=0).max() > T.GRAVITY_CHANGE:
            out.append("gravity")
        if recording.has("payload_g") and np.ptp(recording.column("payload_g")) > 1e-3:
            out.append("payload")
    if tip:
        out.append("elongation")
    elif recording.has("curvature_x_1_per_m"):
        out.append("curvature_reading")
    return tuple(out)


COMES_WITH = {
    "payload": ("payload_g",),
    "gravity": ("gravity_x", "gravity_y", "gravity_z"),
    "thermal": ("temperature_c",),
}  # what an effect comes and goes with, by trials as a rule


def doubt(
    cause: str,
    recording: Recording,
    predict: Callable[[Recording], np.ndarray],
    residual: np.ndarray,
    rows: np.ndarray,
    without: np.ndarray,
    squared: np.ndarray,
) -> str:
    """Why a cause that lowers the error may yet stand in for something else, a sentence; empty where not.

    A weight that hangs in one trial explains whatever is different in that trial: creep of the trials before,
    drift, a knock. Blocks of one trial share it, so they are no repeats; trials are. What comes with a
    condition must stand out from how much runs of one condition differ (`size_by_run`); what acts in every
    trial must lower the error of all of them.

    Args:
        cause: an effect of the model.
        recording: that the model is fitted to.
        predict: what the model predicts of this recording under other conditions, (n, k).
        residual: (n, k) measured - predicted, in the unit of `predict`.
        rows: (m,) samples to judge by.
        without: (m,) squared errors of the model without the cause, re-fitted.
        squared: (m,) those of the model.
    """
    name = cause.replace("_", " ")
    columns = COMES_WITH.get(cause)
    if columns is None:
        trial = np.unique(recording.samples["trial"].to_numpy()[rows], return_inverse=True)[1]
        falls = np.log(np.maximum(np.bincount(trial, without), 1e-300) / np.bincount(trial, squared))
        if len(falls) < T.FEW_RUNS:
            lower = bool(falls.min() > 0)
        else:  # the mean does not show it where runs differ much in their range, ranks not where they are few
            by_mean = ttest_1samp(falls, 0.0, alternative="greater").pvalue
            by_rank = wilcoxon(falls, alternative="greater").pvalue
            lower = bool(min(by_mean, by_rank) < T.SIGNIFICANCE)
        if lower:
            return ""
        return f"{name} is left out: it does not lower the error significantly from trial to trial."
    claimed, shown = size_by_run(recording, columns, predict, residual, rows)
    if np.ptp(claimed) > 0 and linregress(claimed, shown, alternative="greater").pvalue < T.SIGNIFICANCE:
        return ""
    what = "direction of gravity" if len(columns) > 1 else columns[0]
    return (
        f"{name} is left out: what it explains does not exceed significantly how much parts of equal {what} "
        "differ. Repeat one program under both conditions in turn, three times each."
    )


def size_by_run(
    recording: Recording,
    columns: Sequence[str],
    predict: Callable[[Recording], np.ndarray],
    residual: np.ndarray,
    rows: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """How far a cause moves each run (K,) as its model claims, and as the measurement shows.

    Of few runs (`thresholds.FEW_RUNS`) each quarter counts as one. The commonest condition counts as none.
    The cause is measured there too: by what it would do under the condition farthest from it. `columns` are
    those of the condition, the others as in `doubt`.
    """
    samples, condition = recording.samples, recording.samples[list(columns)].to_numpy(float)
    span = max(np.ptp(condition, axis=0).max(), 1e-12)
    level = np.unique(np.round(2 * condition / span), axis=0, return_inverse=True)[1].reshape(-1)
    trial = np.unique(samples["trial"].to_numpy(), return_inverse=True)[1]
    run = np.cumsum(np.r_[True, (np.diff(trial) != 0) | (np.diff(level) != 0)]) - 1
    if run[-1] + 1 < T.FEW_RUNS:  # quarters tell at least of what changes within a run
        first = np.unique(run, return_index=True)[1]
        run = 4 * run + 4 * (np.arange(len(run)) - first[run]) // np.bincount(run)[run]
    common = int(np.bincount(level).argmax())
    none = condition[level == common].mean(axis=0)
    other = condition[np.linalg.norm(condition - none, axis=1).argmax()]

    def under(value: np.ndarray) -> np.ndarray:
        return predict(replace(recording, samples=samples.assign(**dict(zip(columns, value, strict=True)))))

    plain, away = under(none), under(other)
    moved = np.where((level == common)[:, None], away, predict(recording)) - plain
    claimed, shown = [], []
    for k in np.unique(run[rows]):
        mine = rows[run[rows] == k]
        size = float(np.sqrt((moved[mine] ** 2).sum(axis=1).mean()))
        acts = size if level[mine[0]] != common else 0.0
        claimed.append(acts)
        shown.append(acts + float((residual[mine] * moved[mine]).sum(axis=1).mean()) / max(size, 1e-12))
    return np.array(claimed), np.array(shown)
