"""Measured pressures against their commands and against the motion: which of them may drive a fit, and how.

A fit is driven by the measured pressure and judged by the commanded one, so the two must agree. A gauge that
does not follow its command is left out, a constant offset is taken off, and commands beyond what the supply
delivers count as what it delivers.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d
from scipy.signal import lfilter

from pneutac_datasets.recording import units
from pneutac_datasets.recording.noise import headline, regress, static_columns
from pneutac_datasets.recording.recording import Recording
from pneutac_datasets.recording.wording import Finding

BINS = 20  # of the command's range
LEAST_ROWS = 5  # of a bin that counts
FLAT = 0.1  # slope of the gauge over the command, relative to that below, at which it stands still
WIDE = 0.15  # share of the command's range over which it must do so
STANDS, FOLLOWS = 0.25, 0.5  # slope of the motion over the command, relative: the device stands, or goes on
PIECE = 0.3  # share of the command's range that makes a piece in which a gauge must move
SUSTAINED_S = 1.5  # that it stays beyond either end of that
STUCK = 0.1  # share of the usual motion below which it does not
LEAST_CORRELATION = 0.6
SCALES = 0.8, 1.25  # of a gauge over its command, within which air explains the difference
SAME_UNIT = 0.02  # by which a scale may differ from that of a unit, as a logarithm
OFFSET = 0.04  # share of the command's range that counts as an offset
LAGS_S = 0.0, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2  # time constants of the air that are tried
MOST_AHEAD = 3  # rows by which a log may write a command too late
LATE_S = 0.15  # by which a gauge comes late, at least
ATMOSPHERE_KPA = 90.0, 108.0  # at sea level and in the mountains
# kPa in one of them.
UNITS = {u: units.UNITS["pressure"][u.lower()] for u in ("psi", "mbar", "bar", "mmHg")} | {"kgf/cm2": 98.0665}
SUPPLY = "supply_kpa"  # field of a recording's `meta` that `usable` writes
ALONE = "fits use the command alone"


def measured_pressures(recording: Recording) -> dict[str, str]:
    """Column of measured pressure to that of its command."""
    pairs = {c.replace("cmd_", ""): c for c in recording.pressure_columns}
    return {m: c for m, c in pairs.items() if recording.has(m)}


def usable(recording: Recording) -> tuple[Recording, list[Finding]]:
    """The recording as fits may use it, and a finding for each pressure that another measurement contradicts.

    Returns:
        The recording without the gauges that do not follow their commands, without constant offsets, and
        with commands that end where the supply does (field `supply_kpa` of its `meta`: column to level).
    """
    found: list[Finding] = []
    for measured, command in measured_pressures(recording).items():
        recording, more = _judged(recording, measured, command)
        found += more
    return recording, [*found, *_absolute(recording, {c for f in found for c in f.columns})]


def supply_limits(recording: Recording) -> dict[str, float]:
    """Column of a command to the pressure at which its supply ends, of those that `usable` found."""
    found = recording.meta.get(SUPPLY, {})
    return found if isinstance(found, dict) else {}


def _judged(recording: Recording, measured: str, command: str) -> tuple[Recording, list[Finding]]:
    """The recording with one gauge and its command as they may be used, and why."""
    p, raw = (recording.column(c).astype(float) for c in (measured, command))
    u, reach, device = _lagged(recording, p, raw), float(np.ptp(raw)), recording.device
    if reach <= 1e-3:
        return recording, []
    without = replace(recording, samples=recording.samples.drop(columns=measured))

    def left_out(kind: str, text: str, rows=(), **numbers: float) -> tuple[Recording, list[Finding]]:
        text = f"Column '{measured}' {text}; {ALONE}."
        return without, [Finding(kind, text, (measured,), np.array(rows, int), numbers)]

    if np.ptp(p) < 1e-6 * reach:
        text = f"stands at {p[0]:.4g} in every row while '{command}' moves: the gauge carries no information"
        return left_out("gauge_stuck", text, at=float(p[0]))
    flat = [end for sign in (1, -1) if (end := _end(u, p, reach, sign)) is not None]
    for end in flat:
        way = _device_goes_on(recording, u, end.rows)
        if way is not False:
            text = f"stays at {end.level:.4g} while '{command}' goes on from {end.begin:.4g} to"
            text += f" {end.far:.4g} kPa" + ("" if way is None else f" and the {device} follows the command")
            text += ": the gauge saturates" + ("" if way else ", or the supply ends there")
            return left_out("saturated", text, np.flatnonzero(end.rows), at=end.level)
    inside = ~np.any([end.rows for end in flat], axis=0) if flat else np.ones(len(p), bool)
    stuck = _stuck(recording, u, p, reach, inside)
    if len(stuck):
        trial, t = (recording.column(c)[stuck[0]] for c in ("trial", "time_s"))
        when = f"in {len(stuck) / len(p):.0%} of the rows (first in trial {trial} at {t:.2f} s)"
        when = "throughout" if len(stuck) > 0.9 * inside.sum() else when
        at = float(np.median(p[stuck]))
        text = f"stands near {at:.4g} {when} while '{command}' moves: the gauge was stuck"
        return left_out("gauge_stuck", text, stuck, at=at)
    if late := _late(recording, p, inside):
        text = f"shows each change {late:.2g} s after the {device} has moved: it is read late"
        return left_out("gauge_late", text, late_s=late)
    slope, at_zero, correlation = 0.0, float(np.median(p[inside])) if inside.any() else 0.0, 0.0
    if inside.sum() >= 2 and np.ptp(u[inside]) >= 1e-9 and np.ptp(p[inside]) >= 1e-9:
        slope, at_zero = map(float, np.polyfit(u[inside], p[inside], 1))
        correlation = float(np.corrcoef(u[inside], p[inside])[0, 1])
    if abs(correlation) < LEAST_CORRELATION:
        text = f"does not follow '{command}' (correlation {correlation:.2f})"
        return left_out("gauge_alone", text, correlation=correlation)
    for unit, kpa in UNITS.items():
        for factor, wrong in ((1 / kpa, measured), (kpa, command)):
            if slope > 0 and abs(np.log(slope / factor)) < SAME_UNIT:
                text = (
                    f"Column '{measured}' moves {slope:.3g} times as far as '{command}', as kPa and {unit} "
                    f"do: '{wrong}' seems to be in {unit}; multiply it by {kpa:.6g}. Until then {ALONE}."
                )
                return without, [Finding("other_unit", text, (wrong,), numbers={"ratio": slope})]
    if not SCALES[0] < slope < SCALES[1]:
        text = (
            f"Column '{measured}' moves {slope:.2g} times as far as '{command}' and reads {at_zero:.3g} at a "
            f"command of 0: {_other_scale(command, raw, slope)}; give both in kPa. Until then {ALONE}."
        )
        return without, [Finding("gauge_scale", text, (measured,), numbers={"ratio": slope})]
    found = []
    offset = at_zero + (slope - 1) * float(raw[np.argmin(np.abs(raw))])
    if abs(offset) > max(OFFSET * reach, 5 * np.median(np.abs(np.diff(p)))):
        absolute_command = raw.min() > -offset / 2 and _is_atmosphere(-offset)
        wrong, other = (command, measured) if absolute_command else (measured, command)
        more = abs(offset) if wrong == command or offset > 0 else offset
        absolute = ": absolute?" if _is_atmosphere(more) else ": its zero is off."
        text = (
            f"Column '{wrong}' reads {abs(more):.3g} kPa {'more' if more > 0 else 'less'} than '{other}' at "
            f"rest{absolute} Fits take it {abs(more):.3g} kPa {'lower' if more > 0 else 'higher'}; correct "
            "it in the table."
        )
        found.append(Finding("pressure_offset", text, (wrong,), numbers={"offset_kpa": float(more)}))
        corrected = {wrong: recording.column(wrong) - more}
        recording = replace(recording, samples=recording.samples.assign(**corrected))
    for end in flat:  # commands beyond the supply count as what it delivers
        level = float(recording.column(measured)[end.rows].mean())
        bound = {"upper" if end.far > end.begin else "lower": level}
        delivered = recording.samples[command].astype(float).clip(**bound)
        meta = recording.meta | {SUPPLY: supply_limits(recording) | {command: level}}
        recording = replace(recording, samples=recording.samples.assign(**{command: delivered}), meta=meta)
        text = (
            f"Column '{measured}' stays at {level:.4g} kPa while '{command}' goes on from {end.begin:.4g} to "
            f"{end.far:.4g} kPa, and the {device} stays too: the supply ends there. Commands beyond count as "
            f"{level:.4g} kPa; no program should command more."
        )
        found.append(Finding("supply_limit", text, (command,), np.flatnonzero(end.rows), {"at": level}))
    return recording, found


def _is_atmosphere(kpa: float) -> bool:
    return ATMOSPHERE_KPA[0] < kpa < ATMOSPHERE_KPA[1]


def _other_scale(command: str, u: np.ndarray, slope: float) -> str:
    """What is wrong where a gauge moves so many times as far as its command (n,), kPa."""
    most = next((m for m in (100, 255, 1023, 4095) if 0.6 * m < u.max() <= m), None)
    if slope < 0:
        return "its sign is wrong, or its wires are exchanged"
    if slope < SCALES[0] and most and (u == np.round(u)).all() and u.min() >= 0:
        what = "percent" if most == 100 else "PWM"
        return f"'{command}' holds whole numbers up to {u.max():.0f}: {what} and not kPa?"
    return f"one of them is not in kPa ({'volts' if slope < 1 else 'counts'}?), or its scale is off"


def _lagged(recording: Recording, p: np.ndarray, u: np.ndarray) -> np.ndarray:
    """A command (n,) behind the first-order lag with which its gauge p (n,) agrees best.

    Or ahead by a few rows, as one that was written late.
    """
    parts, dt = [u[rows] for rows in recording.trials().values()], recording.step_s or 1.0
    keeps = [np.exp(-dt / lag) if lag else 0.0 for lag in LAGS_S]
    tried = [[lfilter([1 - k], [1, -k], x, zi=[k * x[0]])[0] for x in parts] for k in keeps]
    for ahead in range(1, MOST_AHEAD + 1):
        tried.append([x[np.minimum(np.arange(len(x)) + ahead, len(x) - 1)] for x in parts])
    best, most = u, -1.0
    for behind in map(np.concatenate, tried):
        spread = float(np.std(behind) * np.std(p))
        agree = float(np.mean((behind - behind.mean()) * (p - p.mean()))) / spread if spread > 1e-12 else 0.0
        if abs(agree) > most + 1e-6:
            best, most = behind, abs(agree)
    return best


# ---------------------------------------------------------------- where a gauge stops


@dataclass(frozen=True)
class _End:
    """An end of a command's range at which the gauge stands still."""

    level: float  # where it stands
    begin: float  # command at which that begins
    far: float  # command at the end
    rows: np.ndarray  # (n,) mask of rows beyond `begin`


def _end(u: np.ndarray, p: np.ndarray, reach: float, sign: int) -> _End | None:
    """The upper end (`sign` 1) or the lower one (-1) of a command (n,) with such a range."""
    u, p = sign * u, sign * p
    edges = np.linspace(u.min(), u.max(), BINS + 1)
    bins = np.clip(np.searchsorted(edges, u, side="right") - 1, 0, BINS - 1)
    used = [i for i in range(BINS) if (bins == i).sum() >= LEAST_ROWS]
    if len(used) < 3:
        return None
    at, level = (np.array([np.median(x[bins == i]) for i in used]) for x in (u, p))
    slope = np.diff(level) / np.maximum(np.diff(at), 1e-9)
    usual = float(np.median(slope[slope > np.median(slope) / 2])) if (slope > 0).any() else 0.0
    flat = int(np.argmin(np.r_[np.abs(slope[::-1]) < FLAT * max(usual, FLAT), False]))
    below = slope[: len(slope) - flat]
    if not flat or not len(below) or np.median(below) < 0.5 * usual or usual < 0.02:
        return None
    stands = float(np.median(p[bins >= used[-flat]]))
    rising = u < at[-flat - 1]
    if rising.sum() < LEAST_ROWS or np.ptp(u[rising]) < 1e-9:
        return None
    a, b = np.polyfit(at[: len(at) - flat], level[: len(at) - flat], 1)
    begin = (stands - b) / a if a > 0.1 * usual else at[-flat - 1]
    begin = float(np.clip(begin, at[-flat - 2] if flat + 2 <= len(at) else at[0], at[-flat]))
    if u.max() - begin < WIDE * reach:
        return None
    return _End(sign * stands, sign * begin, float(sign * u.max()), u > begin)


def _device_goes_on(recording: Recording, u: np.ndarray, beyond: np.ndarray) -> bool | None:
    """Whether the device moves on with the command where its gauge stays; None if unknown."""
    columns = headline(recording)[0]
    if not columns or min(beyond.sum(), (~beyond).sum()) < LEAST_ROWS:
        return None
    y = recording.samples[columns].to_numpy(float)
    far, near = (
        np.linalg.norm(np.polyfit(u[rows], y[rows], 1)[0]) if np.ptp(u[rows]) > 1e-9 else 0.0
        for rows in (beyond, ~beyond)
    )
    ratio = far / max(near, 1e-12)
    return False if ratio < STANDS else True if ratio > FOLLOWS else None


# ---------------------------------------------------------------- whether it follows


def _stuck(
    recording: Recording, u: np.ndarray, p: np.ndarray, reach: float, inside: np.ndarray
) -> np.ndarray:
    """Numbers of the rows in which the gauge stands while its command moves.

    It is looked at in stretches in which the command moves by `PIECE` of its range; a level counts where the
    command stays above, or below it, for `SUSTAINED_S`.
    """
    n = max(LEAST_ROWS, round(SUSTAINED_S / max(recording.step_s or 1.0, 1e-6)))
    pieces, moved = [], []  # row numbers, and how far the gauge moved with the command
    for rows in recording.trials().values():
        at = np.arange(rows.start, rows.stop)[inside[rows]]
        if len(at) < 2 * n:
            continue
        # over the last rows: what the command did not fall below, and did not exceed
        least, most = (f(u[at], n, origin=(n - 1) // 2) for f in (minimum_filter1d, maximum_filter1d))
        start, low, high = 0, np.inf, -np.inf
        for i in range(len(at)):
            if i - start < n - 1:
                continue
            low, high = min(low, most[i]), max(high, least[i])
            if high - low > PIECE * reach:
                piece, near = at[start : i + 1], 0.1 * (high - low)
                top, bottom = (p[piece[x]] for x in (u[piece] > high - near, u[piece] < low + near))
                pieces.append(piece)
                moved.append(abs(np.median(top) - np.median(bottom)) / (high - low))
                start, low, high = i + 1, np.inf, -np.inf
    if not pieces:
        return np.zeros(0, int)
    moved = np.array(moved)
    usual = np.median(moved[moved >= moved.max() / 2])
    return np.concatenate([np.zeros(0, int), *(pieces[i] for i in np.flatnonzero(moved < STUCK * usual))])


def _late(recording: Recording, p: np.ndarray, inside: np.ndarray) -> float:
    """Seconds by which a gauge p (n,) comes after the motion that its pressure makes; 0 where it does not.

    A device moves with its pressure or later, so what a later reading explains better was read late.
    """
    columns, dt = headline(recording)[0], recording.step_s
    most = min(round(2.0 / dt), 200) if dt > 0 else 0
    if not columns or most < 1:  # a slower log shows no such lag
        return 0.0
    y, trials = recording.samples[columns].to_numpy(float), recording.trials().values()
    long = [np.arange(rows.start, rows.stop - most) for rows in trials if rows.stop - rows.start > most + 20]
    rows = np.concatenate([np.zeros(0, int), *long])
    rows = rows[inside[rows]]
    if len(rows) < 50:
        return 0.0
    left = {}
    for k in sorted({0, *np.unique(np.round(np.geomspace(1, most, 16)).astype(int))}):
        design = static_columns(p[rows + k, None] / max(float(np.abs(p).max()), 1e-9))
        left[k] = float(((y[rows] - design @ regress(design, y[rows])) ** 2).sum())
    best = min(left, key=left.__getitem__)
    return best * dt if best * dt >= LATE_S and best >= 2 and left[best] < 0.5 * left[0] else 0.0


def _absolute(recording: Recording, named: set[str]) -> Iterator[Finding]:
    """Commands that never go below the pressure of the surroundings, as absolute ones do."""
    for name in recording.pressure_columns:
        u = recording.column(name).astype(float)
        low = float(u.min())
        rests = np.ptp(u) > 1e-3 and (u < low + 0.02 * np.ptp(u)).mean() > 0.02
        if name not in named and _is_atmosphere(low) and rests:
            text = (
                f"Column '{name}' never falls below {low:.4g} kPa: is it absolute? Then subtract the "
                "pressure of the surroundings, about 101 kPa; all pressures here are above it."
            )
            yield Finding("pressure_offset", text, (name,), numbers={"offset_kpa": low})
