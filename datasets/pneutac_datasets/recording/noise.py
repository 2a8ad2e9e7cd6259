"""How well a measurement repeats: the error below which no model can be told from the truth.

Half the variance of the difference between two repeats is the variance of one of them. Slow differences
(creep left over, drift of the session) are physics that a model may yet explain, so the floor is the fast
part; the whole difference is reported beside it.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from pneutac_datasets.recording.recording import Recording
from pneutac_datasets.recording.wording import plural
from pneutac_sim.finger import quantities

HOLD_S = 1.0  # pressure at rest for this long before a sample counts as held
WINDOW_S = 0.4
MAX_PAIRS = 12
MAD = 1.4826  # standard deviation of a normal distribution over its median absolute deviation


@dataclass
class NoiseFloor:
    """Noise of the headline measurement.

    Attributes:
        value: root mean square Euclidean distance caused by noise alone, in `unit`.
        session: the same including slow differences between repeats, None without repeats.
        unit: `mm`, `rad` or `1/m`.
        how: one plain sentence: how it was found.
        by_column: standard deviation of each observed column.
        known: whether it was stated or measured by repeats, not only seen as the fast part of the motion.
    """

    value: float
    session: float | None
    unit: str
    how: str
    by_column: dict[str, float]
    known: bool = True


def headline(recording: Recording) -> tuple[list[str], str]:
    """The columns whose Euclidean distance is the error, and its unit; see `finger.quantities`."""
    return quantities.headline(recording.observations, recording.device)


def noise_floor(recording: Recording) -> NoiseFloor:
    """Estimates the noise from repeats, else from what the file states, else from held pressure."""
    columns, unit = headline(recording)
    numeric = [c for c in recording.observations if not c.startswith("image")]
    pairs = repeats(recording)
    stated = recording.meta.get("noise") or {}
    session = None
    if pairs:
        fast = {c: [] for c in numeric}
        whole = {c: [] for c in numeric}
        for a, b, window in pairs:
            for c in numeric:
                d = recording.column(c)[a] - recording.column(c)[b]
                fast[c].append(_detrended(d, window))
                whole[c].append(d)
        by = {c: MAD * float(np.median(np.abs(np.concatenate(fast[c])))) / np.sqrt(2) for c in numeric}
        slow = {c: float(np.sqrt(np.mean(np.concatenate(whole[c]) ** 2) / 2)) for c in numeric}
        session = _norm(slow, columns)
        pair = plural(len(pairs), "pair")
        how = f"what differs from moment to moment between equal runs, {pair} of them"
    elif all(c in stated for c in columns):
        by = {c: float(stated[c]) for c in numeric if c in stated}
        how = "stated in recording.json"
    else:
        by, how = _from_holds(recording, numeric)
    known = bool(pairs) or all(c in stated for c in columns)
    return NoiseFloor(_norm(by, columns), session, unit, how, by, known)


def _norm(by: dict[str, float], columns: list[str]) -> float:
    return float(np.sqrt(sum(by[c] ** 2 for c in columns)))


def repeats(recording: Recording) -> list[tuple[np.ndarray, np.ndarray, int]]:
    """Pairs of stretches run under equal conditions.

    Returns:
        Row numbers of the first and of the second run, sample by sample, and the samples in one detrending
        window. Runs are compared from their start on: equal command, program, orientation, temperature
        (within 1 K) and payload, at least three seconds of it.
    """
    s = recording.samples
    time = s["time_s"].to_numpy()
    command = s[recording.pressure_columns].to_numpy(float)
    tolerance = 0.01 * max(float(np.ptp(command)), 1e-9)
    runs = _runs(recording)
    found = []
    for (i0, i1), (j0, j1) in combinations(runs, 2):
        if len(found) == MAX_PAIRS:
            break
        if "program" in s and s["program"].iloc[i0] != s["program"].iloc[j0]:
            continue
        if any(abs(s[c].iloc[i0] - s[c].iloc[j0]) > tol for c, tol in _TOLERANCES.items() if c in s):
            continue
        a = np.arange(i0, i1)
        ta, tb = time[a] - time[i0], time[j0:j1] - time[j0]
        nearest = np.clip(np.searchsorted(tb, ta), 1, len(tb) - 1) if len(tb) > 1 else np.zeros(len(ta), int)
        nearest -= (ta - tb[nearest - 1] < tb[nearest] - ta) if len(tb) > 1 else 0
        a = a[ta <= tb[-1]]
        b = j0 + nearest[: len(a)]
        equal = np.abs(command[a] - command[b]).max(1) <= tolerance
        n = len(equal) if equal.all() else int(np.argmin(equal))
        if n < 20 or ta[n - 1] < 3.0 or np.ptp(command[a[:n]]) <= tolerance:
            continue
        window = max(8, round(WINDOW_S * n / ta[n - 1]))
        found.append((a[:n], b[:n], window))
    return found


_TOLERANCES = {"gravity_x": 0.1, "gravity_y": 0.1, "gravity_z": 0.1, "temperature_c": 1.0, "payload_g": 0.1}


def _runs(recording: Recording) -> list[tuple[int, int]]:
    """First and last+1 row of each trial, cut also where the program changes."""
    runs = []
    for rows in recording.trials().values():
        edges = [rows.start, rows.stop]
        if recording.has("program"):
            p = recording.samples["program"].to_numpy()[rows]
            cuts = np.flatnonzero(p[1:] != p[:-1]) + 1 + rows.start
            if len(cuts) < 50:
                edges = [rows.start, *cuts, rows.stop]
        runs += list(zip(edges[:-1], edges[1:], strict=True))
    return runs


def _detrended(x: np.ndarray, window: int) -> np.ndarray:
    """Residuals (n - n % window,) of straight lines fitted window by window, scaled for the two they cost."""
    window = min(window, len(x))
    x = x[: len(x) // window * window].reshape(-1, window)
    t = np.linspace(-1, 1, window)
    basis = np.stack([np.ones(window), t], 1)
    q, _ = np.linalg.qr(basis)
    return ((x - (x @ q) @ q.T) * np.sqrt(window / max(window - 2, 1))).ravel()


def at_rest_mask(recording: Recording) -> np.ndarray:
    """Mask (n,): the commanded pressure has not moved for `HOLD_S` before this sample."""
    out = np.zeros(len(recording), bool)
    command = recording.samples[recording.pressure_columns].to_numpy(float)
    for rows in recording.trials().values():
        t = recording.column("time_s")[rows]
        p = command[rows]
        moved = np.r_[True, np.abs(np.diff(p, axis=0)).max(1) > 1e-3 * max(float(np.ptp(p)), 1e-9)]
        last = t[np.maximum.accumulate(np.where(moved, np.arange(len(t)), 0))]
        out[rows] = t - last >= HOLD_S
    return out


def _from_holds(recording: Recording, columns: list[str]) -> tuple[dict[str, float], str]:
    mask = at_rest_mask(recording)
    at_rest = mask.mean() > 0.02 and mask.sum() >= 40
    still = np.ptp(recording.samples[recording.pressure_columns].to_numpy(float), axis=0).max() < 1e-3
    how = "the fast part of the motion" + (
        ", as the commanded pressure never moves" if still
        else " while the commanded pressure is held" if at_rest
        else ", since the commanded pressure is hardly ever held"
    )  # fmt: skip
    use = mask if at_rest else np.ones(len(recording), bool)
    residuals: dict[str, list[np.ndarray]] = {c: [np.zeros(1)] for c in columns}
    for rows in recording.trials().values():
        t = recording.column("time_s")[rows]
        step = float(np.median(np.diff(t))) if len(t) > 1 else 1.0
        window = max(8, round((WINDOW_S if at_rest else WINDOW_S / 2) / max(step, 1e-6)))
        index = np.flatnonzero(use[rows]) + rows.start
        for piece in np.split(index, np.flatnonzero(np.diff(index) > 1) + 1):
            if len(piece) >= window:
                for c in columns:
                    residuals[c].append(_detrended(recording.column(c)[piece], window))
    if all(len(r) == 1 for r in residuals.values()):
        how = "unknown, the recording is too short to tell it"
    return {c: float(np.sqrt(np.mean(np.concatenate(r) ** 2))) for c, r in residuals.items()}, how
