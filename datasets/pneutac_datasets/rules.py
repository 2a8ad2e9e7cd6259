"""What a bench recording must satisfy: each broken rule is one sentence with file, column, row and remedy."""

import re
from pathlib import Path

import numpy as np
import pandas as pd

from pneutac_sim.errors import InputError
from pneutac_sim.twin import DEVICES

OBSERVATIONS = {
    "finger": r"tip_[xyz]_mm|bend_angle_rad|q_\d+_rad",
    "arm": r"tip_[xyz]_mm|bend_angle_rad|q_\d+_rad|curvature_[xy]_1_per_m",
    "gel": r"image",
}
LABELS = r"program|image(_\w+)?|mask(_\w+)?|role|indenter|depth_source"

# A soft actuator bursts well below 20 bar, so a larger number is another unit. A tip cannot be much further
# from the base than the device is long; the factor of three used below leaves room for a rough length_mm.
MAX_PRESSURE_KPA = 2000.0
MAX_DUPLICATES = 0.01  # share of rows with a doubled stamp that a logger's rounding explains


def device_of(meta: dict, samples: pd.DataFrame, folder: Path) -> str:
    """The recording's device; a LeRobotDataset without recording.json tells it by its columns."""
    device = meta.get("device")
    if device is None and meta.get("lerobot"):
        device = "gel" if "indenter" in samples else "arm" if "pressure_cmd_1_kpa" in samples else "finger"
    if device not in DEVICES:
        raise InputError(
            f"{folder / 'recording.json'}: field 'device' is {device!r}; "
            f"it must be one of {', '.join(DEVICES)}."
        )
    return device


def check_meta(meta: dict, file: Path) -> None:
    """Checks lengths and joint positions of `recording.json`."""
    length = meta.get("length_mm")
    if length is not None:
        if isinstance(length, bool) or not isinstance(length, int | float) or not 0 < length < float("inf"):
            raise InputError(
                f"{file}: field 'length_mm' is {length!r}; give a positive number of millimetres."
            )
        if length < 2:
            raise InputError(
                f"{file}: field 'length_mm' is {length}, which can only be metres; give it in millimetres."
            )
    joints = meta.get("spine_joint_positions_mm")
    if joints is not None:
        ok = isinstance(joints, list) and joints and all(isinstance(x, int | float) for x in joints)
        top = length if length is not None else float("inf")
        if (
            not ok
            or any(b <= a for a, b in zip(joints, joints[1:], strict=False))
            or not (0 <= joints[0] and joints[-1] <= top)
        ):
            raise InputError(
                f"{file}: field 'spine_joint_positions_mm' must be rising numbers between 0 and length_mm."
            )


def check_samples(
    samples: pd.DataFrame, device: str, meta: dict, file: Path
) -> tuple[pd.DataFrame, list[str]]:
    """Applies every rule; returns the samples with clean types and warnings for what is poor but usable."""
    warnings: list[str] = []
    if len(samples) == 0:
        raise InputError(f"{file} has a header but no rows; record at least one trial.")
    _check_columns(samples, device, file)
    samples = _numbers(samples, device, file)
    samples["trial"] = _trials(samples["trial"], file)
    if device != "gel":
        samples = _check_time(samples, file, warnings)
        check_units(samples, meta, file)
        _check_poverty(samples, file, warnings)
    return samples, warnings


def _check_columns(samples: pd.DataFrame, device: str, file: Path) -> None:
    first = "pressure_cmd_1_kpa" if device == "arm" else "pressure_cmd_kpa"
    for name in ["trial", "time_s"] + (["image", "indenter"] if device == "gel" else [first]):
        if name not in samples.columns:
            raise InputError(
                f"{file}: column '{name}' is missing{_near(name, samples)}; a {device} needs it."
            )
    if device != "gel" and not observations(samples, device):
        needed = "tip_x_mm, tip_z_mm, bend_angle_rad or q_1_rad"
        needed += ", or curvature_x_1_per_m" if device == "arm" else ", or image"
        if not [c for c in samples if re.fullmatch(r"image(_\w+)?", c)]:
            raise InputError(
                f"{file}: no column tells what the {device} did{_near('tip_x_mm', samples)}; add {needed}."
            )


def _near(name: str, samples: pd.DataFrame) -> str:
    """Names a column that is the wanted one under another unit, such as `pressure_cmd_pa`."""
    stem = re.sub(r"_(kpa|mm|rad|s|c|g)$", "", name)
    near = [c for c in samples if isinstance(c, str) and re.fullmatch(rf"{re.escape(stem)}(_\w+)?", c, re.I)]
    return f" (there is '{near[0]}': convert it to the unit in the name)" if near else ""


def observations(samples: pd.DataFrame, device: str) -> list[str]:
    """Columns that a model of the device predicts, in the table's order."""
    return [c for c in samples.columns if re.fullmatch(OBSERVATIONS[device], c)]


def _numbers(samples: pd.DataFrame, device: str, file: Path) -> pd.DataFrame:
    samples = samples.copy()
    for name in samples.columns:
        if re.fullmatch(LABELS, name):
            continue
        column = samples[name]
        known = re.search(r"_(kpa|mm|rad|s|c|g|m|px)$|^gravity_|^trial$", name)
        values = pd.to_numeric(column, errors="coerce").astype(float)
        if not known and values.notna().sum() <= 0.5 * len(values):
            continue  # a free label
        bad = ~np.isfinite(values.to_numpy())
        if device == "gel" and name not in ("trial", "time_s"):
            bad &= column.notna().to_numpy()  # an unknown depth or radius stays empty
        if bad.any():
            row = int(np.argmax(bad))
            raise InputError(
                f"{file}: column '{name}', row {row + 1} is {_shown(column.iloc[row])} "
                f"({int(bad.sum())} such rows); delete these rows or fill in finite numbers."
            )
        samples[name] = values
    return samples


def _shown(value) -> str:
    return "empty" if pd.isna(value) else f"'{value}'"


def _trials(trial: pd.Series, file: Path) -> np.ndarray:
    t = trial.to_numpy(float)
    broken = t != np.round(t)
    if broken.any():
        row = int(np.argmax(broken))
        raise InputError(f"{file}: column 'trial', row {row + 1} is {t[row]}; number the trials 0, 1, 2, ...")
    t = t.astype(np.int64)
    starts = np.flatnonzero(np.r_[True, t[1:] != t[:-1]])
    seen: set[int] = set()
    for row in starts:
        if t[row] in seen:
            raise InputError(
                f"{file}: column 'trial', row {row + 1} goes back to trial {t[row]}; "
                "keep the rows of a trial together, or give the second part its own number."
            )
        seen.add(int(t[row]))
    return t


def _check_time(samples: pd.DataFrame, file: Path, warnings: list[str]) -> pd.DataFrame:
    time, trial = samples["time_s"].to_numpy(), samples["trial"].to_numpy()
    step = np.r_[np.inf, np.where(trial[1:] == trial[:-1], np.diff(time), np.inf)]
    if (step < 0).any():
        row = int(np.argmax(step < 0))
        raise InputError(
            f"{file}: column 'time_s', row {row + 1} goes back from {time[row - 1]:g} to {time[row]:g} s in "
            f"trial {trial[row]}; sort the trial by time, or start a new trial where the clock was reset."
        )
    doubled = step == 0
    if doubled.any():
        row, n = int(np.argmax(doubled)), int(doubled.sum())
        where = (
            f"{file}: column 'time_s', row {row + 1} repeats the stamp {time[row]:g} s of trial {trial[row]}"
        )
        if n > MAX_DUPLICATES * len(samples) and n > 1:
            raise InputError(f"{where} ({n} rows do); write time_s with more digits, or delete those rows.")
        warnings.append(f"{where} ({n} rows do); they are left out.")
        samples = samples[~doubled].reset_index(drop=True)
    normal = np.median(step[np.isfinite(step)]) if np.isfinite(step).any() else 0.0
    if normal >= 5 and len(samples) > 100:
        warnings.append(
            f"{file}: column 'time_s' has one sample every {normal:g} s; if the clock counts milliseconds, "
            "divide it by 1000."
        )
    return samples


def check_units(samples: pd.DataFrame, meta: dict, file: Path) -> None:
    """Raises InputError where a column's range can only be another unit than its name says."""

    def top(name: str) -> tuple[float, int]:
        values = np.abs(samples[name].to_numpy(float))
        return float(values.max()), int(values.argmax())

    def refuse(name: str, value: float, row: int, unit: str, remedy: str):
        raise InputError(
            f"{file}: column '{name}', row {row + 1} is {value:g}, which can only be {unit}; {remedy}."
        )

    pressures = [c for c in samples if re.fullmatch(r"pressure_(cmd_)?(\d+_)?kpa", c)]
    for name in pressures:
        value, row = top(name)
        if value > MAX_PRESSURE_KPA:
            refuse(name, value, row, "pascal", "divide the column by 1000")
    for name in pressures:
        command = name.replace("pressure_", "pressure_cmd_")
        if "cmd" in name or command not in samples:
            continue
        (measured, row), (commanded, _) = top(name), top(command)
        if min(measured, commanded) > 0 and not 1 / 30 < measured / commanded < 30:
            refuse(name, measured, row, f"another unit than that of '{command}' (up to {commanded:g})",
                   "give both in kPa above the surroundings")  # fmt: skip
    tips = [c for c in samples if re.fullmatch(r"tip_[xyz]_mm", c)]
    if tips:
        reach = np.sqrt(sum(samples[c].to_numpy(float) ** 2 for c in tips))
        row, value = int(reach.argmax()), float(reach.max())
        length = meta.get("length_mm")
        if 0 < value < (0.02 * length if length else 1.0):
            refuse(tips[0], value, row, "metres", "multiply the tip columns by 1000")
        if length and value > 3 * length:
            refuse(tips[0], value, row, f"another unit or frame (length_mm is {length:g})",
                   "give the tip in millimetres from the base of the device")  # fmt: skip
    for name in [c for c in samples if re.fullmatch(r"bend_angle_rad|q_\d+_rad", c)]:
        value, row = top(name)
        if value > 4 * np.pi:
            refuse(name, value, row, "degrees", "multiply the column by pi/180")
    gravity = [f"gravity_{a}" for a in "xyz"]
    if all(c in samples for c in gravity):
        norm = np.linalg.norm(samples[gravity].to_numpy(float), axis=1)
        row = int(np.abs(norm - 1).argmax())
        if abs(norm[row] - 1) > 0.05:
            refuse("gravity_x", float(norm[row]), row, "no unit vector (length of gravity_x, y, z)",
                   "divide the three columns by their length")  # fmt: skip
    elif any(c in samples for c in gravity):
        missing = next(c for c in gravity if c not in samples)
        raise InputError(
            f"{file}: column '{missing}' is missing; gravity needs gravity_x, gravity_y, gravity_z."
        )
    if "temperature_c" in samples:
        value, row = top("temperature_c")
        if value > 150:
            refuse("temperature_c", value, row, "kelvin", "subtract 273.15 from the column")


def _check_poverty(samples: pd.DataFrame, file: Path, warnings: list[str]) -> None:
    """Notes what is too poor to decide much from; such a recording still loads."""
    pressures = [c for c in samples if re.fullmatch(r"pressure_cmd_(\d+_)?kpa", c)]
    if all(np.ptp(samples[c].to_numpy()) < 1e-3 for c in pressures):
        warnings.append(
            f"{file}: column '{pressures[0]}' is constant at {samples[pressures[0]].iloc[0]:g} kPa in every "
            "row; nothing can be learned about the answer to pressure, so record steps or ramps."
        )
    if samples["trial"].nunique() == 1:
        warnings.append(
            f"{file}: column 'trial' has one trial only, so no run is repeated under equal conditions; "
            "record the same program twice to know the noise."
        )
    if len(samples) < 50:
        warnings.append(f"{file} has only {len(samples)} rows, too few to tell effects apart; record longer.")
