"""Sessions that were mounted differently: a twin has one base, so such trials are moved onto the first one.

Per trial the tip is regressed on the pressure. Where, under equal conditions, the tip at rest lies far from
the first trial's or the same pressure bends it in another direction, the device was turned about its axis and
shifted between trials: that says nothing about its physics, and would drown what does. Every verb that weighs
a twin against a recording looks at it through `on_one_mount`.
"""

import numpy as np

from pneutac_datasets.recording.recording import Recording
from pneutac_sim.finger import BodyData, fit, simulate
from pneutac_sim.twin import Twin

FAR = 0.05  # of the device's length: further apart at rest than any creep leaves it
TURNED_DEG = 45.0
SWEEP = 0.3  # of the whole pressure range that a trial must cover to tell its rest and direction
CONDITIONS = {"gravity_x": 0.1, "gravity_y": 0.1, "gravity_z": 0.1, "temperature_c": 2.0, "payload_g": 0.1}
TIP = ["tip_x_mm", "tip_y_mm", "tip_z_mm"]


def on_one_mount(
    recording: Recording, twin: Twin, train: np.ndarray, refit: bool = True
) -> tuple[Recording, list[str]]:
    """The recording as if all sessions had been mounted alike, and a sentence where they were not.

    What a straight line in the pressure leaves of the shift is taken from what the twin misses each session
    by on average over training samples, so held-out samples are never looked at.

    Args:
        recording: cleaned; one of a single mount is returned as it is.
        twin: of the device.
        train: (n,) mask of training samples.
        refit: whether the twin is fitted first, or taken as it is.
    """
    aligned, warnings, alike = align_mounts(recording, twin.length_mm)
    if not warnings:
        return recording, []
    bench = BodyData.of(aligned, twin)
    found = fit(twin, bench, train=train, starts=2) if refit else simulate(twin, bench)
    return _settle(aligned, alike, found.residual, train), warnings


def align_mounts(recording: Recording, length_mm: float) -> tuple[Recording, list[str], list[int]]:
    """Moves trials that were mounted differently onto the mount of the first one.

    Args:
        recording: of a finger with three tip coordinates; any other is returned as it is.
        length_mm: of the device.

    Returns:
        The recording, a sentence where something was moved, and the trials whose mounts can be compared.
    """
    if recording.device != "finger" or not all(recording.has(c) for c in TIP):
        return recording, [], []
    column = "pressure_kpa" if recording.has("pressure_kpa") else "pressure_cmd_kpa"
    p = recording.column(column).astype(float)
    y = recording.samples[TIP].to_numpy(float)
    seen = {}
    for trial, rows in recording.trials().items():
        if np.ptp(p[rows]) > SWEEP * np.ptp(p) > 0:
            design = np.stack([np.ones(rows.stop - rows.start), p[rows] - p.min()], 1)
            seen[trial] = np.linalg.lstsq(design, y[rows], rcond=None)[0]
    if len(seen) < 2:
        return recording, [], []
    first = next(iter(seen))
    rest, slope = seen[first]
    moved, turned, alike, out = [], [], [first], y.copy()
    for trial, (here, direction) in seen.items():
        rows = recording.trials()[trial]
        if trial == first or not _same(recording, recording.trials()[first].start, rows.start):
            continue
        alike.append(trial)
        roll = np.arctan2(slope[1], slope[2]) - np.arctan2(direction[1], direction[2])
        roll = (roll + np.pi) % (2 * np.pi) - np.pi
        far = float(np.linalg.norm(here - rest))
        if abs(np.degrees(roll)) < TURNED_DEG and far < FAR * length_mm:
            continue
        if abs(np.degrees(roll)) >= TURNED_DEG:
            turned.append(str(trial))
        c, s = np.cos(roll), np.sin(roll)
        turn = np.array([[1, 0, 0], [0, c, s], [0, -s, c]])  # y, z -> towards the first trial's direction
        out[rows] = (y[rows] - here) @ turn.T + rest
        moved.append((str(trial), far))
    if not moved:
        return recording, [], []
    samples = recording.samples.copy()
    samples[TIP] = out
    sentence = (
        f"The device was mounted differently in {_trials([t for t, _ in moved])} (at rest its tip is "
        f"up to {max(f for _, f in moved):.0f} mm from where it is in trial {first}"
        + (f", and in {_trials(turned)} the same pressure bends it another way" if turned else "")
        + "); these trials are turned and shifted onto the first mount."
    )
    clean = Recording(recording.folder, recording.meta, samples, recording.device, recording.warnings)
    return clean, [sentence], alike


def _trials(numbers: list[str]) -> str:
    """`trial 3`, `trials 3, 4 and 5`."""
    *first, last = numbers
    return f"trials {', '.join(first)} and {last}" if first else f"trial {last}"


def _settle(recording: Recording, trials: list[int], residual: np.ndarray, train: np.ndarray) -> Recording:
    """Shifts these trials by what a fitted twin misses them by on average over training samples."""
    samples = recording.samples.copy()
    tip = samples[TIP].to_numpy(float)
    for trial in trials:
        rows = np.zeros(len(tip), bool)
        rows[recording.trials()[trial]] = True
        if (rows & train).any():
            tip[rows] -= residual[rows & train].mean(0)
    samples[TIP] = tip
    return Recording(recording.folder, recording.meta, samples, recording.device, recording.warnings)


def _same(recording: Recording, a: int, b: int) -> bool:
    """Whether two samples were taken under equal conditions."""
    s = recording.samples
    return all(abs(s[c].iloc[a] - s[c].iloc[b]) <= tol for c, tol in CONDITIONS.items() if c in s)
