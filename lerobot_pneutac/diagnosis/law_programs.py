"""The experiment that separates one law from its neighbours, made from its entry and its constants.

A lag shows after a step, for a few of its time constants; a play where the pressure turns, whatever the
speed; friction by speed; a limit that was passed only when one comes back below it.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from lerobot_pneutac.diagnosis.programs import HZ, STEP_S, Program, beside_one, pressure_span, table
from pneutac_datasets.recording.pressures import supply_limits
from pneutac_datasets.recording.recording import Recording
from pneutac_datasets.recording.wording import plural
from pneutac_sim.effects.laws import TABLE, family

MOST_S = 600.0
MOST_HZ = 100.0
WARMER_C = 8.0
LEAST_MOVE = 0.02  # of the range: regulators resolve a half to one percent
# Families of laws whose constants make them something else than their name says, to the experiment for that.
INSTEAD = {
    "stiffening": "stairs", "gain_saturation": "stairs", "cyclic_softening": "staying", "hysteresis": "turns",
}  # fmt: skip
EVENLY = "by as much at both"  # of what motion changed and comes back, at low and at high pressures

Knots = list[tuple[float, float]]  # seconds since the one before, kPa


def law_program(recording: Recording, name: str, constants: Mapping[str, float]) -> Program | None:
    """What to command to see a law, perhaps its second instance, of these constants, and what to look at.

    None for what is no law of the drive, needs several chambers (`programs.common_programs` drives these),
    lies beyond the supply, or needs moves below `LEAST_MOVE`.
    """
    row = TABLE.get(name.partition(" #")[0])
    if row is None or row.experiment not in _PROGRAMS:
        return None
    found = family(name, constants)
    if found != row.family:
        usual = "hold" if row.experiment in ("swing", "fill and vent") else row.experiment
        row = replace(row, experiment=INSTEAD.get(found, usual), family=found)
    low, top = pressure_span(recording)
    advice, knots, hz = _PROGRAMS[row.experiment](row, constants, low, top)
    time_s, kpa = np.array([(0.0, low), *knots]).T
    moves = np.abs(np.diff(kpa))
    if moves[moves > 1e-6].min() < LEAST_MOVE * (top - low) * (1 - 1e-6):
        return None
    if supply_limits(recording) and kpa.max() > top + 1e-6:
        return None  # no supply gives more
    time_s = np.cumsum(time_s)
    t = np.arange(int(min(time_s[-1], MOST_S) * hz)) / hz
    p, change = np.interp(t, time_s, kpa), {}
    if row.column == "temperature_c":
        cold = float(recording.samples["temperature_c"].median())
        if row.experiment != "warming":  # the whole program, then once more in the warm
            t, p = np.arange(2 * len(p)) / hz, np.tile(p, 2)
        change = {"temperature_c": np.where(np.arange(len(t)) < len(t) // 2, cold, cold + WARMER_C)}
        advice += f" Do the first half at {cold:.0f} °C, the second at {cold + WARMER_C:.0f} °C."
    return Program(f"for {name}", advice + beside_one(recording), table(recording, t, p, change))


def law_programs(recording: Recording, effects: Mapping[str, Mapping[str, float]]) -> list[Program]:
    """Of all laws among some effects, each with its constants."""
    made = (law_program(recording, name, constants) for name, constants in effects.items())
    return [p for p in made if p is not None]


def _hold(kpa: float, seconds: float) -> Knots:
    return [(STEP_S, kpa), (seconds, kpa)]


def _strokes(low: float, high: float, seconds: float, count: int) -> Knots:
    return [(seconds / 2, high), (seconds / 2, low)] * count


def _stairs(row, c, low, top):
    levels = np.linspace(low, top, 11)
    text = (
        f"Go from {low:.3g} to {top:.3g} kPa in ten equal stairs of 5 s, and down again: what depends on the "
        "pressure alone is the same on both ways, and its steps change evenly."
    )
    return text, [k for p in (*levels, *levels[-2::-1]) for k in _hold(p, 5.0)], HZ


def _around_threshold(row, c, low, top):
    a = c["threshold_kpa"]
    below, above = (
        int(np.clip(s / (LEAST_MOVE * (top - low)), 1, 5)) for s in (a - low, max(top, 1.2 * a) - a)
    )
    up = [*np.linspace(low, a, below + 1), *np.linspace(a, max(top, 1.2 * a), above + 1)[1:]]
    text = (
        f"Go in {plural(below, 'stair')} of 5 s from {low:.3g} to {a:.3g} kPa, in {above} more to "
        f"{up[-1]:.3g} kPa, and down again: up to {a:.3g} kPa nothing differs, above it each step does."
    )
    return text, [k for p in (*up, *up[-2::-1]) for k in _hold(p, 5.0)], HZ


def _after_steps(row, c, low, top):
    """Memories that relax: two levels identify the power of the pressure, a gain needs a third."""
    rate = c.get("rate_1_per_s", c.get("frequency_rad_per_s", 0.03))
    tau = c.get("time_s", c.get("fill_time_s", 1 / rate))
    hold, middle = float(np.clip(3 * tau, 3.0, 100.0)), 0.5 * (low + top)
    knots = [*_hold(middle, hold), *_hold(low, hold), *_hold(top, hold), *_hold(low, hold)]
    text = (
        f"Step to {middle:.3g} kPa and hold {hold:.3g} s, vent to {low:.3g} kPa for {hold:.3g} s, then "
        f"the same with {top:.3g} kPa"
    )
    falls = c.get("weight", 1.0) < 0
    goes = "falls back" if falls else "goes on"
    stops = f"the bend {goes} for {min(3 * tau, hold):.2g} s and then stops, and what comes late"
    seen = {
        "hold": f"{stops} doubles with the pressure",
        "hold, squared": f"{stops} grows with the square of the pressure",
        "hold, by pressure": f"the bend {goes}, faster or slower at the higher pressure",
        "hold, by warmth": f"the bend {goes}, faster or slower in the warm",
        "hold for long": f"the bend {goes} ever slower, from 10 to 100 s still, and does not stop",
        "loss": f"while the pressure is held the bend {'rises' if falls else 'falls'} at a steady pace",
        "hold, then less": f"at {middle:.3g} kPa it bends differently right after {top:.3g} kPa than after "
        "rest",
    }[row.experiment]
    if row.experiment == "hold, then less":
        knots += [*_hold(top, hold), *_hold(middle, hold)]
        text += f", then {top:.3g} kPa and {middle:.3g} kPa for {hold:.3g} s each"
    return f"{text}: {seen}.", knots, max(HZ, min(MOST_HZ, 5 / tau))


def _turns(row, c, low, top):
    r = c.get("width_kpa", max(c.get("width_up_kpa", 0.0), c.get("width_down_kpa", 0.0)))
    middle, knots = 0.5 * (low + top), []
    half = 0.5 * (top - low)
    least = 0.5 * LEAST_MOVE * (top - low)
    spans = [s for s in (r, 3 * r) if least <= s < 0.9 * half] + [half]
    for seconds in (20.0, 5.0):
        for span in spans:
            knots += [(5.0, middle - span), *_strokes(middle - span, middle + span, seconds, 2)]
    text = (
        f"Go back and forth about {middle:.3g} kPa by {', '.join(f'{s:.3g}' for s in spans)} kPa, "
        "twice each in 20 s, then the same in 5 s: the loop is as wide at both paces."
    )
    return text, knots, HZ


def _small_stairs(row, c, low, top):
    r = c["step_kpa"] if "step_kpa" in c else c["width_kpa"]
    middle, step = 0.5 * (low + top), min(0.5 * r, 0.05 * (top - low))
    levels = middle + step * np.r_[np.arange(11), np.arange(10)[::-1]]
    text = (
        f"From {middle:.3g} kPa go up ten times by {step:.2g} kPa, every 4 s, and down again: nothing moves "
        f"until the command is {r:.2g} kPa away, then it follows."
    )
    return text, [k for p in levels for k in _hold(p, 4.0)], HZ


def _over_the_snap(row, c, low, top):
    a, b, r = c["centre_kpa"], c["slope_kpa"], c["width_kpa"]
    below, above = max(low, a - b - r), min(max(top, a + r), a + b + r)
    knots = [*_strokes(low, max(top, above), 120.0, 1), (5.0, below), *_strokes(below, above, 30.0, 3)]
    text = (
        f"Go slowly from {low:.3g} to {max(top, above):.3g} kPa and back in 120 s, then three times between "
        f"{below:.3g} and {above:.3g} kPa in 30 s: it snaps near {a + r:.3g} kPa on the way up and near "
        f"{a - r:.3g} kPa on the way down."
    )
    return text, knots, HZ


def _swing(row, c, low, top):
    w, z = c["frequency_rad_per_s"], c["damping_ratio"]
    wait = float(np.clip(5 / (z * w), 2.0, 20.0))
    hz = float(np.clip(10 * w / (2 * np.pi), HZ, MOST_HZ))
    text = (
        f"Step from {low:.3g} to {top:.3g} kPa and back five times, {wait:.2g} s apart, and record at "
        f"{hz:.0f} Hz or more: it swings {w / (2 * np.pi):.2g} times a second about where it ends."
    )
    return text, [*_hold(low, 1.0), *([*_hold(top, wait), *_hold(low, wait)] * 5)], hz


def _fill_and_vent(row, c, low, top):
    fill, vent = c["fill_time_s"], c["vent_time_s"]
    wait, hz = (
        float(np.clip(5 * max(fill, vent), 2.0, 30.0)),
        float(np.clip(5 / min(fill, vent), HZ, MOST_HZ)),
    )
    middle = 0.5 * (low + top)
    text = (
        f"Step from {low:.3g} to {middle:.3g}, {low:.3g}, {top:.3g} and {low:.3g} kPa, {wait:.2g} s each, "
        f"three times, at {hz:.0f} Hz or more: filling takes {fill:.2g} s and venting {vent:.2g} s, "
        "at both levels."
    )
    return text, [k for p in (middle, low, top, low) * 3 for k in _hold(p, wait)], hz


def _paces(row, c, low, top):
    span = top - low
    rate = c.get("rate_kpa_per_s", span / 5)
    middle = float(np.clip(2 * span / rate, 6.0, 30.0))  # s there and back; no valve follows much faster
    seconds = [3 * middle, middle, middle / 3]
    knots = [k for s in seconds for k in _strokes(low, top, s, max(1, round(20 / s)))]
    text = (
        f"Go from {low:.3g} to {top:.3g} kPa and back in {seconds[0]:.3g}, {seconds[1]:.3g} and "
        f"{seconds[2]:.3g} s, then stop half way for 10 s: it differs by pace alone, and stops with "
        "the motion."
    )
    return text, [*knots, (seconds[-1] / 4, low + span / 2), (10.0, low + span / 2)], HZ


def _after_the_highest(row, c, low, top):
    """A largest pressure that fades, or stays: small strokes before and after one to the top."""
    middle = 0.5 * (low + top)
    wait = float(np.clip(3 * c.get("time_s", 20.0), 12.0, 300.0))
    small = _strokes(low, middle, 4.0, 3)
    knots = [
        *small,
        *_strokes(low, top, 4.0, 1),
        *_strokes(low, middle, 4.0, round(wait / 4)),
        *_hold(low, 20.0),
        *small,
    ]
    stays = "stay changed" if row.experiment == "staying" else f"are as before within {wait:.3g} s"
    text = (
        f"After a rest make three strokes to {middle:.3g} kPa, one to {top:.3g} kPa, then strokes to "
        f"{middle:.3g} kPa again for {wait:.3g} s, in 4 s each: the small strokes change at once after the "
        f"large one and {stays}."
    )
    return text, knots, HZ


def _many_strokes(row, c, low, top):
    count = int(np.clip(c["path_kpa"] / (top - low), 8, 100))
    text = (
        f"After a night's rest make {count} strokes from {low:.3g} to {top:.3g} kPa, in 4 s each: each bends "
        "a little otherwise than the one before, less and less so, and a pause does not undo it."
    )
    return text, _strokes(low, top, 4.0, count), HZ


def _work(row, c, low, top):
    """Motion that warms: about low and about high pressures, each with a rest after it."""
    tau, middle = c["time_s"], 0.5 * (low + top)
    move = float(np.clip(1.5 * tau, 20.0, 140.0))
    count, knots = round(move / 2), []
    for a, b in ((low, middle), (middle, top)):
        knots += [(2.0, a), *_strokes(a, b, 2.0, count), (2.0, top), (move, top)]
    more = "more so about the high pressures" if row.experiment == "motion, by pressure" else EVENLY
    text = (
        f"Make strokes of 2 s for {move:.3g} s between {low:.3g} and {middle:.3g} kPa, hold {top:.3g} kPa as "
        f"long, then the same between {middle:.3g} and {top:.3g} kPa: what motion changed comes back "
        f"while held, {more}."
    )
    return text, knots, HZ


def _warm_up(row, c, low, top):
    count = round(min(3 * c["time_s"], MOST_S) / 20)
    text = (
        f"After a night's rest make a stroke from {low:.3g} to {top:.3g} kPa every 20 s, {count} times: it "
        "changes with the time since the start, however little it moves."
    )
    return text, [k for _ in range(count) for k in (*_strokes(low, top, 6.0, 1), (14.0, low))], HZ


def _soak(row, c, low, top):
    count = round(min(6 * c["time_s"], MOST_S) / 20)
    text = f"Make a stroke from {low:.3g} to {top:.3g} kPa every 20 s, {count} times, as it warms."
    return text, [k for _ in range(count) for k in (*_strokes(low, top, 6.0, 1), (14.0, low))], HZ


# The catalogue's experiment to its program.
_PROGRAMS: dict[str, Callable[..., tuple[str, Knots, float]]] = {
    "stairs": _stairs,
    "turns": _turns,
    "paces": _paces,
    "threshold": _around_threshold,
    **dict.fromkeys(("hold", "hold, squared", "hold, then less", "hold, by pressure"), _after_steps),
    **dict.fromkeys(("hold, by warmth", "hold for long", "loss"), _after_steps),
    "fill and vent": _fill_and_vent,
    "swing": _swing,
    **dict.fromkeys(("fading", "staying"), _after_the_highest),
    "strokes": _many_strokes,
    "snap": _over_the_snap,
    "small stairs": _small_stairs,
    "from rest": _warm_up,
    "warming": _soak,
    **dict.fromkeys(("motion", "motion, by pressure"), _work),
}
