"""Columns whose numbers can only be in another unit than their name says."""

import re
from pathlib import Path

import numpy as np
import pandas as pd

from pneutac_datasets.recording.wording import row_name, shown
from pneutac_sim.errors import InputError

# A soft actuator bursts well below 20 bar, so a larger number is another unit. A tip cannot be much further
# from the base than the device is long; the factor of three leaves room for a rough length_mm.
MAX_PRESSURE_KPA = 2000.0
LONGEST_TIP, SHORTEST_TIP = 3.0, 0.02  # of length_mm
RATIO = 30.0  # between measured and commanded pressure


def check_units(samples: pd.DataFrame, meta: dict, file: Path) -> None:
    """Raises InputError where a column's range can only be another unit than its name says."""
    for rule in RULES:
        rule(samples, meta, file)


def _check_angles(samples: pd.DataFrame, meta: dict, file: Path) -> None:
    for name in _columns(samples, r"bend_angle_rad|q_\d+_rad"):
        value, row = _top(samples, name)
        if value > 4 * np.pi:
            raise _other_unit(samples, file, name, row, "degrees", "multiply the column by pi/180")


def _check_temperature(samples: pd.DataFrame, meta: dict, file: Path) -> None:
    if "temperature_c" in samples:
        value, row = _top(samples, "temperature_c")
        if value > 150:
            raise _other_unit(
                samples, file, "temperature_c", row, "kelvin", "subtract 273.15 from the column"
            )


def _check_pressures(samples: pd.DataFrame, meta: dict, file: Path) -> None:
    pressures = _columns(samples, r"pressure_(cmd_)?(\d+_)?kpa")
    for name in pressures:
        value, row = _top(samples, name)
        if value > MAX_PRESSURE_KPA:
            raise _other_unit(samples, file, name, row, "pascal", "divide the column by 1000")
    for name in pressures:
        command = name.replace("pressure_", "pressure_cmd_")
        if "cmd" in name or command not in samples:
            continue
        (measured, row), (commanded, _) = _top(samples, name), _top(samples, command)
        if min(measured, commanded) > 0 and not 1 / RATIO < measured / commanded < RATIO:
            other = f"another unit than that of '{command}' (up to {commanded:g})"
            raise _other_unit(samples, file, name, row, other, "give both in kPa above the surroundings")


def _check_tip(samples: pd.DataFrame, meta: dict, file: Path) -> None:
    length_mm = meta.get("length_mm")
    tips = _columns(samples, r"tip_[xyz]_mm")
    if not tips:
        return
    reach = np.linalg.norm(samples[tips].to_numpy(float), axis=1)
    row, value = int(reach.argmax()), float(reach.max())
    if 0 < value < (SHORTEST_TIP * length_mm if length_mm else 1.0):
        raise _other_unit(samples, file, tips[0], row, "metres", "multiply the tip columns by 1000", value)
    if length_mm and value > LONGEST_TIP * length_mm:
        other = f"another unit or frame (length_mm is {length_mm:g})"
        remedy = "give the tip in millimetres from the base of the device"
        raise _other_unit(samples, file, tips[0], row, other, remedy, value)


def check_gravity(samples: pd.DataFrame, meta: dict, file: Path) -> None:
    """Raises InputError where gravity has not all three columns, or is no unit vector."""
    gravity = [f"gravity_{a}" for a in "xyz"]
    missing = [c for c in gravity if c not in samples]
    if len(missing) == 3:
        return
    if missing:
        raise InputError(
            f"{file}: column '{missing[0]}' is missing; gravity needs gravity_x, gravity_y, gravity_z."
        )
    norm = np.linalg.norm(samples[gravity].to_numpy(float), axis=1)
    row = int(np.abs(norm - 1).argmax())
    if abs(norm[row] - 1) > 0.05:
        other, remedy = (
            "no unit vector (length of gravity_x, y, z)",
            "divide the three columns by their length",
        )
        raise _other_unit(samples, file, "gravity_x", row, other, remedy, float(norm[row]))


RULES = (_check_pressures, _check_tip, _check_angles, check_gravity, _check_temperature)


def _columns(samples: pd.DataFrame, pattern: str) -> list[str]:
    return [c for c in samples if re.fullmatch(pattern, c)]


def _top(samples: pd.DataFrame, name: str) -> tuple[float, int]:
    """Largest size in a column, and its row."""
    values = np.abs(samples[name].to_numpy(float))
    return float(values.max()), int(values.argmax())


def _other_unit(
    samples: pd.DataFrame,
    file: Path,
    name: str,
    row: int,
    other: str,
    remedy: str,
    value: float | None = None,
) -> InputError:
    value = abs(float(samples[name].iloc[row])) if value is None else value
    where = row_name(int(samples.index[row]), file)
    return InputError(
        f"{file}: column {shown(name)}, {where} is {value:g}, which can only be {other}; {remedy}."
    )
