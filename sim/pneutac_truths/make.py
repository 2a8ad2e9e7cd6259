"""From a device, its effects and a seed to a recording: the stages in order, and the effects' sizes."""

from copy import copy
from functools import lru_cache

import numpy as np

from pneutac_truths.contact import against_wall
from pneutac_truths.cosserat import move
from pneutac_truths.effects import EFFECTS, STAGES
from pneutac_truths.effects.air import swing as swing_of
from pneutac_truths.programs import Plan
from pneutac_truths.seen import Seen, in_columns, logged
from pneutac_truths.world import World, stream

MINUTES = {"rod": 10.0, "arm": 10.0, "cosserat": 2.0}
SIZING_DAYS = (1, 2)
WANTED = (4.5, 9.0)  # rms change of the tip over the noise that an effect alone is given
LEAST_MOST = (3.2, 11.4)  # on either day
FULL = 5.0  # misfit of the plain device over the noise, of a strength of 1
TIMED = ("tracker_lowpass", "tracker_latency", "clock_jitter")

Parameters = dict[str, dict[str, float]]


def run(w: World, drawn: Parameters) -> tuple[np.ndarray, Seen]:
    """Lets the effects act on a world.

    Returns:
        Marker (rows, 3) in mm where it truly is at the stamps, and what the tracker made of it.
    """
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
    inputs = w.told(rows)
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
                miss = _missing(wanted, np.log(np.maximum(both, 1e-6)))
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


def _missing(wanted: float, both: np.ndarray) -> float:
    """By how much the mean of both days misses what is wanted, moved so that each day stays within reason."""
    spread = abs(both[0] - both[1]) / 2
    low, high = np.log(LEAST_MOST) + [spread, -spread]
    return float((np.clip(wanted, low, high) if low < high else (low + high) / 2) - both.mean())


def changed(
    device: str, name: str, seed: int, day: int, parameters: dict, minutes=None, plan: Plan | None = None
) -> float:
    """How far one effect alone moves the log of the tip, rms, over the rms of the noise.

    Weighed at every fourth row. On a given plan, only as far as no other gain and rest bend of the plain
    device do the same.
    """
    plain, path, slopes = _plain(device, seed, day, minutes, name in TIMED, plan)
    rows = plain.plan.rows[::4]
    drawn = {name: parameters}
    if EFFECTS[name].stage == "marker":
        tips = watch(plain, path, name in TIMED, drawn).tips[::4]
    else:
        w = World.start(device, seed, day, minutes or MINUTES[device], plan)
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
def _plain(device: str, seed: int, day: int, minutes, fine: bool, plan: Plan | None):
    """The plain device, its path, and on a given plan the paths of a little more gain and of more bend."""
    w = World.start(device, seed, day, minutes or MINUTES[device], plan)
    act(w, {})
    path, slopes, drive = pose(w, _rows(w, fine)), [], w.drive
    for more in (0.01 * drive, 0.01 * w.body.bend_rad) if plan else ():
        w.drive = drive + more
        slopes.append(pose(w, w.plan.rows[::4]))
    w.drive = drive
    return w, path, slopes
