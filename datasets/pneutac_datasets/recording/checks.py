"""Looks at a recording before any model does: faults of tracker, sensors, clock and experiment."""

import numpy as np

from pneutac_datasets.recording.noise import headline
from pneutac_datasets.recording.recording import Recording
from pneutac_datasets.recording.wording import plural

LONGEST_EXCURSION_S = 2.0
EXPLAINED_BY_S = 2.0  # a pressure change this long before can still move the tip (dead time and fill time)
STARTED_BY_S = 1.0  # a trial may begin with a step that came before its first sample


def check(recording: Recording) -> tuple[Recording, list[str]]:
    """Finds faults and leaves out the rows that are certainly wrong.

    Returns:
        The recording without rows where the tracker jumped away and came back or stood still, and one plain
        sentence for each finding (the loader's warnings first).
    """
    findings = list(recording.warnings)
    if recording.device == "gel":
        return recording, findings
    keep = np.ones(len(recording), bool)
    for look in (_jumps, _frozen):
        sentences, bad = look(recording)
        findings += sentences
        keep &= ~bad
    findings += _saturation(recording) + _clock(recording) + _closed_loop(recording)
    if not any(recording.has(c.replace("cmd_", "")) for c in recording.pressure_columns):
        findings.append(
            "There is no measured pressure, so a slow valve and a creeping body look alike; log pressure_kpa."
        )
    clean = recording if keep.all() else recording.keep(keep)
    return clean, findings


def _jumps(recording: Recording) -> tuple[list[str], np.ndarray]:
    """Rows of excursions: the marker leaves faster than anything explains and is back within two seconds."""
    bad = np.zeros(len(recording), bool)
    columns, _ = headline(recording)
    # other chambers move the marker too
    pressures = [c for c in recording.samples if c.endswith("_kpa")]
    steps, first, first_step = 0, None, None
    for trial, rows in recording.trials().items() if columns else ():
        y = recording.samples[columns].to_numpy(float)[rows]
        t = recording.column("time_s")[rows]
        p = recording.samples[pressures].to_numpy(float)[rows]
        if len(t) < 10:
            continue
        for a, b, returns in excursions(t, y, p):
            where = f"trial {trial} at {t[a]:.2f} s"
            if returns:
                first = first or where
                bad[rows.start + a : rows.start + b] = True
            else:
                first_step = first_step or where
                steps += 1
    findings = []
    if bad.mean() > 0.05:
        findings.append(
            f"The tracker seems to jump in {bad.mean():.0%} of the rows (first in {first}); so many may be "
            "the device itself, so they are kept: look at the video."
        )
        bad[:] = False
    elif bad.any():
        runs = int(np.sum(np.diff(np.r_[0, bad.astype(int)]) == 1))
        findings.append(
            f"The tracker jumps away and comes back {plural(runs, 'time')} (first in {first}); "
            f"{_left_out(bad)}."
        )
    if steps:
        findings.append(
            f"The marker shifts suddenly {plural(steps, 'time')} without a change of pressure and stays "
            f"there (first in {first_step}); these rows are kept: a slipped marker or the device itself."
        )
    return findings, bad


def excursions(t: np.ndarray, y: np.ndarray, p: np.ndarray) -> list[tuple[int, int, bool]]:
    """Sudden unexplained moves of one trial.

    Args:
        t: time (n,) in s.
        y: measured position (n, k).
        p: every pressure (n, k) in kPa.

    Returns:
        First row, row after the last, and whether the position came back within `LONGEST_EXCURSION_S`.
    """
    span = np.linalg.norm(np.quantile(y, 0.99, axis=0) - np.quantile(y, 0.01, axis=0))
    size = np.r_[0.0, np.linalg.norm(np.diff(y, axis=0), axis=1)]
    window = max(5, round(0.5 / np.median(np.diff(t))))
    usual = _local_median(size, window)
    noise = np.median(size)
    sudden = size > np.maximum(8 * np.maximum(usual, noise), 0.02 * span)
    # a sudden change of pressure shortly before, as motion at three times the mean slope over the range
    back = np.searchsorted(t, t - EXPLAINED_BY_S)
    change = np.r_[0.0, np.abs(np.diff(p, axis=0)).max(1)]
    change *= change > 3 * _local_median(change, window)
    change = np.cumsum(change)
    change -= change[np.searchsorted(t, t - 0.15)]
    change *= 3 * span / max(float(np.ptp(p, axis=0).max()), 1e-9)
    found, end = [], 0
    for i in np.flatnonzero(sudden):
        if i < end or t[i] - t[0] < STARTED_BY_S:
            continue
        peak = i
        while peak + 1 < len(t) and size[peak + 1] > 4 * max(usual[peak + 1], noise):
            peak += 1
        before = np.median(y[max(0, i - 5) : i], axis=0)
        away = np.linalg.norm(y[i : peak + 1] - before, axis=1)
        reach = float(away.max())
        near = np.searchsorted(t, t[i] + LONGEST_EXCURSION_S)
        off = np.linalg.norm(y[i:near] - before, axis=1)
        home = np.flatnonzero((off < 0.15 * reach) & (np.arange(len(off)) > 0))
        if len(home):
            # no device leaves and comes back by itself; a pulse of pressure or the swing after a step does
            end = i + int(home[0])
            if change[back[i] : end + 1].max() < reach or (end - i <= 3 and _lonely(y, i, end)):
                end = min(len(t), end + round(0.3 * (end - i)))
                found.append((int(i), int(end), True))
            else:
                end = i + 1
        elif change[back[i] : peak + 1].max() < reach:
            found.append((int(i), int(peak + 1), False))
            end = peak + 1
    return found


def _lonely(y: np.ndarray, i: int, end: int) -> bool:
    """Whether rows i..end-1 stand apart from calm neighbours on both sides."""
    around = np.r_[y[max(0, i - 4) : i], y[end : end + 4]]
    calm = np.linalg.norm(around - np.median(around, axis=0), axis=1).max()
    return bool(np.linalg.norm(y[i:end] - np.median(around, axis=0), axis=1).min() > 4 * max(calm, 1e-12))


def _local_median(x: np.ndarray, window: int) -> np.ndarray:
    from scipy.ndimage import median_filter

    return median_filter(x, size=2 * window + 1, mode="nearest")


def _frozen(recording: Recording) -> tuple[list[str], np.ndarray]:
    """Rows where every observed number repeats for half a second and more while the pressure moves."""
    bad = np.zeros(len(recording), bool)
    columns = [c for c in recording.observations if not c.startswith("image")]
    p_span = np.ptp(recording.samples[recording.pressure_columns].to_numpy(float), axis=0).max()
    repeated = 0
    for rows in recording.trials().values() if columns else ():
        y = recording.samples[columns].to_numpy(float)[rows]
        p = recording.samples[recording.pressure_columns].to_numpy(float)[rows]
        t = recording.column("time_s")[rows]
        same = np.r_[False, (np.diff(y, axis=0) == 0).all(1)]
        repeated += int(same.sum())
        edges = np.flatnonzero(np.diff(np.r_[0, same.astype(int), 0]))
        for a, b in zip(edges[::2], edges[1::2], strict=True):
            if b - a >= 8 and t[b - 1] - t[a] >= 0.5 and np.ptp(p[a:b], axis=0).max() > 0.05 * p_span:
                bad[rows.start + a : rows.start + b] = True
    # a recording without any noise repeats numbers everywhere, which tells nothing about the tracker
    if repeated - bad.sum() > 0.2 * len(recording) or not bad.any():
        return [], np.zeros(len(recording), bool)
    first = int(np.argmax(bad))
    return [
        f"The tracker stands still while the pressure moves (first in trial "
        f"{recording.column('trial')[first]} at {recording.column('time_s')[first]:.2f} s); "
        f"{_left_out(bad)}."
    ], bad


def _left_out(bad: np.ndarray) -> str:
    n = int(bad.sum())
    return f"{plural(n, 'row')} {'is' if n == 1 else 'are'} left out"


def _saturation(recording: Recording) -> list[str]:
    """Columns that stick to their largest or smallest number while the command varies."""
    command = recording.samples[recording.pressure_columns].to_numpy(float)
    measured = [c for c in (n.replace("cmd_", "") for n in recording.pressure_columns) if recording.has(c)]
    findings = []
    for name in [*(c for c in recording.observations if not c.startswith("image")), *measured]:
        x = recording.column(name)
        for extreme, word in ((x.max(), "largest"), (x.min(), "smallest")):
            at = x == extreme
            spread = np.ptp(command[at], axis=0).max() / max(np.ptp(command, axis=0).max(), 1e-9)
            if np.ptp(x) > 0 and at.sum() >= 20 and at.mean() > 0.01 and spread > 0.1:
                findings.append(
                    f"Column '{name}' sticks to its {word} number {extreme:g} in {at.mean():.1%} of the rows "
                    "while the command varies: the sensor saturates there."
                )
    return findings


def _clock(recording: Recording) -> list[str]:
    gaps, longest, where = 0, 0.0, ""
    for trial, rows in recording.trials().items():
        t = recording.column("time_s")[rows]
        dt = np.diff(t)
        if len(dt) < 5:
            continue
        wide = dt > max(10 * np.median(dt), 0.5)
        gaps += int(wide.sum())
        if wide.any() and dt.max() > longest:
            longest, where = float(dt.max()), f"trial {trial} at {t[int(dt.argmax())]:.1f} s"
    if not gaps:
        return []
    return [
        f"The clock has {plural(gaps, 'gap')} (the longest {longest:.1f} s, in {where}); what happened "
        "meanwhile is unknown to a model with memory, so start a new trial there."
    ]


def _closed_loop(recording: Recording) -> list[str]:
    """Whether the command answers to the measured motion (Granger's test on the command's own steps).

    A programmed command is predictable from its own past and owes nothing to the noise of the marker; a
    controller's next step follows the marker's last move. Held and ramped programs are never suspected.
    """
    columns, _ = headline(recording)
    gained, n = 0.0, 0
    for rows in recording.trials().values() if columns else ():
        p = recording.samples[recording.pressure_columns].to_numpy(float)[rows]
        y = recording.samples[columns].to_numpy(float)[rows]
        bent = np.abs(np.diff(p, 2, axis=0)).max(1, initial=0) > 1e-4 * max(np.ptp(p), 1e-9)
        if len(p) < 200 or bent.mean() < 0.5:
            continue
        du, dy = np.diff(p, axis=0), np.diff(y, axis=0)
        lags = 4
        past = [du[lags - 1 - k : len(du) - 1 - k] for k in range(lags)]
        own = np.hstack([*past, p[lags:-1], np.ones((len(du) - lags, 1))])
        motion = np.hstack([dy[lags - 1 - k : len(dy) - 1 - k] for k in range(lags)])
        target = du[lags:]
        alone = target - own @ np.linalg.lstsq(own, target, rcond=None)[0]
        both = np.hstack([own, motion])
        left = target - both @ np.linalg.lstsq(both, target, rcond=None)[0]
        gained += (1 - (left**2).sum() / max((alone**2).sum(), 1e-30)) * len(target)
        n += len(target)
    if n and gained / n > 0.15:
        return [
            f"The command follows the measured motion ({gained / n:.0%} of its steps are explained by it): "
            "under feedback noise passes for physics; record open-loop programs."
        ]
    return []
