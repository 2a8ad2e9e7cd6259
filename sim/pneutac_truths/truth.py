"""A truth: a recording of a device of which everything is known, and how it is written.

From a device, its effects and a seed to a recording: the stages in order, and the effects' sizes.
"""

import json
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import pandas as pd

from pneutac_truths.cosserat import move
from pneutac_truths.effects import EFFECTS, STAGES
from pneutac_truths.effects.air import swing as swing_of
from pneutac_truths.effects.material import room_temperature
from pneutac_truths.programs import Plan
from pneutac_truths.rod import against_wall
from pneutac_truths.world import CHAMBERS, Seen, World, in_columns, logged, stream

WARMER_C = 17.0
SIX = {"command": 1, "air": 1, "drive": 1, "material": 2, "load": 1}  # of what `device` is made

PAIRS: dict[str, tuple[str, ...]] = {
    "creep_and_slow_fill": ("creep_fractional", "fill_orifice"),
    "creep_and_hysteresis": ("creep_fractional", "hysteresis_preisach"),
    "friction_and_deadband": ("friction_maxwell", "valve_deadband"),
    "gravity_and_payload": ("gravity", "payload"),
    "stretch_and_unfolding": ("stretch", "unfolding"),
    "temperature_and_mullins": ("temperature_drift", "mullins"),
    "leak_and_late_gauge": ("leak", "gauge_late"),
    "late_tracker_and_rate": ("tracker_latency", "rate_stiffening"),
    "slip_and_swelling": ("marker_slip", "humidity_swelling"),
    "hunting_and_lowpass": ("hunting", "tracker_lowpass"),
    "wall_and_gravity": ("wall_lean", "gravity"),
    "bow_and_locking": ("regulator_bow", "chain_locking"),
}


@dataclass(frozen=True)
class Truth:
    """One recording and what is behind it."""

    device: str  # `rod`, `arm` or `cosserat`
    seed: int  # of the device
    day: int  # of the recording
    effects: dict[str, dict[str, float]]  # name to its drawn parameters
    meta: dict  # what recording.json holds
    samples: pd.DataFrame  # the table as logged
    observed: list[str]  # columns of the pose
    pose: np.ndarray  # (rows, columns) the log without noise, in the columns' units
    true_pose: np.ndarray  # (rows, columns) where the device truly is at the stamps
    noise_floor: float  # rms Euclidean noise of the pose, in its unit
    pauses_s: list[float]  # (trials,) rest before each trial
    top_kpa: float  # highest commanded pressure


def named(device: str, effects: Sequence[str], seed: int) -> tuple[str, ...]:
    """Names of single effects for names that may be pairs, `plain` or `device`.

    Raises ValueError where a name is unknown, or does not apply to the device.
    """
    if device not in CHAMBERS:
        raise ValueError(f"There is no device '{device}'; it must be one of {', '.join(CHAMBERS)}.")
    out = []
    for name in effects:
        out += {"plain": [], "device": _six(device, seed)}.get(name, PAIRS.get(name, [name]))
    for name in out:
        if name not in EFFECTS:
            raise ValueError(f"There is no effect '{name}'; see pneutac_truths.EFFECTS and PAIRS.")
        if device not in EFFECTS[name].devices:
            raise ValueError(f"Effect '{name}' applies to {', '.join(EFFECTS[name].devices)}, not {device}.")
    return tuple(dict.fromkeys(out))


def _six(device: str, seed: int) -> list[str]:
    rng = stream(seed, device, "six")
    out = []
    for stage, n in SIX.items():
        fit = [e.name for e in EFFECTS.values() if e.stage == stage and device in e.devices and e.physics]
        out += [str(x) for x in rng.choice(fit, n, replace=False)]
    return out


def generate(
    device: str,
    effects: Sequence[str],
    seed: int,
    day: int = 1,
    gauge: bool | None = None,
    minutes: float | None = None,
    state_noise: bool = True,
    state_pauses: bool = False,
    log_sent: bool = False,
    plan: Plan | None = None,
    lab: bool = False,
    strength: float | None = None,
) -> Truth:
    """Makes one recording of a device.

    Args:
        device: `rod`, `arm` or `cosserat`.
        effects: names of `EFFECTS` or `PAIRS`, `plain` for none, `device` for six drawn from the seed.
        seed: of the device; all its numbers and those of its effects.
        day: another day is the same device with other programs, pauses and noise.
        gauge: whether the pressure is measured; None draws it.
        minutes: of recording; None takes the usual time of the device.
        state_noise: whether recording.json states the noise.
        state_pauses: whether recording.json states how long the device rested before each trial.
        log_sent: whether the log has when each command was sent; otherwise it is drawn.
        plan: what is commanded, see `programs.given`; None draws it.
        lab: whether a third of the trials are in a room that is `WARMER_C` warmer, as the log shows (the
            device heeds it only where one of its effects does), and the base is turned in its plane alone.
        strength: of each effect, see `make.sized`; None draws it.

    Raises ValueError: an unknown name, a gauge's fault without a gauge, or a length of no recording.
    """
    names = named(device, effects, seed)
    minutes = MINUTES[device] if minutes is None else minutes
    if not 0 < minutes <= MOST_MINUTES:
        raise ValueError(f"minutes is {minutes:g}; give more than 0 and at most {MOST_MINUTES:g}.")
    faulty = [n for n in names if EFFECTS[n].stage == "gauge"]
    if faulty and gauge is False:
        raise ValueError(f"Effect '{faulty[0]}' needs a gauge.")
    rng = stream(seed, device, day, "log")
    gauged = bool(faulty) or (stream(seed, "gauge").random() < 0.5 if gauge is None else gauge)
    drawn = draw(device, names, seed, strength, plan)
    w = World.start(device, seed, day, minutes, plan)
    w.in_plane = lab
    truly, seen = run(w, drawn)
    samples = _commands(w, rng, log_sent)
    noise = {}
    if gauged:
        read = read_gauge(w, drawn)[w.plan.rows] * w.body.top_kpa
        sd = w.body.gauge_noise_kpa
        for j, name in enumerate(_numbered("pressure_{}kpa", read.shape[1])):
            samples[name] = read[:, j] + rng.normal(0, sd, len(read))
            noise[name] = round(sd, 4)
    observed, sd = logged(w.body, names)
    pose, true_pose = (in_columns(w.body, observed, x) for x in (seen.tips, truly))
    shown = pose + rng.normal(0, sd, pose.shape)
    for i in np.flatnonzero(seen.frozen):
        shown[i] = shown[i - 1]
    for j, name in enumerate(observed):
        samples[name] = shown[:, j]
        noise[name] = float(f"{sd:.4g}")
    _conditions(w, samples, rng, lab)
    kind = "arm" if device == "arm" else "finger"
    meta = {"device": kind, "length_mm": round(w.body.length_mm, 2), "samples": "samples.csv"}
    meta |= {"noise": noise} if state_noise else {}
    if state_pauses:
        starts = {str(i): {"start": "continues", "pause_s": p} for i, p in enumerate(w.plan.pauses_s)}
        meta["trials"] = starts | {"0": {"start": "rested"}}
    floor, pauses = float(sd * np.sqrt(len(observed))), [float(p) for p in w.plan.pauses_s]
    log = samples, observed, pose, true_pose
    return Truth(device, seed, day, drawn, meta, *log, floor, pauses, w.body.top_kpa)


def _numbered(pattern: str, n: int) -> list[str]:
    return [pattern.format("" if n == 1 else f"{i + 1}_") for i in range(n)]


def _commands(w: World, rng: np.random.Generator, log_sent: bool) -> pd.DataFrame:
    """Trial, clock, program and commands of each row; some computers log when they sent a command."""
    p, rows = w.plan, w.plan.rows
    trial = p.trial[rows]
    start = np.array(p.starts)[trial]
    table = pd.DataFrame({"trial": trial, "program": np.array(p.programs)[trial]})
    table["time_s"] = p.time_s[rows] - p.time_s[start]
    for j, name in enumerate(_numbered("pressure_cmd_{}kpa", p.command.shape[1])):
        table[name] = p.command[rows, j] * w.body.top_kpa
    if rng.random() < 0.4 or log_sent:
        table["time_sent_s"] = p.sent_s[rows] - p.time_s[start]
    return table


def _conditions(w: World, samples: pd.DataFrame, rng: np.random.Generator, lab: bool) -> None:
    rows, set_by = w.plan.rows, w.plan.conditions
    trial = w.plan.trial[rows]
    gravity = set_by.get("gravity") if w.gravity is None else w.gravity
    payload_g = set_by.get("payload_g") if w.payload_g is None else w.payload_g
    if gravity is not None:
        for k, axis in enumerate("xyz"):
            samples[f"gravity_{axis}"] = gravity[trial, k] + 0.0
    if payload_g is not None:
        samples["payload_g"] = payload_g[trial]
    idle = rng.random() < 0.25 or lab or "temperature_c" in set_by
    air = w.temperature_c if w.temperature_c is not None else room_temperature(w, "temperature")
    if lab and w.temperature_c is None:
        warm = stream(w.seed, w.day, "warm").permutation(np.arange(len(w.plan.starts)) % 3 == 0)
        air = 22 + WARMER_C * warm[w.plan.trial]
    if idle or w.temperature_c is not None:
        samples["temperature_c"] = air[rows] + rng.normal(0, 0.05, len(rows))


def write(truth: Truth, folder: str | Path) -> Path:
    """Writes recording.json, samples.csv and, next to them, truth.json; returns the folder.

    Raises FileExistsError where something is in the folder.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    if any(folder.iterdir()):
        raise FileExistsError(f"{folder} is not empty")
    truth.samples.to_csv(folder / "samples.csv", index=False, float_format="%.6g", lineterminator="\n")
    (folder / "recording.json").write_text(json.dumps(truth.meta, indent=1) + "\n", encoding="utf-8")
    known = {name: getattr(truth, name) for name in ("device", "seed", "day")}
    known["effects"] = [
        {"name": k, "physics": EFFECTS[k].physics, "summary": EFFECTS[k].summary, "parameters": v}
        for k, v in truth.effects.items()
    ]
    known |= {name: getattr(truth, name) for name in ("noise_floor", "top_kpa", "pauses_s", "observed")}
    known |= {name: getattr(truth, name).round(5).tolist() for name in ("pose", "true_pose")}
    (folder / "truth.json").write_text(json.dumps(known) + "\n", encoding="utf-8")
    return folder


MINUTES = {"rod": 10.0, "arm": 10.0, "cosserat": 2.0}
MOST_MINUTES = 600.0  # whose recording fits into the memory
SIZING_DAYS = (1, 2)
WANTED = (4.5, 9.0)  # rms change of the tip over the noise that an effect alone is given
LEAST_MOST = (3.2, 11.4)  # on either day
FULL = 5.0  # misfit of the plain device over the noise, of a strength of 1
TIMED = ("tracker_lowpass", "tracker_latency", "clock_jitter")

Parameters = dict[str, dict[str, float]]


def run(w: World, drawn: Parameters) -> tuple[np.ndarray, Seen]:
    """Lets the effects act; returns the true marker (rows, 3) mm at the stamps and what the tracker saw."""
    act(w, drawn)
    fine = any(name in drawn for name in TIMED)
    rows = _rows(w, fine)
    path = move(w)[np.isin(_rows(w, True), rows)] if w.dynamics else pose(w, rows)
    truly = path[np.searchsorted(rows, w.plan.rows)]
    return truly, watch(w, path, fine, drawn)


def act(w: World, drawn: Parameters) -> None:
    """Every stage up to the loads, in order."""
    for stage in STAGES:
        if stage == "air":
            w.air = w.sent.copy()
        if stage == "drive":
            w.drive = w.body.bend_rad * w.air
            w.memory = np.zeros_like(w.drive)
        if stage in ("marker", "gauge"):
            break
        for name, parameters in drawn.items():
            if EFFECTS[name].stage == stage:
                EFFECTS[name].act(w, **parameters)


def pose(w: World, rows: np.ndarray) -> np.ndarray:
    """Marker (k, 3) in mm, in equilibrium in these rows of the fine grid.

    A body that moves is in equilibrium with what its lowest mode makes of the drive; by this its effects are
    sized, while `cosserat.move` makes the recording.
    """
    if w.dynamics:
        w = _swinging(w)
    inputs = w.rod_inputs(rows)
    if w.contact is not None:
        return against_wall(w.body.rod, inputs, float(w.body.bend_rad[0]), w.contact)
    return w.body.rod.solve(inputs)[0]


def _swinging(w: World) -> World:
    omega, damping = 2 * np.pi / w.dynamics["period_s"], w.dynamics["damping"]
    swung = copy(w)
    memory = w.memory
    if "shake" in w.dynamics:
        shake = w.dynamics["shake"]
        swing = np.sin(2 * np.pi * shake["hz"] * w.time_s) * shake["swing_mm"] / (0.6 * w.body.length_mm)
        memory = memory + swing[:, None]
    swung.drive, swung.memory = (swing_of(np.ascontiguousarray(x), omega, damping) for x in (w.drive, memory))
    return swung


def watch(w: World, path: np.ndarray, fine: bool, drawn: Parameters) -> Seen:
    """What the tracker logs, before noise."""
    n = len(w.plan.rows)
    seen = Seen(w, path.copy(), fine, np.zeros(n), np.zeros(n, bool))
    named = [k for k in drawn if EFFECTS[k].stage == "marker"]
    for name in sorted(named, key=lambda k: k not in TIMED):
        if name not in TIMED and seen.tips is None:
            seen.sample()
        EFFECTS[name].act(w, seen, **drawn[name])
    if seen.tips is None:
        seen.sample()
    return seen


def read_gauge(w: World, drawn: Parameters) -> np.ndarray:
    """(n, chambers) what the gauges show on the fine grid, share of the top pressure, before noise."""
    read = (w.air if w.at_gauge is None else w.at_gauge).copy()
    for name, parameters in drawn.items():
        if EFFECTS[name].stage == "gauge":
            read = EFFECTS[name].act(w, read, **parameters)
    return read


def draw(
    device: str, names: tuple[str, ...], seed: int, strength: float | None = None, plan: Plan | None = None
) -> Parameters:
    """Parameters of each effect of this device, in the order of the table; see `sized`."""
    sizing = () if strength is None else (strength, plan)
    return {name: dict(sized(device, name, seed, *sizing)) for name in EFFECTS if name in names}


@lru_cache(maxsize=256)
def sized(
    device: str, name: str, seed: int, strength: float | None = None, plan: Plan | None = None
) -> tuple[tuple[str, float], ...]:
    """One effect's parameters, sized so that alone it moves the tip by the wanted multiple of the noise.

    The geometric mean over the first two days decides, so the device is the same on every day. A gauge
    changes no tip; its error counts with the tip's way that it stands for. A size at the end of its natural
    range stays there.

    With a `strength` the plain device, its gain and rest bend fitted anew to this plan, misses the tip by
    `FULL` times so much.
    """
    effect = EFFECTS[name]
    rng = stream(seed, name, "parameters")
    parameters = effect.draw(rng)
    wanted = rng.uniform(*np.log(WANTED)) if strength is None else np.log(FULL * strength)
    low, high = np.log(effect.ranges["size"]) + [np.log(min(strength or 1.0, 1.0)), 0.0]
    for _ in range(12):
        middle = float(np.log(parameters["size"]))
        try:
            if strength is None:
                both = [changed(device, name, seed, day, parameters) for day in SIZING_DAYS]
                both = np.log(np.maximum(both, 1e-6))
                spread = abs(both[0] - both[1]) / 2  # each day stays within reason
                least, most = np.log(LEAST_MOST) + [spread, -spread]
                aim = np.clip(wanted, least, most) if least < most else (least + most) / 2
                miss = float(aim - both.mean())
            else:
                miss = wanted - np.log(max(changed(device, name, seed, 1, parameters, plan=plan), 1e-6))
        except ArithmeticError:  # loads beyond what this device can carry
            miss = -1.0
        low, high = (middle, high) if miss > 0 else (low, middle)
        if abs(miss) < 0.05 or high - low < 0.02:
            break
        guess = middle + miss  # change grows about as the size does
        inside = low + 0.1 * (high - low) < guess < high - 0.1 * (high - low)
        parameters["size"] = float(np.exp(guess if inside else (low + high) / 2))
    return tuple(parameters.items())


def changed(device: str, name: str, seed: int, day: int, parameters: dict, plan: Plan | None = None) -> float:
    """How far one effect alone moves the log of the tip, rms, over the rms of the noise.

    Weighed at every fourth row. On a given plan, only as far as no other gain and rest bend of the plain
    device do the same.
    """
    plain, path, slopes = _plain(device, seed, day, name in TIMED, plan)
    rows = plain.plan.rows[::4]
    drawn = {name: parameters}
    if EFFECTS[name].stage == "marker":
        tips = watch(plain, path, name in TIMED, drawn).tips[::4]
    else:
        w = World.start(device, seed, day, MINUTES[device], plan)
        act(w, {} if EFFECTS[name].stage == "gauge" else drawn)
        if EFFECTS[name].stage == "gauge":
            w.drive = w.body.bend_rad * read_gauge(plain, drawn)
        tips = pose(w, rows)
    still = path[np.searchsorted(_rows(plain, name in TIMED), plain.plan.rows)][::4]
    columns, sd = logged(plain.body, drawn)
    still, tips, *slopes = (in_columns(plain.body, columns, x) for x in (still, tips, *slopes))
    away = tips - still
    if slopes:
        basis = np.stack([(x - still).ravel() for x in slopes], 1)
        away = away - (basis @ np.linalg.lstsq(basis, away.ravel(), rcond=None)[0]).reshape(away.shape)
    return float(np.sqrt((away**2).sum(1).mean() / len(columns)) / sd)


def _rows(w: World, fine: bool) -> np.ndarray:
    return np.flatnonzero(w.plan.trial >= 0) if fine else w.plan.rows


@lru_cache(maxsize=4)
def _plain(device: str, seed: int, day: int, fine: bool, plan: Plan | None):
    """The plain device, its path, and on a given plan the paths of a little more gain and of more bend."""
    w = World.start(device, seed, day, MINUTES[device], plan)
    act(w, {})
    path, slopes, drive = pose(w, _rows(w, fine)), [], w.drive
    for more in (0.01 * drive, 0.01 * w.body.bend_rad) if plan else ():
        w.drive = drive + more
        slopes.append(pose(w, w.plan.rows[::4]))
    w.drive = drive
    return w, path, slopes
