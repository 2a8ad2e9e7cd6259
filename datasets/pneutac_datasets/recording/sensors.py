"""Faults of the tracker (jumps, slips, frozen poses) and of other sensors (saturation, steps, clipping)."""

from collections.abc import Iterator

import numpy as np
from scipy.ndimage import maximum_filter1d, median_filter, minimum_filter1d

from pneutac_datasets.recording.noise import headline
from pneutac_datasets.recording.pressures import measured_pressures
from pneutac_datasets.recording.recording import Recording
from pneutac_datasets.recording.wording import Finding, plural

LONGEST_EXCURSION_S = 2.0
EXPLAINED_BY_S = 2.0  # a pressure change this long before can still move the tip (dead time and fill time)
BEFORE_ROWS = 5  # whose median is where the marker was before it moved
LONELY_ROWS = 3  # in so few no device goes somewhere and back, but for a pulse of pressure
MOST_LOST = 0.03  # of the rows repeat the one before where frames were lost; of a slow tracker more do
STARTED_BY_S = 1.0  # a trial may begin with a step that came before its first sample


def where(recording: Recording, row: int) -> str:
    """`trial 3 at 1.40 s`."""
    return f"trial {recording.column('trial')[row]} at {recording.column('time_s')[row]:.2f} s"


def jumps(recording: Recording) -> Iterator[Finding]:
    """Rows of excursions: the marker leaves faster than anything explains and is back within two seconds."""
    columns, _ = headline(recording)
    pose = recording.samples[columns].to_numpy(float)
    # other chambers, also of a neighbouring device, move the marker too
    pressure = recording.samples[[c for c in recording.samples if c.endswith("_kpa")]].to_numpy(float)
    bad, slips = np.zeros(len(recording), bool), []
    for rows in recording.trials().values() if columns else ():
        y = pose[rows]
        if len(y) < 10:
            continue
        stale = np.r_[False, (np.diff(y, axis=0) == 0).all(1)]
        for a, b, returns in excursions(recording.column("time_s")[rows], y, pressure[rows]):
            if stale[a - 1] and stale.mean() < 0.05:
                continue  # a tracker that stood still for once catches up
            if returns:
                bad[rows.start + a : rows.start + b] = True
            else:
                slips.append(rows.start + a)
    if bad.any():
        at, many = np.flatnonzero(bad), bool(bad.mean() > 0.05)
        first, times = where(recording, at[0]), plural(len(list(stretches(bad))), "time")
        text = f"The tracker jumps away and comes back {times} (first in {first}); {_left_out(bad)}."
        if many:
            text = (
                f"The tracker seems to jump in {bad.mean():.0%} of the rows (first in {first}); so many may "
                "be the device itself, so they were not removed: see a video."
            )
        yield Finding("jumps", text, tuple(columns), at, {"kept": int(many)})
    if slips:
        text = (
            f"The marker shifts suddenly {plural(len(slips), 'time')} without a change of pressure that "
            f"explains it and stays there (first in {where(recording, slips[0])}); these rows were not "
            "changed: a slipped marker or the device itself."
        )
        yield Finding("shift", text, tuple(columns), np.array(slips))


def excursions(t: np.ndarray, y: np.ndarray, p: np.ndarray) -> list[tuple[int, int, bool]]:
    """Sudden unexplained moves of one trial: first row, row after the last, whether the position came back.

    Times t (n,) are in s, positions y (n, k) measured, p (n, k) every pressure in kPa.
    """
    span = np.linalg.norm(np.quantile(y, 0.99, axis=0) - np.quantile(y, 0.01, axis=0))
    size = np.r_[0.0, np.linalg.norm(np.diff(y, axis=0), axis=1)]
    window = 2 * min(max(5, round(0.5 / np.median(np.diff(t)))), len(t)) + 1
    usual = np.maximum(median_filter(size, window, mode="nearest"), np.median(size))
    # a sudden change of pressure shortly before, as motion at three times the mean slope over the range
    back = np.searchsorted(t, t - EXPLAINED_BY_S)
    change = np.r_[0.0, np.abs(np.diff(p, axis=0)).max(1)]
    change = np.cumsum(change * (change > 3 * median_filter(change, window, mode="nearest")))
    change *= 3 * span / max(float(np.ptp(p, axis=0).max()), 1e-9)
    # at least the row's own change: in a slow log it is more than 0.15 s long
    since = np.maximum(np.minimum(np.searchsorted(t, t - 0.15), np.arange(len(t)) - 1), 0)

    def explained(i: int, peak: int, end: int) -> float:
        """How far the pressure may have moved it, before row `end`, in the time from `before` to `peak`."""
        at = np.arange(back[i], end)
        begins = np.minimum(since[at], at - (peak - i + BEFORE_ROWS // 2 + 1))
        return float((change[at] - change[np.maximum(begins, 0)]).max())

    found, end = [], 0
    for i in np.flatnonzero(size > np.maximum(8 * usual, 0.02 * span)).tolist():
        if i < end or t[i] - t[0] < STARTED_BY_S:
            continue
        peak = i
        while peak + 1 < len(t) and size[peak + 1] > 4 * usual[peak + 1]:
            peak += 1
        before = np.median(y[max(0, i - BEFORE_ROWS) : i], axis=0)
        away = np.linalg.norm(y[i : peak + 1] - before, axis=1)
        reach = float(away.max())
        after = y[i : np.searchsorted(t, t[i] + LONGEST_EXCURSION_S)]
        off = np.linalg.norm(after - before, axis=1)
        # after a few rows a device that moves on is not where it was, but its marker jumps back
        way = (y[i + int(away.argmax())] - before) / max(reach, 1e-12)
        jumps_back = np.diff(after, axis=0, prepend=after[:1]) @ way < -0.5 * reach
        jumps_back &= (after - before) @ way < 0.5 * reach
        jumps_back[LONELY_ROWS + 1 :] = False
        home = 1 + np.flatnonzero(((off < 0.15 * reach) | jumps_back)[1:])
        if len(home):
            # no device leaves and comes back by itself; a pulse of pressure or the swing after a step does
            home = i + int(home[0])
            if explained(i, peak, home + 1) < reach or _lonely(y, p, i, home):
                home = min(len(t), home + round(0.3 * (home - i)))
                found.append((i, home, True))
                end = home + 1  # the jump back is not another one
        elif explained(i, peak, peak + 1) < reach:
            end = peak + 1
            found.append((i, end, False))
    return found


def _lonely(y: np.ndarray, p: np.ndarray, i: int, end: int) -> bool:
    """Whether few rows i..end-1 differ from calm neighbours on both sides, and no pulse of pressure does.

    Of a pulse a pressure leaves by row i and is back or beyond by row `end`, as the marker.
    """
    moved = p[max(i - 1, 0) : min(end, len(p) - 1) + 1] - p[max(i - 2, 0)]
    row, chamber = np.unravel_index(np.abs(moved[:-1]).argmax(), moved[:-1].shape)
    away = moved[row, chamber]
    pulse = abs(away) > 0.05 * np.ptp(p, axis=0).max() and moved[-1, chamber] / away < 0.5
    around = np.r_[y[max(0, i - 4) : i], y[end : end + 4]]
    middle = np.median(around, axis=0)
    calm, off = (np.linalg.norm(rows - middle, axis=1) for rows in (around, y[i:end]))
    return bool(end - i <= LONELY_ROWS and not pulse and off.min() > 4 * max(calm.max(), 1e-12))


def frozen(recording: Recording) -> Iterator[Finding]:
    """Rows where every observed number repeats for half a second and more while the pressure moves."""
    _, repeats = _pose(recording)
    p, t = recording.commands, recording.column("time_s")
    bad, least = np.zeros(len(recording), bool), 0.05 * np.ptp(p, axis=0).max()
    for a, b in stretches(repeats):
        early = p[a : _early(t, a, b)]
        if b - a >= 8 and t[b - 1] - t[a] >= 0.5 and np.ptp(early, axis=0).max() > least:
            bad[a:b] = True
    # a recording without any noise repeats numbers everywhere, which says nothing about the tracker
    if repeats.sum() - bad.sum() <= 0.2 * len(recording) and bad.any():
        at = np.flatnonzero(bad)
        text = (
            f"The tracker stands still while the pressure moves (first in {where(recording, at[0])}); "
            f"{_left_out(bad)}."
        )
        yield Finding("frozen", text, tuple(recording.poses), at)


def stale(recording: Recording) -> Iterator[Finding]:
    """Rows that repeat the pose of the row before to the last digit, also while it moves.

    Few are mostly frames that were lost, and are left out; many are of a tracker that is slower than the log.
    """
    pose, repeats = _pose(recording)
    moving = np.concatenate([is_moving(pose[rows]) for rows in recording.trials().values()])
    share = repeats[moving].mean() if moving.any() else 0.0
    if (repeats & moving).sum() >= 10 and share >= 0.005:
        lost = repeats.mean() <= MOST_LOST
        why = f"such a pose may be older than its time; {_left_out(repeats)}"
        if not lost:
            why = "frames were dropped, or the tracker is slower than the log, so such a pose is older"
            why += " than its time"
        text = (
            f"{repeats.mean():.1%} of the rows repeat the pose of the row before to the last digit, and so do"
            f" {share:.1%} of those in which it moves: {why}."
        )
        numbers = {"share": float(repeats.mean()), "kept": float(not lost)}
        yield Finding("stale_pose", text, tuple(recording.poses), np.flatnonzero(repeats), numbers)


def _pose(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """What is observed but images (n, k), and which rows (n,) repeat the row before."""
    pose = recording.samples[recording.poses].to_numpy(float)
    repeats = np.r_[False, (np.diff(pose, axis=0) == 0).all(1)] & bool(pose.shape[1])
    repeats[[rows.start for rows in recording.trials().values()]] = False
    return pose, repeats


def stretches(mask: np.ndarray) -> Iterator[tuple[int, int]]:
    """First row, and row after the last, of each stretch in which a mask (n,) is true."""
    edges = np.flatnonzero(np.diff(np.r_[0, mask.astype(int), 0])).tolist()
    return zip(edges[::2], edges[1::2], strict=True)


def _early(t: np.ndarray, a: int, b: int) -> int:
    """Row after the early ones of a stretch a..b-1: what changes later may move the tip only after it."""
    late = min(EXPLAINED_BY_S, (t[b - 1] - t[a]) / 2)
    return a + int(np.searchsorted(t[a:b], t[b - 1] - late, "right"))


def is_moving(y: np.ndarray) -> np.ndarray:
    """Mask (n,) of rows around which a signal (n, k) moves within ten rows by 3 % of its span."""
    n = len(y)
    far = np.linalg.norm(y[np.minimum(np.arange(n) + 5, n - 1)] - y[np.maximum(np.arange(n) - 5, 0)], axis=1)
    return far > max(0.03 * np.linalg.norm(np.ptp(y, axis=0)), 1e-12)


def _left_out(bad: np.ndarray) -> str:
    n = int(bad.sum())
    return f"{plural(n, 'row')} {'is' if n == 1 else 'are'} left out"


COARSE = 1e-3  # of the range: smaller steps are the digits of the file
GATHERED = 0.7
STANDS = 12  # rows: readings that stand for longer may be pressures that stand
SETTLES_S = 0.3  # for which a valve or tracker may be late
PILED = 3  # times the rows at the next number that a sensor's end holds
NEAR_REST = 0.2  # of the largest pressure


def saturated(recording: Recording) -> Iterator[Finding]:
    """Columns that stick to their largest or smallest number while the command varies."""
    command, t = recording.commands, recording.column("time_s")
    for name in (*recording.poses, *measured_pressures(recording)):
        x, seen = recording.column(name), name in recording.observations
        numbers, counts = np.unique(x, return_counts=True)
        for end, inwards, word in ((-1, -2, "largest"), (0, 1, "smallest")):
            # coarse steps gather rows at each number; what saturates gathers them at the last
            if len(numbers) < 2 or counts[end] < PILED * counts[inwards]:
                continue
            at, early = x == numbers[end], np.zeros(len(x), bool)
            for rows in recording.trials().values():
                for a, b in stretches(at[rows]):
                    early[rows.start + a : rows.start + _early(t[rows], a, b)] = True
            spread = np.ptp(command[early], axis=0).max() / max(np.ptp(command, axis=0).max(), 1e-9)
            if at.sum() < 20 or at.mean() <= 0.01 or spread <= 0.1:
                continue
            gone = seen and _goes_on(recording, at)
            what = ", the marker leaves its view or the device is held" * seen
            follows = "a fit follows that; if it is the sensor, leave those rows out, or"
            text = (
                f"Column '{name}' sticks to its {word} number {numbers[end]:g} in {at.mean():.1%} of the rows"
                f" while the command varies: the sensor saturates there{what}; "
                f"{f'{_left_out(at)};' if gone else follows} record within its range."
            )
            found = {"at": float(numbers[end]), "kept": int(not gone)}
            yield Finding("saturated", text, (name,), np.flatnonzero(at), found)


def _goes_on(recording: Recording, at: np.ndarray) -> bool:
    """Whether the pressure goes on away from rest while a column of a finger sticks in these rows (n,).

    A device at rest, in its dead zone or held by friction as the pressure turns sticks too. Of several
    chambers one may have nothing to do with the column.
    """
    t, u = recording.column("time_s"), np.abs(recording.commands).max(axis=1)
    if len(recording.pressure_columns) > 1:
        return False
    for rows in recording.trials().values():
        for a, b in stretches(at[rows]):
            late = u[rows][a:b][t[rows][a:b] > t[rows][a] + SETTLES_S]
            if len(late) and late[0] > NEAR_REST * u.max() and late.max() - late[0] > 0.05 * u.max():
                return True
    return False


def clipped_command(recording: Recording) -> Iterator[Finding]:
    """Commands that stand at their extreme between two ramps while the measured pressure goes on and returns.

    A held command lets the pressure settle; it does not make it rise and fall again.
    """
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
                rows, numbers = np.concatenate(humps), {"at": float(extreme)}
                yield Finding("clipped_command", text, (name,), rows, numbers)


def _stands(recording: Recording, u: np.ndarray, extreme: float) -> Iterator[tuple[int, int]]:
    """First row and row after the last where a command stands at an extreme, coming and leaving on ramps."""
    reach = np.ptp(u)
    for rows in recording.trials().values():
        for a, b in stretches(u[rows] == extreme):
            a, b = a + rows.start, b + rows.start
            if b - a < 8 or a - 3 < rows.start or b + 3 > rows.stop:
                continue
            ramps = min(abs(u[a - 1] - u[a - 3]), abs(u[b + 2] - u[b])) > 0.002 * reach
            steps = max(abs(u[a] - u[a - 1]), abs(u[b] - u[b - 1])) > 0.1 * reach
            if ramps and not steps:
                yield a, b


def coarse(recording: Recording) -> Iterator[Finding]:
    """Readings that are multiples of one step, larger than the noise."""
    trials, gauges, u = recording.trials().values(), measured_pressures(recording), recording.commands
    # where readings should pass every value: the command moves, and not in steps
    ramps = np.zeros(len(u), bool)
    for rows in trials:
        move = np.r_[0.0, np.abs(np.diff(u[rows], axis=0)).max(1)] / max(float(np.ptp(u)), 1e-9)
        ramps[rows] = (minimum_filter1d(move, 11) > 1e-5) & (maximum_filter1d(move, 11) < 0.03)
    for name in (*recording.poses, *gauges):
        x = recording.column(name).astype(float)
        steps = [s for s in (_step(x[rows]) for rows in trials) if s is not None]
        still = [np.diff(x[rows])[~is_moving(x[rows][:, None])[1:]] == 0 for rows in trials]
        step = float(np.median(steps)) if len(steps) >= 0.5 * len(trials) else 0.0
        if step <= COARSE * np.ptp(x) or np.concatenate(still).mean() < 0.3:
            step = _comb(x[ramps]) if name in gauges else None
        if step is not None:
            text = (
                f"Column '{name}' moves in steps of {step:.3g}: what it shows between them is lost, so count "
                f"{step / np.sqrt(12):.2g} (the step over the root of 12) as its noise at least."
            )
            yield Finding("quantised", text, (name,), numbers={"step": step})


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


def repeated(recording: Recording) -> Iterator[Finding]:
    """Gauges that are read less often than rows are written."""
    steps = {f.columns[0]: f.numbers["step"] for f in coarse(recording)}
    for name, command in measured_pressures(recording).items():
        lasts = np.zeros(0, int)  # for how many rows each reading stands between two changes
        for rows in recording.trials().values():
            x, u = (recording.column(c)[rows].astype(float) for c in (name, command))
            new = np.flatnonzero(np.r_[True, np.diff(x) != 0])
            stands, change = np.diff(new)[1:], np.abs(np.diff(x[new]))
            # without what stands long, as pressure may, and what came and stays with a step of the command
            usual = (stands <= STANDS) & (np.minimum(change[:-1], change[1:]) >= 2 * steps.get(name, 0.0))
            ideal = (np.diff(u, prepend=u[0]) != 0)[new[1:-1]] & (u[new[2:] - 1] == u[new[1:-1]])
            lasts = np.r_[lasts, stands[usual & ~(ideal & (stands > 1))]]
        each = int(np.median(lasts)) if len(lasts) else 1
        exact = each > 1 and (lasts == each).mean() > 0.8
        if len(lasts) < 20 or not (exact or lasts.mean() > 1.4):
            continue
        how = f"each value {each} times" if exact else f"its values, about {lasts.mean():.1f} times each,"
        text = (
            f"Column '{name}' repeats {how} while rows go on: it is read less often than they are written, "
            "so its readings are late by up to that much, and neighbouring rows do not show its noise."
        )
        yield Finding(
            "repeated", text, (name,), numbers={"rows_each": float(each if exact else lasts.mean())}
        )
