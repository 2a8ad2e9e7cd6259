"""What a bench recording must satisfy: each broken rule is one sentence with file, column, row and remedy.

How each trial began, if `recording.json` states it: memory (creep, hysteresis) depends on it.
"""

import difflib
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from pneutac_datasets.recording.units import base_unit, unit_faults, unit_named
from pneutac_datasets.recording.wording import an, collected, listed, plural, row_name
from pneutac_sim.errors import CONTROL, InputError, shown
from pneutac_sim.finger import quantities
from pneutac_sim.twin import DEVICES

STARTS = ("rested", "continues", "unknown")
DAY_S = 86400.0
SLOWEST_S = 3600.0  # between samples; no motion is seen in slower ones
FASTEST_S = 0.00099  # between samples; no tracker is faster
TOO_FAST_S = 5e-5  # between samples: 20 Hz in days, and in hours, are faster than any logger
HUGE = 1e6  # times what 95 % of a column's numbers are at most: a typing error
MAX_DUPLICATES = 0.01  # share of rows with a doubled stamp that a logger's rounding explains
ROUNDED_S = 1e-3  # by which stamps of two columns may disagree
# What is read of a `recording.json` and of a camera in it; a lab's own further fields are left alone.
CAMERA = ("intrinsics", "extrinsics", "distortion", "background")
FIELDS = (
    *("device", "length_mm", "spine_joint_positions_mm", "samples", "cameras", "noise", "trials", "obstacle"),
    *("notes", "rest_image", "px_per_mm", "gel_size_mm", "date", "source", "length_proposed", "conversion"),
)
EXAMPLE = '{"3": {"start": "continues", "pause_s": 12}}'


@dataclass(frozen=True)
class TrialStart:
    """In what state the device was when a trial began."""

    # `rested`: lay without pressure until its memory had faded; `continues`: goes on from the trial before it
    # in the table; `unknown`
    start: str = "unknown"
    # time without pressure since the last row of the trial before, s; None where it is not known
    pause_s: float | None = None


def meta_of_trials(meta: dict, before: list[int], left: list[int]) -> dict:
    """The fields for a table of fewer trials; one that continued a trial which is gone starts unknown."""
    if "trials" not in meta:
        return meta
    previous = dict(zip(before[1:], before, strict=False))
    now = dict(zip(left[1:], left, strict=False))
    stated = {}
    for trial in left:
        how = meta["trials"].get(str(trial))
        if how is not None:
            torn = how["start"] == "continues" and now.get(trial) != previous.get(trial)
            stated[str(trial)] = {"start": "unknown"} if torn else how
    return meta | {"trials": stated}


COARSE = "write time_s with more digits, or delete those rows"
LEAST_USUAL_KPA, LARGE_MOTION_MM = 3.0, 10.0  # no finger of rubber bends so far by so little
LABELS = r"program|image(_\w+)?|mask(_\w+)?|role|indenter|indenter_file|outline_mm|depth_source"
OWN = re.compile(
    r"trial|time_s|time_sent_s|pressure_(cmd_)?(\d+_)?kpa|tip_[xyz]_mm|bend_angle_rad|q_\d+_rad|temperature_c"
    rf"|curvature_[xy]_1_per_m|gravity_[xyz]|payload_g|force_[xyz]_n|base_[xyz]_mm|{LABELS}"
)
# Columns of a recording, by which a misspelt one is known.
TARGETS = (
    "time_s time_sent_s trial program pressure_cmd_kpa pressure_kpa tip_x_mm tip_y_mm tip_z_mm bend_angle_rad"
    " temperature_c payload_g gravity_x gravity_y gravity_z force_x_n force_y_n force_z_n"
).split()


def device_of(meta: dict, samples: pd.DataFrame, folder: Path) -> str:
    """The recording's device; that of a LeRobotDataset without recording.json follows from its columns."""
    device = meta.get("device")
    if device is None and meta.get("lerobot"):
        device = "gel" if "indenter" in samples else "arm" if "pressure_cmd_1_kpa" in samples else "finger"
    if device not in DEVICES:
        fault = "is missing" if device is None else f"is {shown(device)}"
        field = f"{folder / 'recording.json'}: field 'device'"
        raise InputError(f"{field} {fault}; it must be one of {', '.join(DEVICES)}.")
    return device


def meta_faults(meta: dict, file: Path) -> Iterator[str]:
    """What is wrong in `recording.json`: misspelt names, lengths, joints, noise, cameras, trials."""
    cameras = meta.get("cameras", {})
    named = isinstance(cameras, dict)
    described = [(n, c) for n, c in cameras.items() if isinstance(c, dict)] if named else []
    groups = [("", meta, FIELDS), *((f"camera {shown(n)}: ", c, CAMERA) for n, c in described)]
    for where, given, known in groups:
        for name in (str(n) for n in given if n not in known):
            close = difflib.get_close_matches(name, [f for f in known if f not in given], n=1, cutoff=0.8)
            if close:
                yield f"{file}: {where}unknown field {shown(name)}; did you mean '{close[0]}'?"
    length, joints, noise = (meta.get(k) for k in ("length_mm", "spine_joint_positions_mm", "noise"))
    if length is not None and not _positive(length):
        yield f"{file}: field 'length_mm' is {shown(length)}; give a positive number of millimetres."
    elif length is not None and length < 2:
        yield f"{file}: field 'length_mm' is {length}, which can only be metres; give it in millimetres."
    if joints is not None:
        ok = isinstance(joints, list) and joints and all(isinstance(x, int | float) for x in joints)
        top = length if _positive(length) else float("inf")
        if not ok or (np.diff(joints) <= 0).any() or not (0 <= joints[0] and joints[-1] <= top):
            yield f"{file}: field 'spine_joint_positions_mm' must be rising numbers between 0 and length_mm."
    wrong = "" if isinstance(noise, dict | None) else f" is {shown(noise)}"
    for name, x in noise.items() if isinstance(noise, dict) else ():
        wrong = wrong or ("" if _positive(x) else f" of {shown(name)} is {shown(x)}")
    if wrong:
        deviation = 'standard deviation, a positive number, such as {"tip_x_mm": 0.2}'
        yield f"{file}: field 'noise'{wrong}; give each measured column its {deviation}."
    if not named or not all(isinstance(c, dict) for c in cameras.values()):
        yield (
            f"{file}: field 'cameras' is {shown(cameras)}; name each camera and what it is, as in "
            '{"front": {"intrinsics": 3x3 in px, "extrinsics": 4x4 from base to camera in m}}.'
        )
    conversion = meta.get("conversion", {})
    if not isinstance(conversion, dict) or not isinstance(conversion.get("notes", []), list):
        yield f"{file}: field 'conversion' is {shown(conversion)}; convert the table again."
    stated = meta.get("trials")
    if not isinstance(stated, dict | None):
        yield f"{file}: field 'trials' is {shown(stated)}; name trials by number, as in {EXAMPLE}."
    for number, how in stated.items() if isinstance(stated, dict) else ():
        where = f"{file}: field 'trials' of trial {shown(number)}"
        if not isinstance(how, dict) or "start" not in how or set(how) - {"start", "pause_s"}:
            yield f"{where} is {shown(how)}; give 'start' and perhaps 'pause_s', as in {EXAMPLE}."
            continue
        start, pause = how["start"], how.get("pause_s")
        if start not in STARTS:
            yield f"{where}: 'start' is {shown(start)}; it must be one of {', '.join(STARTS)}."
        elif pause is None:
            continue
        elif isinstance(pause, bool) or not isinstance(pause, int | float) or not 0 <= pause < 1e12:
            yield f"{where}: 'pause_s' is {shown(pause)}; give seconds, 0 or more."
        elif start == "rested":
            yield (
                f"{where}: 'pause_s' is {pause:g} though its start is 'rested', however long that took; "
                "leave it out, or write 'continues' where the rest was too short to forget the trial before."
            )


def _positive(x) -> bool:
    return not isinstance(x, bool) and isinstance(x, int | float) and 0 < x < 1e12


def _stated_faults(samples: pd.DataFrame, device: str, meta: dict, file: Path) -> Iterator[str]:
    """Where fields `noise` and `trials` do not fit the columns and the trials of the table."""
    noise, starts, seen = meta.get("noise") or {}, meta.get("trials") or {}, observations(samples, device)
    source, trials = file.parent / "recording.json", [int(t) for t in samples["trial"].unique()]
    for name in noise:
        if name not in seen and not (name in samples and re.fullmatch(quantities.PRESSURE.pattern, name)):
            what = f"names {shown(name)}, which is not measured in {file.name}"
            yield f"{source}: field 'noise' {what}; name {listed(seen)}."
    missing = [c for c in quantities.headline(seen, device)[0] if noise and c not in noise]
    if missing:
        yield (
            f"{source}: field 'noise' does not name '{missing[0]}', which the error counts too; "
            "add it, or leave out the field so that the noise is estimated."
        )
    for number in starts:
        if number not in map(str, trials):
            what = f"names trial {shown(number)}, which is not in the table"
            yield f"{source}: field 'trials' {what}; its trials are {listed(trials)}."
    if starts.get(str(trials[0]), {}).get("start") == "continues":
        yield (
            f"{source}: field 'trials' lets trial {trials[0]} continue, but it is the first of the table; "
            "write 'rested' or 'unknown'."
        )


def check_samples(
    samples: pd.DataFrame, device: str, meta: dict, file: Path
) -> tuple[pd.DataFrame, list[str]]:
    """Applies every rule; returns the samples with clean types and warnings for what is poor but usable."""
    if missing := missing_columns(samples, device, file) if len(samples) else {}:
        (_, first), *others = missing.items()
        also = f" Missing too: {listed(repr(name) for name, _ in others)}." if others else ""
        raise InputError(first + also)
    samples, faults, warnings = look(samples, device, meta, file)
    if faults:
        raise InputError(faults[0])
    return samples, warnings


def look(
    samples: pd.DataFrame, device: str, meta: dict, file: Path
) -> tuple[pd.DataFrame, list[str], list[str]]:
    """Every rule by itself: one that is broken does not hide the next.

    Returns:
        The samples with clean types, without the columns that are no numbers; a sentence for each fault, and
        one for each thing that is poor but usable.
    """
    if not len(samples):
        missing = [f"{file} has a header but no rows; record at least one trial."]
        return samples, [*missing, *missing_columns(samples, device, file).values()], []
    faults, warnings = list(missing_columns(samples, device, file).values()), []
    misspelt = [] if faults else list(_misspelt(samples, device, file))
    (faults if device == "gel" else warnings).extend(misspelt)
    with collected(faults):
        _check_texts(samples, file)
    samples, broken = clean_numbers(samples, device, file)
    for (_, sentence), *others in broken:
        faults.append(sentence + (f" So are {listed(repr(n) for n, _ in others)}." if others else ""))
    if "trial" in samples:
        with collected(faults):
            samples["trial"] = clean_trials(samples["trial"], file)
    if device == "gel":
        return samples, faults, warnings
    if not faults:
        faults += _stated_faults(samples, device, meta, file)
    if {"trial", "time_s"} <= set(samples) and samples["trial"].dtype == np.int64:
        with collected(faults):
            samples = check_time(samples, file, warnings)
        with collected(faults):
            check_sent(samples, file)
    lost = any(name.startswith("gravity_") for cases in broken for name, _ in cases)
    whole = [c for c in samples if not (lost and c.startswith("gravity_"))]
    faults += unit_faults(samples[whole], meta, file)
    if not faults:
        _check_poverty(samples, file, warnings)
    return samples, faults, warnings


_HOW = {
    "trial": "number the runs in it, a new number wherever the recording was started again",
    "time_s": "add the time of each row since the start of its trial, in seconds",
    "image": "add the file name of each row's picture, relative to the folder",
    "indenter": "add what was pressed into the gel in each row, such as sphere",
    "pressure_cmd_kpa": "add the commanded pressure above the surroundings, in kPa",
    "pressure_cmd_1_kpa": "add the commanded pressures, pressure_cmd_1_kpa and so on, one column a chamber",
}


# What a spreadsheet would compute or a terminal would obey, were a text shown there.
_NOT_A_TEXT = re.compile(rf"^\s*[=+@]|^\s*-[^\d.]|[\t\r\n]|{CONTROL.pattern}")


def _check_texts(samples: pd.DataFrame, file: Path) -> None:
    """Raises InputError where a text or a column's name is a formula or holds control characters."""
    for name in samples.columns:
        if _NOT_A_TEXT.search(str(name)):
            raise InputError(f"{file}: column {shown(str(name))} begins or reads as a formula; rename it.")
        if pd.api.types.is_numeric_dtype(samples[name]):
            continue
        for text in {t for t in samples[name] if isinstance(t, str)}:
            if _NOT_A_TEXT.search(text):
                row = int((samples[name] == text).to_numpy().argmax())
                raise InputError(
                    f"{file}: {shown(name)} of {row_name(row, file)} is {shown(text)}, which a spreadsheet or"
                    " terminal would run; write plain text."
                )


def missing_columns(samples: pd.DataFrame, device: str, file: Path) -> dict[str, str]:
    """Every column that a recording of this device needs and lacks, with a sentence on what to do."""
    first = "pressure_cmd_1_kpa" if device == "arm" else "pressure_cmd_kpa"
    needed_names = ["trial", "time_s"] + (["image", "indenter"] if device == "gel" else [first])
    missing = {
        name: f"{file}: column '{name}' is missing{_near(name, samples)}; {_HOW[name]} (a recording of "
        f"{an(device)} needs it)."
        for name in needed_names
        if name not in samples.columns
    }
    if device != "gel" and not observations(samples, device):
        needed = "tip_x_mm, tip_z_mm, bend_angle_rad or q_1_rad"
        needed += ", or curvature_x_1_per_m" if device == "arm" else ""
        if not [c for c in samples if re.fullmatch(r"image(_\w+)?", c)]:
            missing["tip_z_mm"] = (
                f"{file}: no column has the motion of the {device}{_near('tip_x_mm', samples)}; add {needed}."
            )
    return missing


_OF_GEL = "role x_mm y_mm depth_mm indenter_radius_mm indenter_size_mm contact_radius_px hold_s rest_image"


def _misspelt(samples: pd.DataFrame, device: str, file: Path) -> Iterator[str]:
    """A sentence for each column that nothing reads, and whose name is nearly that of one that is missing."""
    free = [name for name in TARGETS if "_cmd_" not in name]  # an arm's commands are several
    known = ["trial", "time_s", *_OF_GEL.split()] if device == "gel" else free
    missing = [name for name in known if name not in samples]
    for name in (c for c in map(str, samples) if c not in known and not OWN.fullmatch(c)):
        quantity, _, written = name.rpartition("_")
        same = next((m for m in missing if m.rpartition("_")[0] == quantity and base_unit(m)), "")
        own = base_unit(same)
        if unit := own and unit_named(written, own.dimension):
            shift = f", add {unit.shift:.6g}" * bool(unit.shift)
            how = f"multiply it by {unit.factor:.6g}{shift} and call it '{same}'"
            yield f"{file}: column {shown(name)} is not read; {how}."
        elif near := difflib.get_close_matches(name, missing, n=1, cutoff=0.9):
            yield f"{file}: column {shown(name)} is not read; did you mean '{near[0]}'?"


def _near(name: str, samples: pd.DataFrame) -> str:
    """Names a column that is the wanted one under another unit, such as `pressure_cmd_pa`, or misspelt."""
    stem = re.sub(r"_(kpa|mm|rad|s|c|g)$", "", name)
    # What is a column of its own, as the measured pressure is, stands for no other.
    others = [c for c in samples if isinstance(c, str) and not OWN.fullmatch(c)]
    same = [c for c in others if c.strip().lower() == name]
    if same:
        return f" (there is {shown(same[0])}: rename it)"
    near = [c for c in others if re.fullmatch(rf"{re.escape(stem)}(_\w+)?", c, re.I)]
    if near:
        return f" (there is {shown(near[0])}: convert it to the unit in the name)"
    close = difflib.get_close_matches(name, others, n=1, cutoff=0.8)
    return f" (there is {shown(close[0])}: rename it, if that is meant)" if close else ""


def observations(samples: pd.DataFrame, device: str) -> list[str]:
    """Columns that a model of the device predicts, in the table's order."""
    if device == "gel":
        return [c for c in samples.columns if c == "image"]
    return quantities.observations(samples.columns, device)


def pressure_commands(samples: pd.DataFrame) -> list[str]:
    """Columns of commanded pressures, one a chamber."""
    return [c for c in samples if re.fullmatch(r"pressure_cmd_(\d+_)?kpa", str(c))]


def clean_numbers(
    samples: pd.DataFrame, device: str, file: Path
) -> tuple[pd.DataFrame, list[list[tuple[str, str]]]]:
    """The samples with every column but labels as float64, without those that are none.

    Of the latter also name and sentence, in one list where they lack the same row.
    """
    good, broken = {}, {}
    for name in samples.columns:
        good[name] = column = samples[name]
        if re.fullmatch(LABELS, name):
            continue
        known = re.search(r"_(kpa|mm|rad|s|c|g|m|px)$|^gravity_|^trial$", name)
        values = pd.to_numeric(column, errors="coerce").astype(float)
        if not known and values.notna().sum() <= 0.5 * len(values):
            continue  # a free label
        size = np.abs(values.to_numpy())
        usual = np.quantile(size[np.isfinite(size)], 0.95) if np.isfinite(size).any() else 0.0
        good[name], bad = values, ~(size <= HUGE * max(usual, 1.0))
        if device == "gel" and name not in ("trial", "time_s"):
            bad &= column.notna().to_numpy()  # an unknown depth or radius stays empty
        if bad.any():
            row, many = int(np.argmax(bad)), bad.sum() > 1
            value = "empty or not a number" if pd.isna(column.iloc[row]) else shown(str(column.iloc[row]))
            remedy = (
                f"correct {'them' if many else 'it'}, or leave out {'those rows' if many else 'that row'}"
            )
            if bad.mean() > 0.05:
                filled = column[bad].notna().all()
                remedy = "write numbers into this column" if filled else "fill in what was measured"
            such = f"({plural(int(bad.sum()), 'such row')})"
            sentence = f"{file}: column {shown(name)}, {row_name(row, file)} is {value} {such}; {remedy}."
            broken.setdefault(row, []).append((name, sentence))
            del good[name]
    return pd.DataFrame(good, samples.index), list(broken.values())


def clean_trials(trial: pd.Series, file: Path) -> np.ndarray:
    """Numbers of the trials (n,); raises InputError where they are not whole, or one comes twice."""
    t, column = trial.to_numpy(float), f"{file}: column 'trial'"
    broken = (t != np.round(t)) | (np.abs(t) > 2**53)  # beyond that a float skips whole numbers
    if broken.any():
        row = int(np.argmax(broken))
        raise InputError(f"{column}, {row_name(row, file)} is {t[row]}; number the trials 0, 1, 2, ...")
    t = t.astype(np.int64)
    begins = np.flatnonzero(np.r_[True, t[1:] != t[:-1]])
    again = pd.Series(t[begins]).duplicated()
    if again.any():
        row = int(begins[again.argmax()])
        raise InputError(
            f"{column}, {row_name(row, file)} goes back to trial {t[row]}; keep the rows of a trial together,"
            " or give the second part its own number."
        )
    return t


def _check_poverty(samples: pd.DataFrame, file: Path, warnings: list[str]) -> None:
    """Notes what is too poor to decide much from; such a recording still loads."""
    tips = [c for c in samples if re.fullmatch(r"tip_[xyz]_mm", c)]
    if tips and "tip_z_mm" not in tips:
        warnings.append(
            f"{file}: column 'tip_z_mm' is missing, so z, in which the device bends, was not measured; the "
            f"error counts {' and '.join(tips)} alone."
        )
    pressures = pressure_commands(samples)
    if all(np.ptp(samples[c].to_numpy()) < 1e-3 for c in pressures):
        warnings.append(
            f"{file}: column '{pressures[0]}' is constant at {samples[pressures[0]].iloc[0]:g} kPa in every "
            "row; nothing can be learned about the answer to pressure, so record steps or ramps."
        )
    top = max((float(np.abs(samples[c]).max()) for c in pressures), default=0.0)
    moved = float(np.linalg.norm([np.ptp(samples[c].to_numpy(float)) for c in tips])) if tips else 0.0
    if 0 < top <= LEAST_USUAL_KPA and moved > LARGE_MOTION_MM:
        warnings.append(
            f"{file}: column '{pressures[0]}' goes up to {top:.3g} kPa and the tip moves {moved:.3g} mm; if"
            " that is bar, multiply the pressures by 100, if MPa by 1000, if psi by 6.895."
        )
    if samples["trial"].nunique() == 1:
        warnings.append(
            f"{file}: column 'trial' has one trial only, so no run is repeated under equal conditions; "
            "record the same program twice to know the noise."
        )
    if len(samples) < 50 and not any(c.startswith("image") for c in samples):  # six photographs are enough
        warnings.append(
            f"{file} has only {plural(len(samples), 'row')}, too few to distinguish effects; record longer."
        )


def check_time(samples: pd.DataFrame, file: Path, warnings: list[str]) -> pd.DataFrame:
    """The samples without doubled stamps; a clock that goes back or counts milliseconds is refused."""
    time, trial = samples["time_s"].to_numpy(), samples["trial"].to_numpy()
    step = np.r_[np.inf, np.where(trial[1:] == trial[:-1], np.diff(time), np.inf)]
    if (step < 0).any():
        row = int(np.argmax(step < 0))
        fault = f"goes back from {time[row - 1]:g} to {time[row]:g} s in trial {trial[row]}; "
        fault += "sort the trial by time, or start a new trial where the clock was reset"
        near = np.arange(row - 2, row + 2)
        if near[0] >= 0 and near[-1] < len(time) and np.ptp(trial[near]) == 0 == (step < 0).sum() - 1:
            for odd in (row - 1, row):
                if (np.diff(time[near[near != odd]]) > 0).all():
                    row, fault = odd, f"is {time[odd]:g} s, out of order; correct it, or leave out that row"
                    break
        raise InputError(f"{file}: column 'time_s', {row_name(row, file)} {fault}.")
    doubled = step == 0
    if doubled.any():
        row, n = int(np.argmax(doubled)), int(doubled.sum())
        where = (
            f"{file}: column 'time_s', {row_name(row, file)} repeats the stamp {time[row]:g} s of trial "
            f"{trial[row]} ({plural(n, 'such row')})"
        )
        if n > MAX_DUPLICATES * len(samples) and n > 1:
            raise InputError(f"{where}; {COARSE}.")
        warnings.append(f"{where}; {'it is' if n == 1 else 'they are'} left out.")
        samples = samples[~doubled]
    normal = np.median(step[np.isfinite(step)]) if np.isfinite(step).any() else 0.0
    every = f"{file}: column 'time_s' has one sample every {normal:g} s"
    if 5 <= normal <= 1000 and _in_milliseconds(samples):
        days = f"{recorded_s(samples) / DAY_S:.1f} days while the pressure ramps from row to row"
        raise InputError(f"{every} for {days}, which can only be milliseconds; divide it by 1000.")
    if normal > SLOWEST_S or 0 < normal < TOO_FAST_S:
        remedy = "divide it by 1e6 if the clock counts microseconds, by 1e9 if nanoseconds"
        if normal < TOO_FAST_S:
            remedy = "multiply it by 86400 if the clock counts days, by 3600 if hours"
        raise InputError(f"{every}, which can only be another unit than seconds; {remedy}.")
    if normal >= 5 and len(samples) > 100:
        warnings.append(f"{every}; if the clock counts milliseconds, divide it by 1000.")
    if 0 < normal < FASTEST_S:
        rate = f"{1 / normal:.0f} samples a second, {recorded_s(samples):.3g} s in all"
        remedy = "if the clock counts seconds and not milliseconds, multiply it by 1000"
        warnings.append(f"{file}: column 'time_s' has {rate}; {remedy}.")
    return samples


def check_sent(samples: pd.DataFrame, file: Path) -> None:
    """Raises InputError where `time_sent_s` cannot be when the commands of the rows were sent.

    A command stands in the first row that knows of it: a logger that commands and then measures sends it
    between the stamps of the row before and of its own, one that measures and then commands before the stamp
    of the next row. A row that repeats the stamp of the row before repeats its command, which still stands.
    """
    if "time_sent_s" not in samples:
        return
    sent, time = (samples[c].to_numpy(float) for c in ("time_sent_s", "time_s"))
    trial = samples["trial"].to_numpy()
    command = samples[pressure_commands(samples)].to_numpy(float)
    follows = np.r_[False, trial[1:] == trial[:-1]]
    step = np.r_[0.0, np.diff(sent)]
    before = np.where(follows, np.r_[-np.inf, time[:-1]], -np.inf)
    after = np.where(np.r_[follows[1:], False], np.r_[time[1:], np.inf], np.inf)
    new = ~follows | (step != 0)
    changed = np.r_[False, (np.diff(command, axis=0) != 0).any(1)]
    backwards, other = follows & (step < 0), follows & ~new & changed
    late, early = sent > after + ROUNDED_S, new & (sent < before - ROUNDED_S)
    wrong = backwards | other | late | early
    if not wrong.any():
        return
    i, clock = int(np.argmax(wrong)), "give it on the clock of time_s"
    if backwards[i]:
        fault = f"goes back from {sent[i - 1]:g} to {sent[i]:g} s; sort the rows"
    elif other[i]:
        fault = f"is {sent[i]:g} s as in the row before, though the command is another; give each command its"
        fault += " own time"
    elif late[i]:
        fault = f"is {sent[i]:g} s, later than the time {after[i]:g} s of the next row; {clock}"
    else:
        fault = f"is {sent[i]:g} s, earlier than the time {before[i]:g} s of the row before; {clock}, and"
        fault += " repeat it exactly where no new command was sent"
    row = row_name(int(samples.index[i]), file)
    raise InputError(f"{file}: column 'time_sent_s', {row} (trial {trial[i]}) {fault}.")


def recorded_s(samples: pd.DataFrame) -> float:
    """Total recorded time, s."""
    time = samples.groupby("trial")["time_s"]
    return float((time.max() - time.min()).sum())


def _in_milliseconds(samples: pd.DataFrame) -> bool:
    """Whether a clock with steps of 5 to 1000 certainly counts milliseconds.

    Its stamps are whole numbers, make more than a day, and the commanded pressure follows ramps. A recording
    that is truly so slow holds its pressures (creep) or jumps between them from row to row (fatigue).
    """
    time = samples["time_s"].to_numpy()
    if recorded_s(samples) < DAY_S or (np.abs(time - np.round(time)) > 1e-3).any():
        return False
    p = samples[pressure_commands(samples)].to_numpy(float)
    move = np.abs(np.diff(p, axis=0)).max(1) / max(float(np.ptp(p)), 1e-9)
    moving = move > 1e-4
    return bool(moving.mean() > 0.1 and np.median(move[moving]) < 0.1)
