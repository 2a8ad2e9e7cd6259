"""Looks at a recording before any model does: faults of files, tracker, sensors, clock and axes."""

import re
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from pneutac_datasets.recording import pressures, rules, sensors
from pneutac_datasets.recording.gel import gel_faults
from pneutac_datasets.recording.noise import headline, noise_floor, regress, static_columns
from pneutac_datasets.recording.recording import (
    GRAVITY,
    Recording,
    read_meta,
    read_table,
    time_blocks,
    wide_gaps,
)
from pneutac_datasets.recording.sensors import measured_pressures, where
from pneutac_datasets.recording.wording import Finding, collected, plural
from pneutac_sim.errors import InputError
from pneutac_sim.files import refuse_pointer

LAGS = 6
ROUNDING = 1e-5  # of the command's range: what its own past leaves of a smooth program is rounding
FOLLOWS = 0.5  # of a command's changes: from there on it is what was measured
FOLLOWS_NEAR = 0.02  # of the pressure's range
SCATTERS = "scatters where nothing changes in"
TURNS = 0.4  # of the rows: noise turns in two thirds, a ramp never
DELAYS_S = 0.0, 0.1, 0.3, 1.0, 3.0  # of valve, body and tracker
MOVED = 0.1  # of the pose's variance: a device that pressure moves shows more, in spite of memory and load
WHOLE = 0.7  # of the long steps: a loop that is late now and then is not late by whole rows
LEAST_ROWS = 200  # for fewer a map of the pressure explains that much by chance
ANSWERED = 0.15  # share of the command's steps that feedback explains and a program does not


def clock(recording: Recording) -> Iterator[Finding]:
    """Long pauses within trials, and rows that are missing from an even clock."""
    gaps, lost, steps = [], [], []  # rows before a pause, rows after a long step, and its size in usual ones
    time, even = recording.column("time_s"), True
    for rows in recording.trials().values():
        dt = np.diff(time[rows])
        if len(dt) < 5:
            continue
        usual, wide = wide_gaps(time[rows])
        even &= bool((np.abs(dt - usual) < 0.2 * usual).mean() > 0.9)
        gaps += list(np.flatnonzero(wide) + rows.start)
        short = (dt > 1.5 * usual) & ~wide
        lost += list(np.flatnonzero(short) + 1 + rows.start)
        steps += list(dt[short] / usual)
    whole = np.round(steps)
    missing = int((whole - 1).sum())
    even &= bool((np.abs(steps - whole) < 0.2).sum() >= WHOLE * len(steps))
    if gaps:
        at = max(gaps, key=lambda i: time[i + 1] - time[i])
        text = (
            f"The rows have {plural(len(gaps), 'gap')} (the longest {time[at + 1] - time[at]:.1f} s, in "
            f"{where(recording, at)}); what happened meanwhile is unknown to a model with memory, so start a "
            "new trial there."
        )
        yield Finding("gaps", text, ("time_s",), np.array(gaps) + 1, {"count": len(gaps)})
    left_out = recording.meta.get("conversion", {}).get("rows_left_out", 0)
    if lost and even and missing > left_out:  # else the notes of the conversion say it
        why = "frames were dropped, or left out because the tip was not seen"
        if left_out:
            why = f"the conversion left out {left_out} without a tip, {missing - left_out} were not logged"
        text = (
            f"{plural(missing, 'row')} {'is' if missing == 1 else 'are'} missing from an even clock (first "
            f"before {where(recording, lost[0])}): {why}."
        )
        yield Finding("missing_rows", text, ("time_s",), np.array(lost), {"count": missing})


def closed_loop(recording: Recording) -> Iterator[Finding]:
    """Whether the command answers to the measured motion (Granger's test on the command's own changes).

    A programmed command is predictable from its own past and owes nothing to the noise of the marker; a
    controller's next command follows the marker's last pose. Only rows in which the command changes are
    looked at, as a controller may be slower than the log. A pose of the row itself answers to the command
    too, but with the device's own sign, and a controller has the other.
    """
    columns, _ = headline(recording)
    gains = np.zeros(3)  # sums over rows: of feedback from before, of that of the same row, and of 1
    command, time = recording.commands, recording.column("time_s")
    pose = recording.samples[columns].to_numpy(float)
    for rows in recording.trials().values() if columns else ():
        u, y = command[rows], pose[rows]
        at = 1 + np.flatnonzero(np.abs(np.diff(u, axis=0)).max(1, initial=0) > 0)
        if len(at) < 200 or (np.abs(np.diff(u[at], 2, axis=0)).max(1) > 1e-4 * _reach(u)).mean() < 0.5:
            continue
        # how much farther a program goes, and the device with it, in steps that are longer; a row logged
        # after its command's period has the step of the row before
        step_s, change = np.diff(time[rows])[at - 1], np.diff(u[at], axis=0)[LAGS - 2 : -1]
        longer = step_s / max(np.median(step_s), 1e-9) - 1
        longer = [longer[LAGS - k : len(at) - k, None] * change for k in range(3)]
        # the last pose but one and all before it are known: what is news in the last is noise, or feedback
        known = np.hstack([_past(u[at], 1), _past(u[at] ** 2, 1), _past(y[at - 1], 1), *longer])
        target, last = u[at][LAGS:], y[at - 1][LAGS:]
        alone = _left(target, known)
        if alone.std(axis=0).max() < ROUNDING * _reach(u):
            continue
        known_and_last = np.hstack([known, last])
        left = _left(target, known_and_last)
        free = len(target) - known.shape[1] - 1
        scale = free / max(free - last.shape[1], 1)  # by chance more columns explain more
        before = 1 - scale * (left**2).sum() / max((alone**2).sum(), 1e-30)
        # the unit direction in which the device goes when a chamber's pressure grows
        slope = np.linalg.lstsq(np.c_[u, np.ones(len(u))], y, rcond=None)[0][: u.shape[1]].T
        shown = (y @ (slope / np.maximum(np.linalg.norm(slope, axis=0), 1e-12)))[at][LAGS:]
        same, sign = _same_row(left, known_and_last, shown)
        gains += len(target) * np.array([before, same * (sign < 0), 1.0])
    before, same, _ = gains / max(gains[2], 1)
    if max(before, same) > ANSWERED:
        text = (
            f"The command follows the measured motion ({max(before, same):.0%} of its steps are explained by "
            "it): under feedback noise passes for physics; record open-loop programs."
        )
        if own_row := same > ANSWERED:
            text += " It answers to the pose of its own row, so it was sent after it: log time_sent_s."
        numbers = {"share": float(max(before, same)), "same_row": float(own_row)}
        yield Finding("closed_loop", text, tuple(recording.pressure_columns), numbers=numbers)


def _reach(u: np.ndarray) -> float:
    return max(float(np.ptp(u)), 1e-9)


def _past(x: np.ndarray, first: int) -> np.ndarray:
    """(n - LAGS, k LAGS): the rows `first`, `first` + 1, ... before each."""
    return np.hstack([x[LAGS - first - k : len(x) - first - k] for k in range(LAGS)])


def _left(target: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """What regression on some columns, and a constant, leaves."""
    columns = np.c_[columns, np.ones(len(columns))]
    return target - columns @ np.linalg.lstsq(columns, target, rcond=None)[0]


def _same_row(left: np.ndarray, known: np.ndarray, shown: np.ndarray) -> tuple[float, float]:
    """Share of what is left that news in this row's pose explains, and the sign of its answer."""
    news = _left(shown, known)
    covariance = (left * news).sum()
    share = covariance**2 / max((left**2).sum() * (news**2).sum(), 1e-30)
    return float(min(share, 1.0)), float(np.sign(covariance))


def late_command(recording: Recording) -> Iterator[Finding]:
    """Whether the device moves before its command does.

    Before steps out of a rest the pose will do; where the command never rests, the measured pressure decides,
    if it knows of the next row's command what nothing before it knew.
    """
    gauges = {c: [m] for m, c in measured_pressures(recording).items()}
    for name in recording.pressure_columns:
        seen = gauges.get(name) or headline(recording)[0]
        how = _as_measured(recording, name, seen[0]) if name in gauges else ""
        leads = [] if how == SCATTERS else _leads(recording, name, seen)
        ahead = [lead for lead in leads if lead > 0]
        late, shown = 0, "all along"
        if len(leads) >= 5 and len(ahead) >= 0.8 * len(leads):
            late, shown = int(np.median(ahead)), f"in {len(ahead)} of {len(leads)} steps"
        elif name in gauges and how != SCATTERS:
            late = _predicted_ahead(recording, name, seen[0])
        if late:
            what, rows = f"Column '{seen[0]}'" if len(seen) == 1 else "The marker", plural(late, "row")
            text = (
                f"{what} moves {rows} before the command '{name}' does, {shown}: the command is written too "
                f"late; move it up by {rows}, or give time_sent_s."
            )
            yield Finding("late_command", text, (name,), numbers={"rows_late": float(late)})
        elif how:
            text = (
                f"Column '{name}' {how} '{seen[0]}', as a measured pressure and no command does: the two "
                "columns may be in each other's place."
            )
            yield Finding("exchanged_pressures", text, (name, seen[0]))


def _leads(recording: Recording, name: str, seen: list[str]) -> list[int]:
    """By how many rows the device went ahead of each step of a command out of a rest."""
    out, reach = [], np.ptp(recording.column(name))
    names = [name, *(c for c in recording.pressure_columns if c != name)]
    for rows in recording.trials().values():
        commands, y = (recording.samples.iloc[rows][c].to_numpy(float) for c in (names, seen))
        u, moves = commands[:, 0], np.abs(np.diff(commands, axis=0, prepend=commands[:1])).max(1)
        for i in np.flatnonzero(moves > 0.002 * reach):
            rested = i >= 10 and moves[i - 10 : i].max() <= 1e-6 * reach
            if not rested or i + 5 > len(u) or np.abs(u[i : i + 10] - u[i - 1]).max() < 0.1 * reach:
                continue
            calm = y[i - 10 : i - 4].mean(0)
            motion = y[min(i + 10, len(y) - 1)] - calm
            along = (y[i - 10 : i] - calm) @ motion / max(np.linalg.norm(motion), 1e-12)
            ahead = along[::-1] > max(0.03 * np.linalg.norm(motion), 6 * along[:6].std(), 1e-12)
            out.append(int(np.argmin(np.r_[ahead, False])))
    return out


def _predicted_ahead(recording: Recording, name: str, gauge: str) -> int:
    """How many rows ahead of an ever changing command its measured pressure is."""
    late = 0
    for ahead in (1, 2, 3):
        agree, n = 0.0, 0
        for rows in recording.trials().values():
            u, p = (np.diff(recording.column(c)[rows].astype(float)) for c in (name, gauge))
            if len(u) < 200 or (np.abs(np.diff(u)) > 1e-4 * _reach(u)).mean() < 0.5:
                continue
            m = len(u) - ahead
            known = [u[LAGS + ahead - 1 - k : m + ahead - 1 - k] for k in range(LAGS + ahead - 1)]
            known = np.stack([*known, *(p[LAGS - k : m - k] for k in range(1, LAGS))], -1)
            left = _left(p[LAGS:m, None], known)
            share, sign = _same_row(left, known, u[LAGS + ahead : m + ahead, None])
            agree, n = agree + share * len(left) * (sign > 0), n + len(left)
        if n and agree / n > ANSWERED:
            late = ahead
    return late


def _as_measured(recording: Recording, name: str, gauge: str) -> str:
    """How a command behaves towards what is called its gauge if it is the measured pressure; else empty."""
    far = FOLLOWS_NEAR * np.ptp(recording.column(gauge))
    away, change, still = [], [], []
    for rows in recording.trials().values():
        u, p = recording.column(name)[rows], recording.column(gauge)[rows]
        step, stands = np.diff(p.astype(float)), np.zeros(len(p) - 1, bool)
        for a, b in sensors.stretches(step == 0):
            stands[a:b] = b - a > sensors.STANDS
        still.append(np.diff(u)[stands & (np.abs(u - p)[:-1] < far)])
        calm = np.abs(step) < far  # in the row of a step both have moved
        away.append((p - u)[:-1][calm])
        change.append(np.diff(u)[calm])
    away, change, still = (np.concatenate(x).astype(float) for x in (away, change, still))
    turns = np.diff(np.sign(still[still != 0])) != 0
    if len(turns) >= LEAST_ROWS and turns.sum() > TURNS * len(still):
        return SCATTERS
    if (change != 0).sum() < LEAST_ROWS or not np.ptp(away) or np.polyfit(away, change, 1)[0] <= 0:
        return ""
    return "runs after" if np.corrcoef(away, change)[0, 1] ** 2 > FOLLOWS else ""


def unmoved(recording: Recording) -> Iterator[Finding]:
    """A pose that no map of the pressure, now or some time ago, explains."""
    columns, _ = headline(recording)
    if not columns or np.ptp(recording.commands) < 1e-3:
        return
    y, t = recording.samples[columns].to_numpy(float), recording.column("time_s")
    drive, trials, best = _drive(recording), recording.trials().values(), 0.0
    # in all, where a pressure stands throughout a trial; within trials, where a load differs between them
    within = np.concatenate([y[rows] - y[rows].mean(0) for rows in trials])
    for delay, moved in product(DELAYS_S, (y - y.mean(0), within)):
        before = [
            rows.start + np.maximum(np.searchsorted(t[rows], t[rows] - delay, side="right") - 1, 0)
            for rows in trials
        ]
        design = static_columns(drive[np.concatenate(before)])
        left = ((moved - design @ regress(design, moved)) ** 2).sum()
        best = max(best, 1 - float(left / max((moved**2).sum(), 1e-30)))
    if len(y) >= LEAST_ROWS and best < MOVED:
        text = (
            f"Pressure explains {best:.1%} of how the tip moves: the finger stands still, the hose is off, or"
            " pressure and tip are of different runs or clocks."
        )
        yield Finding("unmoved", text, tuple(columns), numbers={"share": best})


TURN = 2 * np.pi
TIP = ("tip_x_mm", "tip_y_mm", "tip_z_mm")
LENGTHS = {"millimetres": 1.0, "centimetres": 10.0, "inches": 25.4, "metres": 1000.0}  # mm in one of them
MOST_TIPS = 200
MOST_BENT_RAD = 4.2  # beyond that the path nears the base, where any tip lies close to it
OTHER_LENGTH = 1.15  # ratio of two lengths that no rough measure explains
LEAST_TIPS = 10  # fewer show no path
OFF_PATH = 0.004  # lengths of the device: nearer than that nothing is wrong
MUCH_NEARER = 0.3


def unwrap(recording: Recording) -> tuple[Recording, list[Finding]]:
    """Takes whole turns off angles where it is certain that they are the tracker's."""
    found, straightened = [], {}
    for name in [c for c in recording.samples if re.fullmatch(r"\w+_rad", str(c))]:
        x = recording.column(name).astype(float)
        straight, jumps, certain = x.copy(), [], True
        for rows in recording.trials().values():
            wraps = np.abs(np.abs(np.diff(x[rows])) - TURN) < 0.25 * np.pi
            jumps += list(np.flatnonzero(wraps) + 1 + rows.start)
            straight[rows] = np.unwrap(x[rows])
            certain &= bool(np.abs(np.diff(straight[rows])).max(initial=0) < 0.25 * np.pi)
        if not jumps:
            continue
        # a tracker wraps at the ends of one turn and shows nothing beyond
        certain &= bool(np.ptp(x) <= TURN + 1e-6)
        certain &= bool(np.abs(np.diff(x[np.add.outer(jumps, [-1, 0])])).min() > 5.5)
        how = "it also moves quickly elsewhere, so it was not changed: unwrap it yourself."
        if certain:
            straightened[name] = straight
            how = "it moves smoothly otherwise, so the turns are taken off."
        times = f"{plural(len(jumps), 'time')} (first in {where(recording, jumps[0])})"
        text = f"Column '{name}' jumps by a whole turn {times}; {how}"
        found.append(Finding("wrapped_angle", text, (name,), np.array(jumps), {"unwrapped": float(certain)}))
    return replace(recording, samples=recording.samples.assign(**straightened)), found


def _drive(recording: Recording) -> np.ndarray:
    """(n, chambers) pressure of the order of 1, measured where all of it was."""
    p = recording.pressures
    return p / max(float(np.abs(p).max()), 1e-9)


def exchanged_axes(recording: Recording) -> Iterator[Finding]:
    """Tip columns of a finger in each other's place: it bends in z and lies along x."""
    along, towards = base_axes(recording)
    other = "xz" if along[-1] == "z" else "yz" if towards[-1] == "y" and recording.has("tip_z_mm") else ""
    if recording.length_mm is not None and other:
        text = (
            f"The finger lies along {along} and pressure bends it along {towards}, where x and z must point:"
            " the axes are exchanged, or the base is turned by 90 degrees; give both in the base's frame."
        )
        yield Finding("exchanged_axes", text, tuple(f"tip_{a}_mm" for a in other))


def misplaced_tip(recording: Recording) -> Iterator[Finding]:
    """Tip coordinates that lie on the path of a bending device in another unit, frame or length alone.

    A device that bends evenly moves its tip on the curve L (sin t, 1 - cos t) / t. Real ones stay near it, so
    only a reading of the columns that brings them several times nearer is named.
    """
    length, names = recording.length_mm, [c for c in TIP if recording.has(c)]
    if recording.device not in ("finger", "arm") or length is None or "tip_x_mm" not in names[:-1]:
        return
    if len(recording) < LEAST_TIPS:
        return
    every = recording.samples[names].to_numpy(float)
    tip = every[:: max(1, len(every) // MOST_TIPS)] / length
    x, aside = tip[:, 0], np.linalg.norm(tip[:, 1:], axis=1)
    now = _off_path(x, aside)
    if now < OFF_PATH:
        return
    readings = []  # distance from the path, remedy, and which kind of reading it is
    for (in_x, kx), (in_z, kz) in product(LENGTHS.items(), LENGTHS.items()):
        if kx == kz == 1:
            continue
        units = [("tip_x_mm", in_x, kx), (" and ".join(names[1:]), in_z, kz)]
        units = [(" and ".join(names), in_x, kx)] if kx == kz else [u for u in units if u[2] != 1]
        remedy = " and ".join(f"{which} can only be in {unit}" for which, unit, _ in units)
        remedy += f"; multiply by {' and '.join(f'{k:g}' for *_, k in units)}"
        readings.append((_off_path(kx * x, kz * aside), remedy, max(kx, kz)))
    from_tip = f"x is counted from the tip at rest; add {length:g} to tip_x_mm"
    to_base = "x points from the tip to the base; change the sign of tip_x_mm"
    readings += (_off_path(x + 1, aside), from_tip, 1), (_off_path(-x, aside), to_base, -1)
    scales = [s for s in np.geomspace(1 / 6, 6, 91) if not 1 / OTHER_LENGTH < s < OTHER_LENGTH]
    off, best = min((_off_path(s * x, s * aside), s) for s in scales)
    remedy = f"it fits a device of {length / best:.3g} mm; correct length_mm, or the scale of the tip"
    readings.append((2 * off, remedy, best))
    rest = _at_rest(_drive(recording), every)
    origin = rest / length - np.eye(len(names))[0]
    if np.linalg.norm(origin) > 1 - 1 / OTHER_LENGTH:  # a finger bent at rest is not straight on x either
        shifted = tip - origin
        place = ", ".join(f"{v:.3g}" for v in length * origin)
        remedy = f"its base is at ({place}) mm of the frame; subtract that from {' and '.join(names)}"
        readings.append((2 * _off_path(shifted[:, 0], np.linalg.norm(shifted[:, 1:], axis=1)), remedy, 1))
    off, remedy, kind = min(readings, key=lambda r: r[0])
    if off <= MUCH_NEARER * now:
        text = (
            f"At the lowest pressures the tip is {np.linalg.norm(rest):.3g} mm from the base of a "
            f"{recording.device} of {length:g} mm, and its path does not fit such a device: {remedy}."
        )
        yield Finding("misplaced_tip", text, tuple(names), numbers={"off_path": now, "reading": float(kind)})


def _at_rest(drive: np.ndarray, tip: np.ndarray) -> np.ndarray:
    """Where the tip (n, k) is at the lowest pressures (n, chambers)."""
    driven = np.abs(drive).max(1)
    return np.median(tip[driven <= np.quantile(driven, 0.1)], axis=0)


def _off_path(x: np.ndarray, aside: np.ndarray) -> float:
    """Root mean square distance of tips, in lengths of the device, from the path of an evenly bent one."""
    return float(np.sqrt(np.mean(_path().query(np.stack([x, aside], -1))[0] ** 2)))


@cache
def _path() -> cKDTree:
    turn = np.linspace(1e-6, MOST_BENT_RAD, 2000)
    return cKDTree(np.stack([np.sin(turn), 1 - np.cos(turn)], -1) / turn[:, None])


def other_way_round(recording: Recording) -> Iterator[Finding]:
    """A finger that bends towards -z, or whose angle falls, as the pressure rises."""
    if recording.device != "finger" or list(exchanged_axes(recording)):
        return  # what falls may be another axis
    p = _drive(recording)
    if p.max() < -p.min() or not np.ptp(p[:, 0]):
        return  # vacuum bends it: which way is positive is its maker's choice
    least = {"tip_z_mm": 0.05 * (recording.length_mm or 100.0), "bend_angle_rad": 0.05}
    for name in filter(recording.has, least):
        y = recording.column(name).astype(float)
        if np.ptp(y) >= least[name] and np.corrcoef(p[:, 0], y)[0, 1] < -0.7:
            text = (
                f"Column '{name}' falls as the pressure rises, but a finger's bend is positive at positive "
                "pressure: it was mounted, or z drawn, the other way round; change the sign of the column, "
                "or the twin's gain is negative."
            )
            yield Finding("other_way_round", text, (name,))


STRAIGHT = 0.97  # cosine between the resting tip and an axis, from which on the finger lies along it
MOVES = 0.05  # of the length, from which on pressure moves a coordinate
NEAR_BASE = 0.15  # of the tip's distance from the origin: where it moves less, the origin is not the base
RIGHT_AXES = ("x", "z")


def base_axes(recording: Recording) -> tuple[str, str]:
    """Axes of a finger's tip along the straight finger and where pressure bends it, such as `y` or `-z`.

    `RIGHT_AXES` where they are right, or too little is measured to say otherwise.
    """
    names = {c[4]: c for c in TIP if recording.has(c)}
    if recording.device != "finger" or len(names) < 2 or not recording.pressure_columns:
        return RIGHT_AXES
    p, tip = _drive(recording), recording.samples[list(names.values())].to_numpy(float)
    ranges = []  # of each coordinate, as a static map of the pressure explains it
    for rows in recording.trials().values():
        if np.ptp(p[rows], axis=0).max() > 0.3 * np.ptp(p, axis=0).max():
            columns = static_columns(p[rows])
            ranges.append(np.ptp(columns @ regress(columns, tip[rows]), axis=0))
    moved = dict(zip(names, np.median(ranges or [np.zeros(len(names))], axis=0).tolist(), strict=True))
    rest = _at_rest(p, tip)
    i, far = int(np.abs(rest).argmax()), float(np.linalg.norm(rest))
    across = max(way for a, way in moved.items() if a != list(names)[i])
    stated = None if recording.meta.get("length_proposed") else recording.length_mm
    from_base = 1 / OTHER_LENGTH < far / stated < OTHER_LENGTH if stated else across > NEAR_BASE * far
    along, length = "x", stated or far
    if from_base and abs(rest[i]) > STRAIGHT * far:
        along = f"{'-' * bool(rest[i] < 0)}{list(names)[i]}"
    moved.pop(along[-1], None)
    towards = max(moved, key=moved.__getitem__)
    if along[-1] != "z" and (moved[towards] < MOVES * length or moved.get("z", 0.0) > 0.2 * moved[towards]):
        towards = "z"
    if moved.get(towards, 0.0) >= MOVES * length and p.max() >= -p.min():  # of vacuum its maker chooses
        rises = float(np.corrcoef(p[:, 0], recording.column(names[towards]).astype(float))[0, 1])
        towards = f"-{towards}" if rises < (-0.7 if towards == "z" else 0.0) else towards
    return along, towards


def drift(recording: Recording) -> Iterator[Finding]:
    """A steady move of the output over the session at equal pressures."""
    (columns, unit), s = headline(recording), recording.samples
    # the most common orientation and payload, and near the median temperature
    same = np.ones(len(recording), bool)
    for name in (n for n in (*GRAVITY, "payload_g") if n in s):
        rounded = s[name].round(1)
        same &= (rounded == rounded.mode()[0]).to_numpy()
    if "temperature_c" in s:
        same &= ((s["temperature_c"] - s["temperature_c"].median()).abs() < 2.0).to_numpy()
    if not columns or same.sum() < 200:
        return
    design, block = static_columns(_drive(recording)[same]), time_blocks(s)[same]
    step_s = s.groupby("trial")["time_s"].diff().fillna(0.0)  # no pauses between trials
    done = np.cumsum(step_s.to_numpy(float))[same]
    y = s[columns].to_numpy(float)[same]
    floor = noise_floor(recording).by_column
    moved = {}
    for i, name in enumerate(columns):
        total, steady = _trend(design, y[:, i : i + 1], done, block)
        if steady and abs(total) > max(5 * floor.get(name, 0.0), 0.02 * np.ptp(y[:, i])):
            moved[name] = total
    if moved:
        how = " and ".join(f"'{c}' by {x:+.3g} {unit}" for c, x in moved.items())
        text = (
            f"At equal pressures the output drifts steadily over the session, {how}: the tracker, the mount "
            "or a gauge drifts, or the device softens or warms. Repeat the first program at the end to find "
            "out which."
        )
        yield Finding("drift", text, tuple(moved), numbers=moved)


def _trend(design: np.ndarray, y: np.ndarray, done: np.ndarray, block: np.ndarray) -> tuple[float, bool]:
    """Move of y (n, 1) over the session besides a static map, and whether it is steady over blocks."""
    share = (done - done.min()) / max(np.ptp(done), 1e-9)
    left = y - design @ regress(design, y)
    clock = share[:, None] - design @ regress(design, share[:, None])
    if (clock**2).mean() < 1e-6:
        return 0.0, False  # the pressure itself runs with the clock
    total = float((clock * left).sum() / max((clock**2).sum(), 1e-12))
    numbers = np.unique(block, return_inverse=True)[1]
    n = np.bincount(numbers)
    a, b = (np.bincount(numbers, v[:, 0]) / n for v in (clock, left))
    if len(n) < 8 or np.ptp(a) < 1e-9 or np.ptp(b) < 1e-12:
        return total, False
    return total, bool(abs(np.corrcoef(a, b)[0, 1]) > 0.9)


LOOKS = sensors.jumps, sensors.frozen, sensors.stale, sensors.saturated, sensors.clipped_command
LOOKS += sensors.coarse, sensors.repeated, clock, closed_loop, late_command
LOOKS += unmoved, exchanged_axes, misplaced_tip, other_way_round, drift


def check(recording: Recording) -> tuple[Recording, list[str]]:
    """Finds faults and undoes those that are certain; returns the recording and a sentence for each.

    It is left without rows where the tracker jumped away and came back, stood still, lost frames or
    saturates, with angles that do not wrap, and with pressures as `pressures.usable` gives them. The loader's
    warnings come first.
    """
    clean, found = _looked(recording)
    keep = np.ones(len(recording), bool)
    for f in found:
        if f.kind == "frozen" or not f.numbers.get("kept", True):
            keep[f.rows] = False
    clean = clean if keep.all() else clean.keep(keep)
    return clean, [*recording.warnings, *(f.sentence for f in found)]


def findings(recording: Recording) -> list[Finding]:
    """All that is found, also for programs: a search may take them as hypotheses.

    Rows count those of this recording. A gel's is looked at where its images are read.
    """
    return _looked(recording)[1]


def _looked(recording: Recording) -> tuple[Recording, list[Finding]]:
    """The recording with its angles and pressures as they may be used, and all that is found."""
    if recording.device == "gel":
        return recording, []
    measured = measured_pressures(recording)
    recording, found = unwrap(recording)
    recording, more = pressures.usable(recording)
    found += [*more, *(finding for look in LOOKS for finding in look(recording))]
    gone = [f.rows for f in found if f.kind == "jumps" and not f.numbers["kept"]]
    # a tracker that writes 0 where it lost the marker jumps; it does not saturate
    found = [f for f in found if f.kind != "saturated" or np.isin(f.rows, gone).mean() < 0.9]
    if not measured:
        text = (
            "There is no measured pressure, so a slow valve and a creeping body cannot be distinguished; "
            "log pressure_kpa."
        )
        found.append(Finding("no_measured_pressure", text, tuple(recording.pressure_columns)))
    return recording, found


def recording_faults(folder: str | Path) -> tuple[list[str], list[str]]:
    """All that keeps a bench recording, or a LeRobotDataset with its columns, from being read.

    Returns:
        One sentence for each fault; one for each note on what is poor but usable, where there is no fault.
    """
    folder, faults, read = Path(folder), [], None
    try:
        meta = read_meta(folder)
    except InputError as e:
        return [str(e)], []
    faults += rules.meta_faults(meta, folder / "recording.json")
    with collected(faults):
        read = read_table(folder, meta)
    with collected(faults):
        device = rules.device_of(meta, pd.DataFrame() if read is None else read[0], folder)
        if read is not None:
            samples, found, warnings = rules.look(read[0], device, {} if faults else meta, read[1])
            faults += found
    if faults:
        return faults, []
    recording = Recording.of_rows(folder, meta, samples, device, warnings)
    faults, notes = gel_faults(recording) if recording.device == "gel" else (_pictures(recording), [])
    return faults, [] if faults else [*check(recording)[1], *notes]


def _pictures(recording: Recording) -> list[str]:
    """Pictures of a body that are missing, or pointers to files; the first and last of a camera are read."""
    found: list[str] = []
    for name in (n for n in recording.samples if re.fullmatch(r"(image|mask)(_\w+)?", n)):
        named = [v for v in recording.samples[name] if isinstance(v, str | dict) and v]
        for i, value in enumerate(named):
            file = recording.folder / value if isinstance(value, str) else None
            with collected(found):
                if i in (0, len(named) - 1) or file is not None and not file.is_file():
                    recording.image(value)
                elif file is not None:
                    refuse_pointer(file)
    return found
