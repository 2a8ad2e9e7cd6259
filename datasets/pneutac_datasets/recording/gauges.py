"""Faults of sensors as such: saturation, coarse steps, readings that stand, a clipped command."""

from collections.abc import Iterator

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from pneutac_datasets.recording.pressures import measured_pressures
from pneutac_datasets.recording.recording import Recording
from pneutac_datasets.recording.tracker import is_moving
from pneutac_datasets.recording.wording import Finding

COARSE = 1e-3  # of the range: smaller steps are the digits of the file
GATHERED = 0.7
STANDS = 12  # rows: readings that stand for longer may be pressures that stand


def _measured(recording: Recording) -> list[str]:
    poses = [c for c in recording.observations if not c.startswith("image")]
    return [*poses, *measured_pressures(recording)]


def saturated(recording: Recording) -> list[Finding]:
    """Columns that stick to their largest or smallest number while the command varies."""
    command = recording.commands
    found = []
    for name in _measured(recording):
        x = recording.column(name)
        for extreme, word in ((x.max(), "largest"), (x.min(), "smallest")):
            at = x == extreme
            spread = np.ptp(command[at], axis=0).max() / max(np.ptp(command, axis=0).max(), 1e-9)
            if np.ptp(x) > 0 and at.sum() >= 20 and at.mean() > 0.01 and spread > 0.1:
                text = (
                    f"Column '{name}' sticks to its {word} number {extreme:g} in {at.mean():.1%} of the rows "
                    "while the command varies: the sensor saturates there."
                )
                found.append(Finding("saturated", text, (name,), np.flatnonzero(at), {"at": float(extreme)}))
    return found


def clipped_command(recording: Recording) -> list[Finding]:
    """Commands that stand at their extreme between two ramps while the measured pressure goes on and returns.

    A held command lets the pressure settle; it does not make it rise and fall again.
    """
    found = []
    for measured, name in measured_pressures(recording).items():
        p, u = recording.column(measured).astype(float), recording.column(name).astype(float)
        for extreme, sign in ((u.max(), 1), (u.min(), -1)):
            humps, runs = [], 0
            for a, b in _stands(recording, u, extreme):
                third = max((b - a) // 3, 1)
                beyond = sign * (np.median(p[a + third : b - third]) - np.array([p[a], p[b - 1]]))
                runs += 1
                if beyond.min() > max(0.03 * np.ptp(u), 7 * np.median(np.abs(np.diff(p)))):
                    humps.append(np.arange(a, b))
            if len(humps) >= max(2, 0.5 * runs):
                text = (
                    f"Column '{name}' stands at {extreme:g} kPa {len(humps)} times while '{measured}' goes "
                    "on beyond and comes back: the log clipped the command, and the device got another."
                )
                numbers = {"at": float(extreme)}
                found.append(Finding("clipped_command", text, (name,), np.concatenate(humps), numbers))
    return found


def _stands(recording: Recording, u: np.ndarray, extreme: float) -> Iterator[tuple[int, int]]:
    """First row and row after the last where a command stands at an extreme, coming and leaving on ramps."""
    reach = np.ptp(u)
    for rows in recording.trials().values():
        stands = np.r_[False, u[rows] == extreme, False].astype(int)
        edges = np.flatnonzero(np.diff(stands)) + rows.start
        for a, b in zip(edges[::2], edges[1::2], strict=True):
            if b - a < 8 or a - 3 < rows.start or b + 3 > rows.stop:
                continue
            ramps = min(abs(u[a - 1] - u[a - 3]), abs(u[b + 2] - u[b])) > 0.002 * reach
            steps = max(abs(u[a] - u[a - 1]), abs(u[b] - u[b - 1])) > 0.1 * reach
            if ramps and not steps:
                yield int(a), int(b)


def coarse(recording: Recording) -> list[Finding]:
    """Readings that are multiples of one step, larger than the noise."""
    found, trials, gauges = [], recording.trials().values(), measured_pressures(recording)
    ramps = _on_ramps(recording)
    for name in _measured(recording):
        x = recording.column(name).astype(float)
        steps = [s for s in (_step(x[rows]) for rows in trials) if s is not None]
        still = [np.diff(x[rows])[~is_moving(x[rows][:, None])[1:]] == 0 for rows in trials]
        step = float(np.median(steps)) if len(steps) >= 0.5 * len(trials) else 0.0
        if step <= COARSE * np.ptp(x) or np.concatenate(still).mean() < 0.3:
            step = _comb(x[ramps]) if name in gauges else None
        if step is None:
            continue
        text = (
            f"Column '{name}' moves in steps of {step:.3g}: what it shows between them is lost, so count "
            f"{step / np.sqrt(12):.2g} (the step over the root of 12) as its noise at least."
        )
        found.append(Finding("quantised", text, (name,), numbers={"step": step}))
    return found


def _step(x: np.ndarray) -> float | None:
    """The step of which all differences (in one trial) are multiples; None where there is none."""
    levels = np.unique(x)
    if len(levels) < 6 or len(levels) > 0.5 * len(x):
        return None
    gaps = np.diff(levels)
    step = float(np.median(gaps[gaps < 1.5 * gaps.min()]))
    digits = 2e-4 * np.abs(levels).max()  # a file may hold four digits
    off = np.abs(gaps / step - np.round(gaps / step)) * step
    return step if (off <= np.maximum(0.05 * step, min(digits, 0.2 * step))).mean() > 0.95 else None


def _on_ramps(recording: Recording) -> np.ndarray:
    """Mask (n,) of rows in which readings should pass every value: the command moves, and not in steps."""
    u = recording.commands
    out = np.zeros(len(u), bool)
    for rows in recording.trials().values():
        move = np.r_[0.0, np.abs(np.diff(u[rows], axis=0)).max(1)] / max(float(np.ptp(u)), 1e-9)
        out[rows] = (minimum_filter1d(move, 11) > 1e-5) & (maximum_filter1d(move, 11) < 0.03)
    return out


def _comb(x: np.ndarray) -> float | None:
    """The step around whose multiples readings gather, with noise upon it; None where there is none.

    By the first Fourier coefficient of their density: 1 for those on a comb, near 0 for those spread out.
    """
    if len(x) < 200 or np.ptp(x) < 1e-12:
        return None
    steps = np.ptp(x) / np.arange(3.0, 100.0, 0.1)
    x = x[:: max(1, len(x) // 600)] - (x.min() + x.max()) / 2  # in the middle a step's error counts least
    gathered = np.abs(np.exp(2j * np.pi * x[:, None] / steps).mean(0))
    best = np.flatnonzero(gathered > GATHERED)
    return float(steps[best[0] + np.argmax(gathered[best[0] : best[0] + 10])]) if len(best) else None


def repeated(recording: Recording) -> list[Finding]:
    """Gauges that are read less often than rows are written."""
    found = []
    steps = {f.columns[0]: f.numbers["step"] for f in coarse(recording)}
    for name, command in measured_pressures(recording).items():
        x, u = (recording.column(c).astype(float) for c in (name, command))
        lasts = [_lasts(x[rows], u[rows], 2 * steps.get(name, 0.0)) for rows in recording.trials().values()]
        lasts = np.concatenate(lasts)
        usual = int(np.median(lasts)) if len(lasts) else 1
        exact = usual > 1 and (lasts == usual).mean() > 0.8
        if len(lasts) < 20 or not (exact or lasts.mean() > 1.4):
            continue
        each = float(usual if exact else lasts.mean())
        how = f"each value {usual} times" if exact else f"its values, about {each:.1f} times each,"
        text = (
            f"Column '{name}' repeats {how} while rows go on: it is read less often than they are written, "
            "so its readings are late by up to that much, and neighbouring rows do not show its noise."
        )
        found.append(Finding("repeated", text, (name,), numbers={"rows_each": each}))
    return found


def _lasts(x: np.ndarray, u: np.ndarray, least: float) -> np.ndarray:
    """For how many rows each reading stands between two changes of at least so much.

    Without those that stand long, as pressure may, and those that came and stay with a step of the command.
    """
    new = np.flatnonzero(np.r_[True, np.diff(x) != 0])
    lasts, change = np.diff(new)[1:], np.abs(np.diff(x[new]))
    ideal = (np.diff(u, prepend=u[0]) != 0)[new[1:-1]] & (u[new[2:] - 1] == u[new[1:-1]]) & (lasts > 1)
    return lasts[(lasts <= STANDS) & (np.minimum(change[:-1], change[1:]) >= least) & ~ideal]
