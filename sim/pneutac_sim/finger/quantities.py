"""The only list of what is measured of a finger or an arm, and how its error is counted.

The first quantity of the list that a recording has is its headline: the error is the root mean square over
samples of the Euclidean distance of its columns, in its unit. The others are fitted too, as far as they weigh
(`weight`), but do not count in the error.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Quantity:
    """One thing that is measured."""

    pattern: str  # regular expression of its columns
    unit: str  # of its columns
    devices: tuple[str, ...] = ("finger", "arm")  # on which it is measured


# In the order of preference. An arm's joint bends about two axes and q_n is one of them, so its curvatures
# come first.
POSE = (
    Quantity(r"tip_[xyz]_mm", "mm"),
    Quantity(r"bend_angle_rad", "rad"),
    Quantity(r"curvature_[xy]_1_per_m", "1/m", ("arm",)),
    Quantity(r"q_\d+_rad", "rad"),
)
PRESSURE = Quantity(r"pressure_(\d+_)?kpa", "kPa")


def measured(columns: Iterable[str], device: str) -> list[tuple[list[str], str]]:
    """The pose columns of each quantity that was measured, and its unit; the headline first."""
    columns = [str(c) for c in columns]
    found = [
        ([c for c in columns if re.fullmatch(q.pattern, c)], q.unit) for q in POSE if device in q.devices
    ]
    return [(names, unit) for names, unit in found if names]


def observations(columns: Iterable[str], device: str) -> list[str]:
    """All pose columns, in the table's order."""
    columns = [str(c) for c in columns]
    pose = {c for names, _ in measured(columns, device) for c in names}
    return [c for c in columns if c in pose]


def headline(columns: Iterable[str], device: str) -> tuple[list[str], str]:
    """The columns whose Euclidean distance is the error, and its unit; empty where no pose was measured."""
    return next(iter(measured(columns, device)), ([], ""))


def weight(unit: str, headline_unit: str, length_mm: float) -> float:
    """What one unit of a column is worth in the unit of the error.

    A finger that bends by 1 rad moves its tip by about half its length.
    """
    if headline_unit != "mm":
        return 1.0
    return {"rad": 0.5 * length_mm, "1/m": 0.5e-3 * length_mm**2}.get(unit, 1.0)


def squared_distance(residual: np.ndarray) -> np.ndarray:
    """(n,) squared Euclidean length of the rows of a residual (n, D)."""
    return (residual * residual).sum(axis=1)


def rms(residual: np.ndarray) -> float:
    """Root mean square Euclidean length of a residual (n, D); NaN where n is zero."""
    return root_mean(squared_distance(residual))


def root_mean(squared: np.ndarray) -> float:
    """Root of the mean of squared distances (n,); NaN where n is zero."""
    return float(np.sqrt(np.mean(squared))) if len(squared) else float("nan")
