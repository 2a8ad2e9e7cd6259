"""The next program: it separates candidates, narrows the best one's constants, and explores.

Between candidates it is, in nats, a bound of the mutual information between which of them is true and what
will be measured (Kolchinsky and Tracey, Entropy 19 (2017) 361: pairwise distances, here the Kullback and
Leibler divergence of equal Gaussians); of the constants the expected gain of a linear model with a Gaussian
prior (Lindley, Ann. Math. Stat. 27 (1956) 986), their present intervals being the prior. There are many
constants and few laws, so their gain counts relative to the largest of any program.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from lerobot_pneutac.diagnosis import thresholds as T
from lerobot_pneutac.diagnosis.law_programs import law_program, law_programs
from lerobot_pneutac.diagnosis.programs import (
    HZ,
    SECONDS,
    Hands,
    Limits,
    Program,
    common_programs,
    menu,
    on_chambers,
    table,
    visited,
    ways,
)
from lerobot_pneutac.diagnosis.result import Candidate
from lerobot_pneutac.diagnosis.verdict import called
from pneutac_datasets.recording.recording import Recording
from pneutac_datasets.recording.wording import plural
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.errors import InputError
from pneutac_sim.finger.data import BodyData
from pneutac_sim.finger.instants import instants, pauses
from pneutac_sim.finger.pipeline import Pipeline
from pneutac_sim.twin import Twin, Value

BY_HAND = ("strokes to 100% in 15 s", "stairs to 100%, 5 s each")  # programs for which a hand is asked
WEIGHED = 64  # programs whose gain on constants is worked out, a prediction a constant; of others it is 0
Z95 = 1.96

NO_HANDS = Hands()


@dataclass(frozen=True)
class Choice:
    """One program, and its expected information."""

    name: str  # of the program
    kind: str  # programs of one kind differ in numbers alone
    time_s: np.ndarray  # (n,) of its samples
    pressure_kpa: np.ndarray  # (n, chambers) commanded
    rivals: float  # nats about which candidate is true
    constants: float  # nats about the best candidate's constants
    new: float  # share of the time at levels, paces and rests that no recording has
    predictions: tuple[np.ndarray, ...]  # (n, k) headline columns by each candidate
    worth: float = 0.0  # all three for a second of the bench's time, see `choices`
    hand: str = ""  # what a hand changes for it, see `programs.HANDS`; empty for nothing
    # in force throughout; empty where no hand may change any
    conditions: Mapping[str, float] = field(default_factory=dict)

    @property
    def seconds(self) -> float:
        return float(self.time_s[-1])

    @property
    def tells_little(self) -> bool:
        return (
            self.rivals < T.LITTLE_GAIN
            and self.new < T.LITTLE_GAIN
            and self.constants < T.LITTLE_GAIN_CONSTANTS
        )


def choices(
    recording: Recording,
    contenders: Sequence[Candidate],
    noise: float,
    limits: Limits,
    hands: Hands = NO_HANDS,
) -> list[Choice]:
    """All programs that fit into the limits, by expected information for their time.

    The information of a program is its nats about candidates, its share of the largest gain on constants, and
    the share of its time at levels, paces and rests that no recording has.

    Args:
        recording: all that has been measured.
        contenders: candidate models, the best first.
        noise: floor of the headline error, in its unit.
        limits: of device and time.
        hands: what may be changed for a program.

    Raises:
        InputError: the limits are of another number of chambers, or no program fits.
    """
    chambers = len(recording.pressure_columns)
    if limits.chambers != chambers:
        raise InputError(
            f"{recording.folder} has {plural(chambers, 'chamber')}, and the limits are of {limits.chambers}; "
            "give one for each chamber."
        )
    found = []
    seen = visited(recording, limits)
    fits = [p for p in _programs(recording, contenders, limits, hands) if p[2][-1] <= limits.seconds]
    if not fits:
        raise InputError(
            f"No program fits into the {limits.seconds:.0f} s that are left; give a larger budget."
        )
    sigma = noise / np.sqrt(_columns(recording, contenders[0].twin))
    share = 1 / (sigma**2 * T.INDEPENDENT_S * limits.hz)
    likely = np.array([c.probability for c in contenders])
    for name, kind, t, p, hand in fits:
        conditions = hands.changes.get(hand, hands.usual)
        planned = _planned(recording, t, p, conditions)
        predicted = [x for c in contenders if (x := _predicted(planned, c.twin)) is not None]
        if len(predicted) < len(contenders):
            continue
        cells = visited(planned, limits)
        new = sum(n for cell, n in cells.items() if cell not in seen) / sum(cells.values())
        rivals = nats_between(predicted, likely, share)
        found.append(
            Choice(name, kind, t, p, rivals, 0.0, new, tuple(predicted), hand=hand, conditions=conditions)
        )
    found.sort(key=lambda c: -(c.rivals + c.new) / _costs_s(c))
    for i in (i for i, c in enumerate(found) if i < WEIGHED or c.hand):
        planned = _planned(recording, found[i].time_s, found[i].pressure_kpa, found[i].conditions)
        gain = _of_constants(planned, contenders[0].twin, found[i].predictions[0], share)
        found[i] = replace(found[i], constants=gain)
    most = max((c.constants for c in found), default=0.0) or 1.0
    weighed = [replace(c, worth=(c.rivals + c.constants / most + c.new) / _costs_s(c)) for c in found]
    return sorted(weighed, key=lambda c: -c.worth)


def _costs_s(c: Choice) -> float:
    return c.seconds + T.OVERHEAD_S + T.HAND_S * bool(c.hand)


def nats_between(predicted: Sequence[np.ndarray], probability: np.ndarray, share: float) -> float:
    """Nats about which of n models is true, from what each predicts of a measurement.

    Args:
        predicted: of each model the same numbers.
        probability: (n,) of each model.
        share: what a squared difference of one number counts: one over its variance, less where neighbours
            are alike.
    """
    p = probability / probability.sum()
    distance = np.array([[((a - b) ** 2).sum() for b in predicted] for a in predicted]) * share / 2
    return float(-(p * np.log(np.maximum(np.exp(-distance) @ p, 1e-300))).sum())


# ---------------------------------------------------------------- what there is to choose from


def _programs(
    recording: Recording, contenders: Sequence[Candidate], limits: Limits, hands: Hands
) -> Iterator[tuple[str, str, np.ndarray, np.ndarray, str]]:
    """Name, kind, time, command and what a hand changes."""
    for name, kind, t, p in common_programs(limits):
        yield name, kind, t, p, ""
        if name.startswith(BY_HAND):
            for hand in hands.changes:
                yield f"{name}, {hand}", hand, t, p, hand
    had = set()
    for c in contenders:
        for effect in (e for e in c.terms if e not in had):
            had.add(effect)
            values = {k: v.value for k, v in c.twin.effects.get(effect, {}).items()}
            law = law_program(recording, effect, values) if values else None
            if law is None or (recording.has("temperature_c") and law.samples["temperature_c"].nunique() > 1):
                continue  # none, or one that asks for a warm excess
            t = law.samples["time_s"].to_numpy(float)
            p = law.samples[recording.pressure_columns[0]].to_numpy(float)
            grid = np.arange(round(t[-1] * limits.hz) + 1) / limits.hz
            p = np.interp(grid, t, p)
            for way, shares in ways(limits.chambers):
                along = np.where(
                    shares > 0, np.clip(p[:, None], limits.low_kpa, limits.high_kpa), limits.rest_kpa
                )
                yield on_chambers(f"for {called(effect)}", way), f"for {effect}", grid, along, ""


# ---------------------------------------------------------------- the information of each


def _planned(recording: Recording, t: np.ndarray, p: np.ndarray, conditions) -> Recording:
    samples = table(recording, t, p, dict(conditions))
    meta = {k: v for k, v in recording.meta.items() if k != "trials"}
    return replace(recording, samples=samples, meta=meta | {"trials": {"0": {"start": "rested"}}})


def _columns(recording: Recording, twin: Twin) -> int:
    return BodyData.of(recording, twin, source="command").counted


def _predicted(planned: Recording, twin: Twin) -> np.ndarray | None:
    """Headline columns (n, k); None where a twin cannot follow the program."""
    try:
        seen, _ = predict(twin, BodyData.of(planned, twin, source="command"))
    except InputError:
        return None
    return seen if np.isfinite(seen).all() else None


def _of_constants(planned: Recording, twin: Twin, predicted: np.ndarray, share: float) -> float:
    """Nats about the constants, each moved by one standard deviation."""
    moved = []
    for other in _perturbed(twin):
        seen = _predicted(planned, other)
        if seen is not None:
            moved.append((seen - predicted).ravel())
    if not moved:
        return 0.0
    J = np.array(moved)
    return 0.5 * float(np.linalg.slogdet(np.eye(len(J)) + share * J @ J.T)[1])


def _perturbed(twin: Twin) -> Iterator[Twin]:
    for name, value in twin.parameters.items():
        if (sd := _deviation(value)) > 0:
            yield replace(twin, parameters={**twin.parameters, name: Value(value.value + sd)})
    for effect, constants in twin.effects.items():
        for name, value in constants.items():
            if (sd := _deviation(value)) > 0:
                changed = {**constants, name: Value(value.value + sd)}
                yield replace(twin, effects={**twin.effects, effect: changed})


def _deviation(value: Value) -> float:
    """Standard deviation by which a constant may move and stay inside its interval; 0 where none is known."""
    if value.ci95 is None:
        return 0.0
    return min((value.ci95[1] - value.ci95[0]) / (2 * Z95), max(value.ci95[1] - value.value, 0.0))


PRESSURE_NOISE = 0.005  # of the range: an ordinary gauge
LOG_PRESSURE = "log the measured pressure"
LOG_ADVICE = "Log the measured pressure (pressure_kpa): it separates the pneumatics from the body."


@dataclass
class Separation:
    """How well one experiment separates two models."""

    name: str  # of the experiment
    advice: str  # what to do at the bench
    score: float  # sum of squared predicted differences over the noise's variance, in two minutes at 10 Hz
    time_s: np.ndarray  # (n,) of the program
    predictions: tuple[np.ndarray, np.ndarray]  # (n, k) headline columns (or pressure) of each model
    columns: list[str]  # their names

    def apart(self, unit: str, noise: float | None) -> str:
        """How far the models lie apart there, a sentence; `unit` and `noise` are of the headline error."""
        most = float(np.linalg.norm(self.predictions[0] - self.predictions[1], axis=1).max())
        if self.columns == ["pressure_kpa"]:
            return f"There the two predict pressures up to {most:.2g} kPa apart."
        times = f", {most / noise:.2g} times the noise" if noise else ""
        return f"There the two predict up to {most:.2g} {unit} apart{times}."


def separations(
    recording: Recording, a: Twin, b: Twin, floor: float, effects: tuple[str, ...] = ()
) -> list[Separation]:
    """All experiments of the menu and of the first twin's laws, the one that separates two twins most first.

    `floor` is the noise in the unit of the headline error. Where one of the `effects` in which they differ is
    of the pneumatics and pressure was not measured, measuring it is on the menu.
    """
    found = []
    pneumatic = {get_effect(e).stage == "pneumatics" for e in effects}
    logged = any(c.replace("cmd_", "") in recording.samples for c in recording.pressure_columns)
    constants = {e: {k: v.value for k, v in a.effects[e].items()} for e in effects if e in a.effects}
    for program in [*menu(recording), *law_programs(recording, constants)]:
        pair = predictions(recording, program, a, b)
        if pair is None:
            continue
        (ya, pa), (yb, pb), columns = pair
        each = SECONDS * HZ / len(program.samples)
        score = each * float(((ya - yb) ** 2).sum() / max(floor, 1e-12) ** 2)
        t = program.samples["time_s"].to_numpy()
        found.append(Separation(program.name, program.advice, score, t, (ya, yb), columns))
        if pneumatic == {True, False} and not logged:
            noise = PRESSURE_NOISE * max(float(np.ptp(program.samples[recording.pressure_columns])), 1e-9)
            score = each * float(((pa - pb) ** 2).sum() / noise**2)
            advice = f"{LOG_ADVICE} {program.advice}"
            found.append(
                Separation(f"{LOG_PRESSURE}, {program.name}", advice, score, t, (pa, pb), ["pressure_kpa"])
            )
    return sorted(found, key=lambda s: -s.score)


def predictions(recording: Recording, program: Program, a: Twin, b: Twin):
    """What two twins predict of a program, as `predict`, and the columns; None where one cannot follow it."""
    planned = Recording(recording.folder, recording.meta, program.samples, recording.device)
    out = []
    for twin in (a, b):
        bench = BodyData.of(planned, twin, source="command", start="held")
        try:
            seen, pressure = predict(twin, bench)
        except InputError:  # a load too heavy for the joints under these conditions
            return None
        if not np.isfinite(seen).all():
            return None
        out.append((seen, pressure))
    return out[0], out[1], list(bench.columns[: bench.counted])


def predict(twin: Twin, bench: BodyData) -> tuple[np.ndarray, np.ndarray]:
    """What a twin predicts: headline columns (n, k) and pressure in the chambers (n, chambers), kPa."""
    pipeline = Pipeline.of(twin, bench.inputs)
    run = pipeline.run(bench.inputs, pipeline.theta(twin, bench.inputs.pressure_range_kpa))
    return pipeline.outputs(run, bench.columns[: bench.counted]), run.pressure_kpa


def read(recording: Recording, twin: Twin) -> BodyData:
    """A recording as a twin reads it: from the command, each step of it at its own instant.

    Where the twin remembers runs, and pauses between them are not stated, each run has one that suits it.
    """
    start: str | tuple[float, ...] = "auto"

    def at(share) -> BodyData:
        return BodyData.of(recording, twin, source="command", start=start, switch=share)

    data = at(None)
    pipeline = Pipeline.of(twin, data.inputs)
    theta = pipeline.theta(twin, data.inputs.pressure_range_kpa)
    if "pause_s" in twin.parameters:
        start = pauses(recording, data, np.arange(len(data)), pipeline, theta) or start
    if "switch_share" not in twin.parameters:
        return at(None)
    usual = twin.parameters["switch_share"].value
    return at(instants(recording, at, pipeline, theta, usual))
