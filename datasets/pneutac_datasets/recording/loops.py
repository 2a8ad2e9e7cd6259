"""Faults of clock and loop: pauses, missing rows, feedback, a command in the wrong row."""

import numpy as np

from pneutac_datasets.recording.finding import Finding
from pneutac_datasets.recording.gauges import measured_pressures
from pneutac_datasets.recording.noise import headline
from pneutac_datasets.recording.recording import Recording
from pneutac_datasets.recording.tracker import where
from pneutac_datasets.recording.wording import plural

LAGS = 6
ROUNDING = 1e-5  # of the command's range: what its own past leaves of a smooth program is rounding
ANSWERED = 0.15  # share of the command's steps that feedback explains and a program does not


def clock(recording: Recording) -> list[Finding]:
    """Long pauses within trials, and rows that are missing from an even clock."""
    gaps: list[int] = []
    lost: list[int] = []
    longest, missing, even = 0.0, 0, True
    for rows in recording.trials().values():
        t = recording.column("time_s")[rows]
        dt = np.diff(t)
        if len(dt) < 5:
            continue
        usual = float(np.median(dt))
        even &= bool((np.abs(dt - usual) < 0.2 * usual).mean() > 0.9)
        wide = dt > max(10 * usual, 0.5)
        gaps += list(np.flatnonzero(wide) + rows.start)
        longest = max(longest, float(dt[wide].max(initial=0)))
        short = (dt > 1.5 * usual) & ~wide
        lost += list(np.flatnonzero(short) + 1 + rows.start)
        missing += int(np.round(dt[short] / usual - 1).sum())
    found = []
    if gaps:
        at = max(gaps, key=lambda i: recording.column("time_s")[i + 1] - recording.column("time_s")[i])
        text = (
            f"The clock has {plural(len(gaps), 'gap')} (the longest {longest:.1f} s, in "
            f"{where(recording, at)}); what happened meanwhile is unknown to a model with memory, so start a "
            "new trial there."
        )
        found.append(Finding("gaps", text, ("time_s",), np.array(gaps) + 1, {"count": len(gaps)}))
    if lost and even:
        text = (
            f"{plural(missing, 'row')} {'is' if missing == 1 else 'are'} missing from an even clock (first "
            f"before {where(recording, lost[0])}): frames were dropped there."
        )
        found.append(Finding("missing_rows", text, ("time_s",), np.array(lost), {"count": missing}))
    return found


def closed_loop(recording: Recording) -> list[Finding]:
    """Whether the command answers to the measured motion (Granger's test on the command's own changes).

    A programmed command is predictable from its own past and owes nothing to the noise of the marker; a
    controller's next command follows the marker's last pose. Only rows are looked at in which the command
    changes, as a controller may be slower than the log. A pose of the row itself answers to the command too,
    but with the device's own sign, and a controller has the other. Held and ramped programs are never
    suspected.
    """
    columns, _ = headline(recording)
    gains = {"before": [0.0, 0], "same": [0.0, 0]}
    command = recording.samples[recording.pressure_columns].to_numpy(float)
    pose = recording.samples[columns].to_numpy(float)
    for rows in recording.trials().values() if columns else ():
        u = command[rows]
        y = pose[rows]
        at = 1 + np.flatnonzero(np.abs(np.diff(u, axis=0)).max(1, initial=0) > 0)
        if len(at) < 200:
            continue
        bent = np.abs(np.diff(u[at], 2, axis=0)).max(1) > 1e-4 * max(np.ptp(u), 1e-9)
        if bent.mean() < 0.5:
            continue
        target = u[at][LAGS:]
        # the last pose but one and all before it are known: what is news in the last is noise, or feedback
        known = np.hstack([_past(u[at], 1), _past(u[at] ** 2, 1), _past(y[at - 1], 1)])
        if _left(target, known).std(axis=0).max() < ROUNDING * max(np.ptp(u), 1e-9):
            continue
        before, left = _gain(target, known, y[at - 1][LAGS:])
        shown = (y @ _answer(u, y))[at][LAGS:]  # (n, chambers), each growing with its chamber's pressure
        same, sign = _same_row(left, np.hstack([known, y[at - 1][LAGS:]]), shown)
        for name, gain in (("before", before), ("same", same * (sign < 0))):
            gains[name][0] += gain * len(target)
            gains[name][1] += len(target)
    found = []
    before, same = (a / n if n else 0.0 for a, n in gains.values())
    if max(before, same) > ANSWERED:
        own_row = same > ANSWERED
        late = (
            " It answers to the pose of its own row, so it was sent after it was measured: log time_sent_s."
            if own_row
            else ""
        )
        text = (
            f"The command follows the measured motion ({max(before, same):.0%} of its steps are explained by "
            f"it): under feedback noise passes for physics; record open-loop programs.{late}"
        )
        numbers = {"share": max(before, same), "same_row": float(own_row)}
        found.append(Finding("closed_loop", text, tuple(recording.pressure_columns), numbers=numbers))
    return found


def _past(x: np.ndarray, first: int) -> np.ndarray:
    """(n - LAGS, k LAGS): the rows `first`, `first` + 1, ... before each."""
    return np.hstack([x[LAGS - first - k : len(x) - first - k] for k in range(LAGS)])


def _left(target: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """What regression on some columns, and a constant, leaves."""
    columns = np.c_[columns, np.ones(len(columns))]
    return target - columns @ np.linalg.lstsq(columns, target, rcond=None)[0]


def _gain(target: np.ndarray, own: np.ndarray, more: np.ndarray) -> tuple[float, np.ndarray]:
    """Share of what its own past leaves of a target that more columns explain (0 by chance); what is left."""
    alone, both = _left(target, own), _left(target, np.hstack([own, more]))
    n, k, m = len(target), own.shape[1] + 1, more.shape[1]
    scale = (n - k) / max(n - k - m, 1)
    return float(1 - scale * (both**2).sum() / max((alone**2).sum(), 1e-30)), both


def _same_row(left: np.ndarray, known: np.ndarray, shown: np.ndarray) -> tuple[float, float]:
    """Share of what is left that news in this row's pose explains, and the sign of its answer."""
    news = _left(shown, known)
    covariance = (left * news).sum()
    share = covariance**2 / max((left**2).sum() * (news**2).sum(), 1e-30)
    return float(min(share, 1.0)), float(np.sign(covariance))


def _answer(u: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(k, chambers) unit direction in which the device goes when a chamber's pressure grows."""
    slope = np.linalg.lstsq(np.c_[u, np.ones(len(u))], y, rcond=None)[0][: u.shape[1]].T
    return slope / np.maximum(np.linalg.norm(slope, axis=0), 1e-12)


def late_command(recording: Recording) -> list[Finding]:
    """Whether the device moves before its command does.

    Before steps out of a rest the pose will do; where the command never rests, the measured pressure decides,
    if it knows of the next row's command what nothing before it knew.
    """
    found = []
    gauges = {c: [m] for m, c in measured_pressures(recording).items()}
    for name in recording.pressure_columns:
        seen = gauges.get(name) or headline(recording)[0]
        reach = np.ptp(recording.column(name))
        trials = recording.trials().values()
        leads = [lead for rows in trials for lead in _leads(recording, name, seen, rows, reach)]
        ahead = [lead for lead in leads if lead > 0]
        if len(leads) >= 5 and len(ahead) >= 0.8 * len(leads):
            late, shown = int(np.median(ahead)), f"in {len(ahead)} of {len(leads)} steps"
        elif name in gauges and (late := _foreseen(recording, name, seen[0])):
            shown = "all along"
        else:
            continue
        what = f"Column '{seen[0]}'" if len(seen) == 1 else "The marker"
        rows = plural(late, "row")
        text = (
            f"{what} moves {rows} before the command '{name}' does, {shown}: the command is written too "
            f"late; move it up by {rows}, or give time_sent_s."
        )
        found.append(Finding("late_command", text, (name,), numbers={"rows_late": float(late)}))
    return found


def _leads(recording: Recording, name: str, seen: list[str], rows: slice, reach: float) -> list[int]:
    """By how many rows the device went ahead of each step of a command, of such a range, out of a rest."""
    u = recording.column(name)[rows].astype(float)
    y = recording.samples.iloc[rows][seen].to_numpy(float)
    other = [c for c in recording.pressure_columns if c != name]
    others = recording.samples.iloc[rows][other].to_numpy(float)
    moves = np.abs(np.diff(np.c_[u, others], axis=0, prepend=np.c_[u, others][:1])).max(1)
    out = []
    for i in np.flatnonzero(moves > 0.002 * reach):
        rested = i >= 10 and moves[i - 10 : i].max() <= 1e-6 * reach
        if not rested or i + 5 > len(u) or np.abs(u[i : i + 10] - u[i - 1]).max() < 0.1 * reach:
            continue
        calm = y[i - 10 : i - 4]
        way = y[min(i + 10, len(y) - 1)] - calm.mean(0)
        along = (y[i - 10 : i] - calm.mean(0)) @ way / max(np.linalg.norm(way), 1e-12)
        ahead = along[::-1] > max(0.03 * np.linalg.norm(way), 6 * along[:6].std(), 1e-12)
        out.append(int(np.argmin(np.r_[ahead, False])))
    return out


def _foreseen(recording: Recording, name: str, gauge: str) -> int:
    """How many rows ahead of an ever changing command its measured pressure is."""
    late = 0
    for ahead in (1, 2, 3):
        agree, n = 0.0, 0
        for rows in recording.trials().values():
            u, p = (np.diff(recording.column(c)[rows].astype(float)) for c in (name, gauge))
            if len(u) < 200 or (np.abs(np.diff(u)) > 1e-4 * max(np.ptp(u), 1e-9)).mean() < 0.5:
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
