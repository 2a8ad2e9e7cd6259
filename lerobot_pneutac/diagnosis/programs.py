"""Programs of pressure: their limits, the menu of next experiments, and what a hand changes between two.

Of several chambers each common program is driven on each alone, on each two and on all, and some turn the
bend about the axis.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from pneutac_datasets.recording.mounts import CONDITIONS
from pneutac_datasets.recording.pressures import supply_limits
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError, refuse_given
from pneutac_sim.finger.inputs import steps

LEVELS = 8  # of pressure
PACES = (0.02, 0.2, 1.0)  # of the range a second
STILL_S = (2.0, 10.0)  # that the command has stood
PRESSED = 1 / 16  # of the range: from there on a chamber counts as one that is under pressure

MOST_SAMPLES = 10**6  # of a program: 14 h at 20 Hz


@dataclass(frozen=True, eq=False)
class Limits:
    """What a program may do."""

    low_kpa: np.ndarray  # lowest set-point of each chamber (chambers,); a number where all have one
    high_kpa: np.ndarray  # highest one, likewise
    hz: float = 20.0  # samples a second
    seconds: float = 600.0  # most that is left
    length_s: float = 60.0  # of the programs that are no law's own; all their times scale with it

    def __post_init__(self):
        low, high = np.broadcast_arrays(
            *(np.atleast_1d(x).astype(float) for x in (self.low_kpa, self.high_kpa))
        )
        object.__setattr__(self, "low_kpa", low)
        object.__setattr__(self, "high_kpa", high)
        if not max(self.seconds, self.length_s) * self.hz <= MOST_SAMPLES:
            longest = f"{max(self.seconds, self.length_s):g} s at {self.hz:g} samples a second"
            raise InputError(f"A program may have up to {MOST_SAMPLES} samples, not {longest}; give less.")
        for i in np.flatnonzero(~(low < high)):
            where = f" in chamber {i + 1}" if len(low) > 1 else ""
            raise InputError(
                f"No program fits between {low[i]:g} and {high[i]:g} kPa{where}; give a wider range."
            )

    @property
    def chambers(self) -> int:
        return len(self.low_kpa)

    @property
    def rest_kpa(self) -> np.ndarray:
        """(chambers,) where programs begin: without pressure, as far as the limits allow."""
        return np.minimum(np.maximum(0.0, self.low_kpa), self.high_kpa)

    @property
    def far_kpa(self) -> np.ndarray:
        """(chambers,) to where common programs go: the highest set-point, or vacuum where rest is that."""
        return np.where(self.high_kpa > self.rest_kpa, self.high_kpa, self.low_kpa)

    def pressure_kpa(self, share: np.ndarray) -> np.ndarray:
        """Set-points (n, chambers) of shares (n, chambers) of the way from rest to there."""
        return self.rest_kpa + (self.far_kpa - self.rest_kpa) * share


def visited(recording: Recording, limits: Limits) -> dict[tuple, float]:
    """Cell of conditions, level, direction and pace, or of level and time at rest, to seconds spent in it.

    Each chamber has cells of its own, one set for each choice of others that are under pressure meanwhile.
    """
    cells: dict[tuple, float] = {}
    span, scale = limits.far_kpa - limits.rest_kpa, limits.length_s / 60.0
    clock = recording.column("time_s")
    command = recording.samples[recording.pressure_columns].to_numpy(float)
    names = [c for c in CONDITIONS if c != "temperature_c" and recording.has(c)]  # that one is never still
    conditions = [np.round(recording.column(c) / CONDITIONS[c]) for c in names]
    for rows in recording.trials().values():
        t, held = clock[rows], tuple(c[rows][0] for c in conditions)
        dt = np.diff(t, append=t[-1] + (t[-1] - t[-2] if len(t) > 1 else 0.1))
        shares = (command[rows] - limits.rest_kpa) / span
        pressed = shares > PRESSED
        for chamber, share in enumerate(shares.T):
            rate = np.gradient(share, t) if len(t) > 1 else np.zeros(1)
            since, still = 0.0, []
            for moving, step in zip(np.abs(rate) > 1e-3, dt, strict=True):
                since = 0.0 if moving else since + step
                still.append(since)
            level = np.clip((LEVELS * share).astype(int), 0, LEVELS - 1)
            pace = np.digitize(np.abs(rate) * scale, PACES)
            rest = np.digitize(np.array(still) / scale, STILL_S)
            neighbours = np.delete(pressed, chamber, axis=1)
            for i in range(len(t)):
                moves = abs(rate[i]) > 1e-3
                motion = (np.sign(rate[i]), pace[i]) if moves else (0, 10 + rest[i])
                cell = (held, level[i], *motion, chamber, *neighbours[i])
                cells[cell] = cells.get(cell, 0.0) + float(dt[i])
    return cells


SECONDS = 120.0
HZ = 10.0
STEP_S = 1e-3  # that a commanded step takes
HIGHER = "higher"
GOLDEN = 0.618034  # its multiples' fractions fill an interval as evenly as any


@dataclass
class Program:
    """One experiment."""

    name: str  # short, for tables
    advice: str  # an imperative sentence for the person at the bench
    samples: pd.DataFrame  # what would be commanded, one row a sample, with the recording's conditions


def menu(recording: Recording) -> list[Program]:
    """All experiments that make sense for this recording's columns."""
    low, top = pressure_span(recording)
    t = np.arange(round(SECONDS * HZ)) / HZ
    made = _pressure_programs(t, low, top) + _condition_programs(recording, _triangle(t, 60.0, low, top))
    neighbours = beside_one(recording)
    return [
        Program(name, advice + neighbours, table(recording, t, p, change))
        for name, advice, p, change in made
        if name != HIGHER or not supply_limits(recording)  # no supply gives more
    ]


def beside_one(recording: Recording) -> str:
    """A sentence on which chamber is meant, with a space before it; empty where there is one."""
    first, *others = recording.pressure_columns
    if not others:
        return ""
    stay = " and ".join(f"{recording.samples[c].median():.3g}" for c in others)
    return f" Do so in chamber 1, while the others stay at {stay} kPa."


def pressure_span(recording: Recording) -> tuple[float, float]:
    """Lowest (zero at most) and highest commanded pressure, kPa."""
    command = recording.samples[recording.pressure_columns].to_numpy(float)
    low, top = float(min(command.min(), 0.0)), float(command.max())
    return low, top if top - low >= 1e-6 else low + 50.0


def _triangle(t: np.ndarray, period: float, low: float, high: float) -> np.ndarray:
    return low + (high - low) * (1 - np.abs(1 - 2 * ((t / period) % 1)))


def _stairs(t: np.ndarray, low: float, high: float) -> np.ndarray:
    levels = np.concatenate([np.linspace(low, high, 7), np.linspace(high, low, 7)[1:]])
    return levels[np.minimum((t / SECONDS * len(levels)).astype(int), len(levels) - 1)]


def _pressure_programs(t: np.ndarray, low: float, top: float) -> list[tuple[str, str, np.ndarray, dict]]:
    """Name, advice, command (n,) and no change of conditions."""
    span, loop = top - low, 120.0
    whole = f"between {low:.3g} and {top:.3g} kPa"
    high, most, higher = low + 0.8 * span, low + 0.9 * span, low + 1.3 * span
    steps = np.where(t % 20 < 10, low + 0.9 * span, low)
    middle = low + 0.5 * span + 0.08 * span * np.sin(2 * np.pi * t / 8) + 0.3 * span * (t > 60)
    zero = np.where(t % 30 < 10, 0.0, low + span * (0.4 + 0.6 * ((t // 30) % 2)))
    warmup = np.where(t < 60, _triangle(t, 4.0, low, low + 0.5 * span), _triangle(t, 4.0, low, top))
    return [
        ("slow loop", f"Run one loop {whole} ten times slower, in {loop:.0f} s.",
         _triangle(t, loop, low, top), {}),
        ("fast loops", f"Run loops {whole} in 4 s each.", _triangle(t, 4.0, low, top), {}),
        ("long hold", f"Step to {high:.3g} kPa, hold 80 s, step to {low:.3g} kPa and hold 40 s.",
         np.where(t < 80, high, low), {}),
        ("steps", f"Step between {low:.3g} and {most:.3g} kPa every 10 s.", steps, {}),
        (HIGHER, f"Go up in stairs to {higher:.3g} kPa if the device may bear it, and down again.",
         _stairs(t, low, higher), {}),
        ("small reversals", "Make small back-and-forth moves around two pressures.", middle, {}),
        ("back to zero", "Come back to 0 kPa for 10 s every half minute.", zero, {}),
        ("cycles", "After a rest make fifteen cycles to half the pressure and fifteen to the full one.",
         warmup, {}),
    ]  # fmt: skip


def _condition_programs(recording: Recording, loop: np.ndarray) -> list[tuple[str, str, np.ndarray, dict]]:
    """Name, advice, command (n,) and the conditions that change, of those that were recorded."""
    s, made = recording.samples, []
    if recording.has("gravity_x"):
        columns = ["gravity_x", "gravity_y", "gravity_z"]
        flipped = dict(zip(columns, -s[columns].iloc[0].to_numpy(float), strict=True))
        made.append(("flip the base", "Turn the base upside down and run one loop.", loop, flipped))
    if recording.has("temperature_c"):
        warm = float(s["temperature_c"].median()) + 8.0
        advice = f"Repeat a loop with the device at {warm:.0f} °C."
        made.append(("warm", advice, loop, {"temperature_c": warm}))
    if recording.has("payload_g"):
        heavy = float(s["payload_g"].max()) + 50.0
        made.append(
            ("payload", f"Hang {heavy:.0f} g at the tip and run one loop.", loop, {"payload_g": heavy})
        )
    return made


def table(recording: Recording, t: np.ndarray, p: np.ndarray, change: dict) -> pd.DataFrame:
    """All columns of the recording: conditions and markers at their usual value, the command as given.

    `t` (n,) s, and `p` (n, chambers) commanded, kPa; (n,) is the first chamber's, while others stay at their
    median. `change` has columns that are otherwise, and their values.
    """
    table = pd.DataFrame({"trial": np.zeros(len(t), int), "time_s": t})
    if recording.has("time_sent_s"):
        table["time_sent_s"] = sent_s(t, p)
    for i, c in enumerate(recording.pressure_columns):
        table[c] = p[:, i] if p.ndim > 1 else p if i == 0 else float(recording.samples[c].median())
    for c in recording.samples.columns:
        if c in table or c in ("program", "image", "mask"):
            continue
        x = recording.samples[c]
        if pd.api.types.is_numeric_dtype(x):
            table[c] = float(x.iloc[0]) if c.startswith("gravity") else float(x.median())
    for c in [c for c in table if c.startswith("pressure_") and "cmd" not in c]:
        command = c.replace("pressure_", "pressure_cmd_")
        if command in table:
            table[c] = table[command]
    for c, v in change.items():
        table[c] = v
    return table


def sent_s(t: np.ndarray, p: np.ndarray) -> np.ndarray:
    """When the command of each sample is sent, (n,) s: at the sample, but a step up to a sample before it.

    Each step keeps another lead, so that together they are seen at all ages: samples that come at one age
    alone identify a delay only to the time between two of them (equivalent-time sampling). `t` (n,) s is of
    the samples, `p` (n, chambers) commanded, or (n,) of one chamber.
    """
    p = np.reshape(p, (len(t), -1))
    at = steps(p, np.arange(len(t)) == 0)
    lead = (np.random.default_rng(at).random() + GOLDEN * np.arange(len(at))) % 1
    out = np.array(t, float)
    out[at] -= lead * (t[at] - t[at - 1])
    return out


Share = float | np.ndarray  # of the range, of all chambers or of each (chambers,)
Knots = list[tuple[float, Share]]  # seconds since the one before, and where to


def ways(chambers: int) -> Iterator[tuple[str, np.ndarray]]:
    """Which chambers go along: a name, empty of one chamber, and the share of each (chambers,)."""
    one = np.eye(chambers)
    if chambers == 1:
        yield "", one[0]
        return
    for i in range(chambers):
        yield f"chamber {i + 1}", one[i]
    for i in range(chambers if chambers > 2 else 0):
        other = (i + 1) % chambers
        a, b = sorted((i + 1, other + 1))
        yield f"chambers {a} and {b}", one[i] + one[other]
    yield "all chambers", one.sum(axis=0)


def on_chambers(name: str, way: str) -> str:
    """A program's name with the chambers that it goes to."""
    return f"{name}, {way}" if way else name


def turning(chambers: int, turn_s: float, share: float, turns: float) -> Knots:
    """The bend goes round the axis, the last half of the turns backwards; from rest to rest."""
    steps = 24
    phase = np.arange(round(turns * steps) + 1)
    phase = np.minimum(phase, phase[-1] - phase) * 2 * np.pi / steps
    around = np.maximum(np.cos(phase[:, None] - 2 * np.pi * np.arange(chambers) / chambers), 0.0)
    way = [(turn_s / steps, share * x) for x in around[1:]]
    return [(turn_s / 4, share * around[0]), *way, (turn_s / 4, 0.0)]


def first_program(limits: Limits) -> tuple[np.ndarray, np.ndarray]:
    """Time (n,) and command (n, chambers) of what to begin with: stairs, steps, a hold, strokes or turns."""
    if limits.chambers > 1:
        return sampled(_first_of_several(limits.chambers), limits)
    stairs = [0.0, 0.25, 0.5, 0.75, 1.0, 0.75, 0.5, 0.25, 0.0]
    knots = [k for x in stairs for k in hold(x, 2.0)]
    knots += [(8.0, 0.9), (8.0, 0.0), (2.0, 1.0), (2.0, 0.0), *hold(0.8, 9.0), *hold(0.0, 5.0)]
    knots += [*hold(0.5, 3.0), *hold(0.2, 3.0), *hold(1.0, 3.0), *hold(0.0, 2.0)]
    return sampled(knots, limits)


def _first_of_several(chambers: int) -> Knots:
    one = np.eye(chambers)
    knots: Knots = hold(0.0, 1.0)
    for alone in one:
        knots += [k for x in (0.33, 0.67, 1.0, 0.5, 0.0) for k in hold(x * alone, 2.0)]
    knots += turning(chambers, 12.0, 0.9, 2.0)
    knots += [*hold(0.5 * one.sum(0), 2.0), *hold(one.sum(0), 3.0), *hold(0.0, 2.0)]
    knots += [*hold(0.8 * one[0], 9.0), *hold(0.0, 5.0)]
    knots += [*hold(0.5 * one[1], 3.0), *hold(0.2 * one[1], 3.0), *hold(one[1], 3.0), *hold(0.0, 2.0)]
    return knots


def common_programs(limits: Limits) -> Iterator[tuple[str, str, np.ndarray, np.ndarray]]:
    """Name, kind, time (n,) and command (n, chambers) of each."""
    for name, kind, knots in _grid():
        for way, shares in ways(limits.chambers):
            along: Knots = [(s, x * shares) for s, x in knots]
            yield on_chambers(name, way), kind, *sampled(along, limits)
    for share in (0.4, 0.7, 1.0) if limits.chambers > 1 else ():
        for turn_s in (4.0, 12.0, 29.0):
            turns = max(1.0, round(58 / turn_s) - 0.5)
            knots = turning(limits.chambers, turn_s, share, turns)
            yield f"turns at {share:.0%} in {turn_s:g} s", "turns", *sampled(knots, limits)


def _grid() -> Iterator[tuple[str, str, Knots]]:
    """Amplitude x pace x hold, each about 60 s long and from rest to rest."""
    for a in (0.4, 0.7, 1.0):
        for hold_s in (2.0, 6.0, 15.0):
            count = max(1, round(60 / (2 * hold_s)))
            yield (
                f"steps to {a:.0%}, held {hold_s:g} s", "steps",
                [*hold(0.0, 1.0), *([*hold(a, hold_s), *hold(0.0, hold_s)] * count)],
            )  # fmt: skip
        for half in (1.5, 4.0, 15.0):
            count = max(1, round(60 / (2 * half)))
            yield f"strokes to {a:.0%} in {half:g} s", "strokes", [(half, a), (half, 0.0)] * count
    for a in (0.6, 1.0):
        for dwell in (2.0, 5.0):
            levels = a * np.r_[0:7, 5:-1:-1] / 6
            count = max(1, round(60 / (dwell * len(levels))))
            knots = [k for x in np.tile(levels, count) for k in hold(x, dwell)]
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
        yield f"hold at {a:.0%}", "hold", [*hold(0.0, 1.0), *hold(a, 40.0), *hold(0.0, 19.0)]
    turn = np.arange(600) * 0.1
    chirp = 0.5 - 0.4 * np.cos(2 * np.pi * 0.03 * 60 / np.log(30) * (30 ** (turn / 60) - 1))
    yield "chirp", "chirp", [(0.1, float(x)) for x in chirp]
    rng = np.random.default_rng(0)
    for number in (1, 2):
        levels, holds = rng.uniform(0, 1, 24), np.exp(rng.uniform(np.log(0.5), np.log(6.0), 24))
        holds *= 60 / holds.sum()
        knots = [k for x, s in zip(levels, holds, strict=True) for k in hold(float(x), float(s))]
        yield f"random holds {number}", "random holds", knots


def hold(share: Share, seconds: float) -> Knots:
    return [(STEP_S, share), (seconds - STEP_S, share)]


def sampled(knots: Knots, limits: Limits) -> tuple[np.ndarray, np.ndarray]:
    """Time (n,) and pressure (n, chambers) of shares of the range at times for a length of 60 s."""
    scale = limits.length_s / 60.0
    time_s = np.array([0.0, *(s for s, _ in knots)])
    share = np.array([np.broadcast_to(x, limits.chambers) for x in (0.0, *(x for _, x in knots))])
    time_s = np.cumsum(np.where(time_s <= STEP_S, time_s, scale * time_s))
    grid = np.arange(round(time_s[-1] * limits.hz) + 1) / limits.hz
    kpa = limits.pressure_kpa(np.stack([np.interp(grid, time_s, x) for x in share.T], axis=1))
    return grid, np.clip(kpa, limits.low_kpa, limits.high_kpa)  # rounding


HANDS = ("flip", "payload", "warm")
GRAVITY = ("gravity_x", "gravity_y", "gravity_z")


def _nobody(sentence: str) -> None:
    raise InputError(f"{sentence} There is no terminal to ask.")


@dataclass(frozen=True)
class Hands:
    """What may be changed, and who does it."""

    # condition columns and their values while nothing is changed; empty where nothing may be
    usual: Mapping[str, float] = field(default_factory=dict)
    # name to the conditions that are in force instead for a whole program
    changes: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    ask: Callable[[str], None] = _nobody  # called with a sentence for a person; returns once it is done

    @classmethod
    def of(
        cls,
        names: Sequence[str],
        usual: Mapping[str, float],
        payload_g: float,
        warm_c: float = 35.0,
        ask: Callable[[str], None] = _nobody,
    ) -> "Hands":
        """The changes of these names.

        Args:
            names: of `HANDS`.
            usual: conditions of the bench, with `gravity_x`, `gravity_y`, `gravity_z` of length 1 in the
                base's frame, and for `warm` with `temperature_c`.
            payload_g: weight that can be hung at the tip.
            warm_c: to which it can be warmed.
            ask: see the class.

        Raises:
            InputError: a name is unknown, or the direction of gravity or the temperature is not given.
        """
        if not names:
            return cls()
        for name in names:
            if name not in HANDS:
                raise InputError(f"hands={name} must be none, or some of {', '.join(HANDS)}.")
        if not set(GRAVITY) <= set(usual):
            raise InputError(
                "hands needs the direction of gravity in the base's frame: columns gravity_x, gravity_y and "
                "gravity_z, which `conditions: {gravity_x: 1, gravity_y: 0, gravity_z: 0}` of a bench writes."
            )
        if "warm" in names and "temperature_c" not in usual:
            raise InputError("hands=warm needs temperature_c, which `conditions` of a bench writes.")
        usual = dict(usual) | ({"payload_g": 0.0} if "payload" in names else {})
        known = {
            "flip": {g: -usual[g] + 0.0 for g in GRAVITY},
            "payload": {"payload_g": payload_g},
            "warm": {"temperature_c": warm_c},
        }
        return cls(usual, {n: usual | known[n] for n in names}, ask)


def named(text: str) -> tuple[str, ...]:
    """Names out of an option such as `flip,payload`; none of `none`."""
    return () if text == "none" else tuple(n.strip() for n in text.split(","))


def refuse_unused(options) -> None:
    """Raises InputError where the options of a command give a weight or a warmth that no hand brings."""
    for hand, name in (("payload", "payload_g"), ("warm", "warm_c")):
        if hand not in named(options.hands):
            refuse_given(options, (name,), f"is of --hands={hand}, which is not given")


def instructions(before: Mapping[str, float], after: Mapping[str, float]) -> list[str]:
    """What a person does between two programs, a sentence each."""
    steps = []
    if any(before.get(g) != after.get(g) for g in GRAVITY) and set(GRAVITY) <= set(after):
        toward = ", ".join(f"{after[g]:g}" for g in GRAVITY)
        steps.append(f"Turn the base so that gravity points along ({toward}) in its own frame.")
    weight = after.get("payload_g", 0.0)
    if before.get("payload_g", 0.0) != weight:
        steps.append(f"Hang {weight:g} g at the tip." if weight else "Take the weight off the tip.")
    warmth = after.get("temperature_c")
    if warmth is not None and before.get("temperature_c") != warmth:
        steps.append(f"Bring the finger to {warmth:g} °C.")
    return steps
