"""The next program: it separates contenders, narrows the best one's constants, and goes where none was.

Between contenders it is, in nats, a bound of the mutual information between which of them is true and what
will be measured (Kolchinsky and Tracey, Entropy 19 (2017) 361: pairwise distances, here the Kullback and
Leibler divergence of equal Gaussians); of the constants the expected gain of a linear model with a Gaussian
prior (Lindley, Ann. Math. Stat. 27 (1956) 986), their present intervals being the prior. There are many
constants and few laws, so their gain counts beside the largest that any program brings.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from lerobot_pneutac.diagnosis.experiment import predict
from lerobot_pneutac.diagnosis.hands import Hands
from lerobot_pneutac.diagnosis.law_programs import STEP_S, law_program
from lerobot_pneutac.diagnosis.limits import Limits, visited
from lerobot_pneutac.diagnosis.programs import table
from lerobot_pneutac.diagnosis.result import Contender
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError
from pneutac_sim.finger.data import BodyData
from pneutac_sim.twin import Twin, Value

INDEPENDENT_S = 1.0  # a model's error hardly changes within; so long a stretch counts as one measurement
OVERHEAD_S = 15.0  # that any program costs beside its own time
HAND_S = 60.0  # that what a hand changes costs beside
BY_HAND = ("strokes to 100% in 15 s", "stairs to 100%, 5 s each")  # programs for which a hand is asked
LITTLE = 0.05  # nats about contenders, or share of the time where none has been, that count as none
Z95 = 1.96

NO_HANDS = Hands()

Knots = list[tuple[float, float]]  # seconds since the one before, share of the range


@dataclass(frozen=True)
class Choice:
    """One program, and what it is expected to tell.

    Attributes:
        name: of the program.
        kind: programs of one kind differ in numbers alone.
        time_s: (n,) of its samples.
        pressure_kpa: (n,) commanded.
        rivals: nats about which contender is true.
        constants: nats about the best contender's constants.
        new: share of the time at levels, paces and rests that no recording has.
        predictions: (n, k) headline columns by each contender.
        worth: all three for a second of the bench's time, see `choices`.
        hand: what a hand changes for it, see `hands.HANDS`; empty for nothing.
        conditions: in force throughout; empty where no hand may change any.
    """

    name: str
    kind: str
    time_s: np.ndarray
    pressure_kpa: np.ndarray
    rivals: float
    constants: float
    new: float
    predictions: tuple[np.ndarray, ...]
    worth: float = 0.0
    hand: str = ""
    conditions: Mapping[str, float] = field(default_factory=dict)

    @property
    def seconds(self) -> float:
        """Its length."""
        return float(self.time_s[-1])

    @property
    def tells_little(self) -> bool:
        """Whether it is hardly worth the bench's time."""
        return self.rivals < LITTLE and self.new < LITTLE and self.constants < 1.0


def choices(
    recording: Recording,
    contenders: Sequence[Contender],
    noise: float,
    limits: Limits,
    hands: Hands = NO_HANDS,
) -> list[Choice]:
    """All programs that fit into the limits, the one that tells most for its time first.

    What a program tells is its nats about contenders, its share of the largest gain on constants, and the
    share of its time at levels, paces and rests that no recording has.

    Args:
        recording: all that has been measured, of a device with one chamber.
        contenders: models in the running, the best first.
        noise: floor of the headline error, in its unit.
        limits: of device and time.
        hands: what may be changed for a program.

    Raises:
        InputError: the device has several chambers, or no program fits.
    """
    if len(recording.pressure_columns) != 1:
        raise InputError(f"{recording.folder} has several chambers; programs are designed for one.")
    found = []
    seen = visited(recording, limits)
    fits = [p for p in _programs(recording, contenders, limits, hands) if p[2][-1] <= limits.seconds]
    if not fits:
        raise InputError(
            f"No program fits into the {limits.seconds:.0f} s that are left; give a larger budget."
        )
    sigma = noise / np.sqrt(_columns(recording, contenders[0].twin))
    for name, kind, t, p, hand in fits:
        conditions = hands.changes.get(hand, hands.usual)
        planned = _planned(recording, t, p, conditions)
        told = [x for c in contenders if (x := _predicted(planned, c.twin)) is not None]
        if len(told) < len(contenders):
            continue
        share = 1 / (sigma**2 * INDEPENDENT_S * limits.hz)
        rivals = nats_between(told, np.array([c.probability for c in contenders]), share)
        constants = _of_constants(planned, contenders[0].twin, told[0], share)
        cells = visited(planned, limits)
        new = sum(n for cell, n in cells.items() if cell not in seen) / sum(cells.values())
        found.append(
            Choice(name, kind, t, p, rivals, constants, new, tuple(told), hand=hand, conditions=conditions)
        )
    most = max((c.constants for c in found), default=0.0) or 1.0
    weighed = [
        replace(
            c,
            worth=(c.rivals + c.constants / most + c.new) / (c.seconds + OVERHEAD_S + HAND_S * bool(c.hand)),
        )
        for c in found
    ]
    return sorted(weighed, key=lambda c: -c.worth)


def first_program(limits: Limits) -> tuple[np.ndarray, np.ndarray]:
    """Time and command (n,) of what to begin with: stairs, a slow and a fast stroke, steps and a hold."""
    stairs = [0.0, 0.25, 0.5, 0.75, 1.0, 0.75, 0.5, 0.25, 0.0]
    knots = [k for x in stairs for k in _hold(x, 2.0)]
    knots += [(8.0, 0.9), (8.0, 0.0), (2.0, 1.0), (2.0, 0.0), *_hold(0.8, 9.0), *_hold(0.0, 5.0)]
    knots += [*_hold(0.5, 3.0), *_hold(0.2, 3.0), *_hold(1.0, 3.0), *_hold(0.0, 2.0)]
    return _sampled(knots, limits)


def common_programs(limits: Limits) -> Iterator[tuple[str, str, np.ndarray, np.ndarray]]:
    """Name, kind, time and command (n,) of the programs that are no law's own."""
    for name, kind, knots in _grid():
        yield name, kind, *_sampled(knots, limits)


def nats_between(told: Sequence[np.ndarray], probability: np.ndarray, share: float) -> float:
    """Nats about which of n models is true, from what each predicts of a measurement.

    Args:
        told: of each model the same numbers.
        probability: (n,) of each model.
        share: what a squared difference of one number counts: one over its variance, less where neighbours
            are alike.
    """
    p = probability / probability.sum()
    apart = np.array([[((a - b) ** 2).sum() for b in told] for a in told]) * share / 2
    return float(-(p * np.log(np.maximum(np.exp(-apart) @ p, 1e-300))).sum())


# ---------------------------------------------------------------- what there is to choose from


def _programs(
    recording: Recording, contenders: Sequence[Contender], limits: Limits, hands: Hands
) -> Iterator[tuple[str, str, np.ndarray, np.ndarray, str]]:
    """Name, kind, time, command and what a hand changes."""
    for name, kind, t, p in common_programs(limits):
        yield name, kind, t, p, ""
        if name in BY_HAND:
            for hand in hands.changes:
                yield f"{name}, {hand}", hand, t, p, hand
    had = set()
    for c in contenders:
        for effect in (e for e in c.terms if e not in had):
            had.add(effect)
            values = {k: v.value for k, v in c.twin.effects.get(effect, {}).items()}
            law = law_program(recording, effect, values) if values else None
            if law is None or (recording.has("temperature_c") and law.samples["temperature_c"].nunique() > 1):
                continue  # none, or one that asks for a warm room
            t = law.samples["time_s"].to_numpy(float)
            p = law.samples[recording.pressure_columns[0]].to_numpy(float)
            grid = np.arange(round(t[-1] * limits.hz) + 1) / limits.hz
            p = np.clip(np.interp(grid, t, p), limits.low_kpa, limits.high_kpa)
            yield f"for {effect}", f"for {effect}", grid, p, ""


def _grid() -> Iterator[tuple[str, str, Knots]]:
    """Amplitude x pace x hold, each about 60 s long and from rest to rest."""
    for a in (0.4, 0.7, 1.0):
        for hold in (2.0, 6.0, 15.0):
            count = max(1, round(60 / (2 * hold)))
            yield (
                f"steps to {a:.0%}, held {hold:g} s", "steps",
                [*_hold(0.0, 1.0), *([*_hold(a, hold), *_hold(0.0, hold)] * count)],
            )  # fmt: skip
        for half in (1.5, 4.0, 15.0):
            count = max(1, round(60 / (2 * half)))
            yield f"strokes to {a:.0%} in {half:g} s", "strokes", [(half, a), (half, 0.0)] * count
    for a in (0.6, 1.0):
        for dwell in (2.0, 5.0):
            levels = a * np.r_[0:7, 5:-1:-1] / 6
            count = max(1, round(60 / (dwell * len(levels))))
            knots = [k for x in np.tile(levels, count) for k in _hold(x, dwell)]
            yield f"stairs to {a:.0%}, {dwell:g} s each", "stairs", knots
    for span in (0.1, 0.3):
        for half in (1.0, 4.0):
            for middle in (0.35, 0.65):
                count = max(1, round(50 / (2 * half)))
                turns = [(half, middle + span), (half, middle - span)] * count
                yield (
                    f"loops of {span:.0%} about {middle:.0%} in {half:g} s", "loops",
                    [(3.0, middle - span), *turns, (3.0, 0.0)],
                )  # fmt: skip
    for a in (0.4, 0.9):
        yield f"hold at {a:.0%}", "hold", [*_hold(0.0, 1.0), *_hold(a, 40.0), *_hold(0.0, 19.0)]
    turn = np.arange(600) * 0.1
    chirp = 0.5 - 0.4 * np.cos(2 * np.pi * 0.03 * 60 / np.log(30) * (30 ** (turn / 60) - 1))
    yield "chirp", "chirp", [(0.1, float(x)) for x in chirp]
    rng = np.random.default_rng(0)
    for number in (1, 2):
        levels, holds = rng.uniform(0, 1, 24), np.exp(rng.uniform(np.log(0.5), np.log(6.0), 24))
        holds *= 60 / holds.sum()
        knots = [k for x, s in zip(levels, holds, strict=True) for k in _hold(float(x), float(s))]
        yield f"random holds {number}", "random holds", knots


def _hold(share: float, seconds: float) -> Knots:
    return [(STEP_S, share), (seconds - STEP_S, share)]


def _sampled(knots: Knots, limits: Limits) -> tuple[np.ndarray, np.ndarray]:
    """Time and pressure (n,) of shares of the range at times for a length of 60 s."""
    scale = limits.length_s / 60.0
    time_s, share = np.array([(0.0, 0.0), *knots]).T
    time_s = np.cumsum(np.where(time_s <= STEP_S, time_s, scale * time_s))
    grid = np.arange(round(time_s[-1] * limits.hz) + 1) / limits.hz
    return grid, limits.rest_kpa + (limits.far_kpa - limits.rest_kpa) * np.interp(grid, time_s, share)


# ---------------------------------------------------------------- what each would tell


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


def _of_constants(planned: Recording, twin: Twin, told: np.ndarray, share: float) -> float:
    """Nats about the constants, each moved by one standard deviation."""
    moved = []
    for other in _perturbed(twin):
        seen = _predicted(planned, other)
        if seen is not None:
            moved.append((seen - told).ravel())
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
