"""Units by name, and columns whose numbers can only be in another unit than their name says."""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from pneutac_datasets.recording.wording import plural, row_name
from pneutac_sim.errors import shown
from pneutac_sim.twin import MOST_LENGTH_MM

# A soft actuator bursts well below 20 bar, so a larger number is another unit. A tip cannot be much further
# from the base than the device is long; the factor of three leaves room for a rough length_mm.
MAX_PRESSURE_KPA = 2000.0
LONGEST_TIP, SHORTEST_TIP = 3.0, 0.02  # of length_mm
SAME_LENGTH = 0.12  # of length_mm, within which the resting tip in another unit identifies that unit
FEW = 0.05  # share of the rows that are not zero: another unit would show in more
RATIO = 30.0  # between measured and commanded pressure


# One of a unit in the unit of a recording's columns: kPa, mm, s, rad, g, N, degrees Celsius.
UNITS = {
    "pressure": {
        "kpa": 1.0, "bar": 100.0, "mbar": 0.1, "hpa": 0.1, "pa": 1e-3, "mpa": 1000.0, "psi": 6.894757,
        "mmhg": 0.1333224, "torr": 0.1333224, "atm": 101.325, "cmh2o": 0.0980665, "inh2o": 0.2490889,
        "kgf/cm2": 98.0665, "kg/cm2": 98.0665, "kilopascal": 1.0, "pascal": 1e-3, "millibar": 0.1,
    },
    "length": {
        "mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4, "inch": 25.4, "inches": 25.4, "um": 1e-3,
        "meter": 1000.0, "ft": 304.8, "feet": 304.8,
        "metre": 1000.0, "meters": 1000.0, "metres": 1000.0, "millimeter": 1.0, "millimetre": 1.0,
        "zoll": 25.4, "dm": 100.0, "millimeters": 1.0, "centimeter": 10.0, "centimeters": 10.0,
    },
    "time": {
        "s": 1.0, "sec": 1.0, "secs": 1.0, "second": 1.0, "seconds": 1.0,
        "sek": 1.0, "sekunden": 1.0, "ms": 1e-3, "msec": 1e-3, "us": 1e-6,
        "day": 86400.0, "days": 86400.0, "tage": 86400.0,
        "ns": 1e-9, "min": 60.0, "minutes": 60.0, "minuten": 60.0, "h": 3600.0, "milliseconds": 1e-3,
        "millisekunden": 1e-3, "frames": 1.0,
    },
    "angle": {
        "rad": 1.0, "mrad": 1e-3, "deg": np.pi / 180, "degree": np.pi / 180, "degrees": np.pi / 180,
        "°": np.pi / 180, "grad": np.pi / 180, "radian": 1.0, "radians": 1.0, "radiant": 1.0,
    },
    "mass": {
        "g": 1.0, "kg": 1000.0, "mg": 1e-3, "gram": 1.0, "grams": 1.0, "gramm": 1.0,
        "lb": 453.59237, "lbs": 453.59237, "oz": 28.349523,
    },
    "temperature": {
        "°c": 1.0, "c": 1.0, "degc": 1.0, "celsius": 1.0, "k": 1.0, "kelvin": 1.0, "°f": 5 / 9, "f": 5 / 9,
        "degf": 5 / 9, "fahrenheit": 5 / 9, "°k": 1.0, "grad c": 1.0, "deg c": 1.0, "deg f": 5 / 9,
    },
    "force": {
        "n": 1.0, "mn": 1e-3, "kn": 1000.0, "newton": 1.0,
        "lbf": 4.4482216, "kgf": 9.80665, "gf": 9.80665e-3,
    },
    "acceleration": {"m/s2": 1 / 9.80665, "m/s/s": 1 / 9.80665, "ms-2": 1 / 9.80665},
    "voltage": dict.fromkeys(
        ("v", "mv", "volt", "ma", "counts", "adc", "digits", "pwm", "%", "percent"), 1.0
    ),
    "none": {"1": 1.0, "#": 1.0, "text": 1.0, "string": 1.0, "iso": 1.0},
}  # fmt: skip
SHIFTS = {"k": -273.15, "°k": -273.15, "kelvin": -273.15}  # of temperatures, °C
SHIFTS |= dict.fromkeys(("°f", "f", "degf", "deg f", "fahrenheit"), -160 / 9)
ABSOLUTE = re.compile(r"[\s_(]*(abs(olute?)?|absolut)[\s)]*$|(?<=bar|psi|kpa|hpa)\(?a\)?$")
GAUGE = re.compile(r"[\s_(]*(gauge|rel(ative?)?|relativ|ü|ue)[\s)]*$|(?<=bar|psi|kpa|hpa)\(?g\)?$")


@dataclass(frozen=True)
class Unit:
    """A unit of a measurement: `name` as in `UNITS`, and what a pressure is against."""

    dimension: str
    name: str
    against: str = ""  # `abs`, `gauge` or nothing

    @property
    def factor(self) -> float:
        """One of it in the unit of a recording's columns."""
        return UNITS[self.dimension][self.name]

    @property
    def shift(self) -> float:
        """Offset that is added after the factor."""
        return SHIFTS.get(self.name, 0.0) if self.dimension == "temperature" else 0.0

    @property
    def scale(self) -> tuple[str, float, float]:
        """What two names of one unit share."""
        return self.dimension, self.factor, self.shift

    def __str__(self):
        return f"{self.name} {self.against}".strip()


def unit_named(text: str, dimension: str = "") -> Unit | None:
    """The unit that a text names, such as `kPa`, `bar (abs)`, `m/s²`; None where it is none.

    The dimension says which is meant where a name stands for several (`m`, `c`, `g`).
    """
    plain = " ".join(text.strip().lower().replace("µ", "u").replace("μ", "u").split())
    plain = plain.replace("²", "2").replace("^", "").replace("º", "°").replace("**", "").strip("[](){} ")
    against = ""
    for pattern, name in ((ABSOLUTE, "abs"), (GAUGE, "gauge")):
        if pattern.search(plain) and pattern.sub("", plain) in UNITS["pressure"]:
            plain, against = pattern.sub("", plain), name
    for known in (dimension,) if dimension else UNITS:
        if plain in UNITS[known] and (not against or known == "pressure"):
            return Unit(known, plain, against)
    return None


# Of a recording's columns, by the last part of their names.
BASE_UNIT = {"pressure": "kPa", "length": "mm", "angle": "rad", "time": "s", "temperature": "C", "mass": "g"}
BASE_UNIT |= {"force": "N"}
ENDINGS = {unit.lower(): dimension for dimension, unit in BASE_UNIT.items()}


def base_unit(column: str) -> Unit | None:
    """The unit in the name of a recording's column, such as that of `tip_x_mm`; None where there is none."""
    rest, _, ending = column.rpartition("_")
    return Unit(ENDINGS[ending], ending) if rest and ending in ENDINGS else None


def unit_faults(samples: pd.DataFrame, meta: dict, file: Path) -> Iterator[str]:
    """A sentence for each quantity whose numbers can only be in another unit than its columns say."""

    def other(name: str, value: float, row: int, unit: str, remedy: str, rows: int | None = None) -> str:
        if rows is not None and rows < FEW * np.count_nonzero(samples[name]):
            unit, remedy = f"an error ({plural(rows, 'such row')})", "correct it, or leave out that row"
        where = row_name(int(samples.index[row]), file)
        return f"{file}: column {shown(name)}, {where} is {value:g}, which can only be {unit}; {remedy}."

    def beyond(pattern: str, most: float, unit: str, remedy: str) -> list[str]:
        for name in _columns(samples, pattern):
            value, row = _top(samples, name)
            if value > most:
                return [other(name, value, row, unit, remedy, int((samples[name].abs() > most).sum()))]
        return []

    kpa = beyond(r"pressure_(cmd_)?(\d+_)?kpa", MAX_PRESSURE_KPA, "pascal", "divide the column by 1000")
    for name in _columns(samples, r"pressure_(\d+_)?kpa") if not kpa else ():
        command = name.replace("pressure_", "pressure_cmd_")
        if kpa or command not in samples:
            continue
        (measured, row), (commanded, _) = _top(samples, name), _top(samples, command)
        if min(measured, commanded) > 0 and not 1 / RATIO < measured / commanded < RATIO:
            unit = f"another unit than that of '{command}' (up to {commanded:g})"
            kpa = [other(name, measured, row, unit, "give both in kPa above the surroundings")]
    yield from kpa
    length = meta.get("length_mm")  # which has rules of its own
    yield from _tip_elsewhere(samples, length if isinstance(length, int | float) else None, other)
    yield from beyond(r"bend_angle_rad|q_\d+_rad", 4 * np.pi, "degrees", "multiply the column by pi/180")
    gravity = [f"gravity_{a}" for a in "xyz"]
    missing = [c for c in gravity if c not in samples]
    if 0 < len(missing) < 3:
        yield f"{file}: column '{missing[0]}' is missing; gravity needs gravity_x, gravity_y, gravity_z."
    elif not missing:
        norm = np.linalg.norm(samples[gravity].to_numpy(float), axis=1)
        row = int(np.abs(norm - 1).argmax())
        if abs(norm[row] - 1) > 0.05:
            where = row_name(int(samples.index[row]), file)
            yield (
                f"{file}: columns 'gravity_x', 'gravity_y' and 'gravity_z', {where}, have the length"
                f" {norm[row]:.3g}, where a direction has 1; divide them by it."
            )
    yield from beyond("temperature_c", 150, "kelvin", "subtract 273.15 from the column")


def _tip_elsewhere(samples: pd.DataFrame, length_mm: float | None, other: Callable) -> Iterator[str]:
    """A sentence where the tip is in another unit or frame; `other` as in `unit_faults`."""
    tips = _columns(samples, r"tip_[xyz]_mm")
    if not tips or "tip_x_mm" not in tips and len(tips) < 3:
        return  # one coordinate across the finger may hardly move
    reach = np.hypot.reduce(samples[tips].to_numpy(float), axis=1)  # squares of huge numbers overflow
    row, value = int(reach.argmax()), float(reach.max())
    if 0 < value < (SHORTEST_TIP * length_mm if length_mm else 1.0):
        yield other(tips[0], value, row, "metres", "multiply the tip columns by 1000")
        return
    rest, commands = 0.0, _columns(samples, r"pressure_cmd_(\d+_)?kpa")
    if commands and length_mm:
        driven = samples[commands].abs().max(axis=1).to_numpy(float)
        rest = float(np.median(reach[driven <= np.quantile(driven, 0.05)]))
    for unit, mm in (("centimetres", 10.0), ("inches", 25.4)):
        if length_mm and abs(rest * mm / length_mm - 1) < SAME_LENGTH and value < 3 * rest:
            unit += f": at rest the tip is {rest:.3g} from the base of a finger of {length_mm:g} mm"
            yield other(tips[0], value, row, unit, f"multiply the tip columns by {mm:g}")
            return
    most = LONGEST_TIP * (length_mm or MOST_LENGTH_MM)
    if value > most:
        name = str(samples[tips].iloc[row].abs().idxmax())
        known, remedy = "", f"give the tip in millimetres, at most {MOST_LENGTH_MM:g}"
        if length_mm:
            known = f" (length_mm is {length_mm:g})"
            remedy = "give the tip in millimetres from the base of the device, or the right length"
        far, unit = abs(float(samples[name].iloc[row])), f"another unit or frame{known}"
        yield other(name, far, row, unit, remedy, int((reach > most).sum()))


def _columns(samples: pd.DataFrame, pattern: str) -> list[str]:
    return [c for c in samples if re.fullmatch(pattern, c)]


def _top(samples: pd.DataFrame, name: str) -> tuple[float, int]:
    """Largest size in a column, and its row."""
    values = np.abs(samples[name].to_numpy(float))
    return float(values.max()), int(values.argmax())
