"""Conditions as a user gives them: a number, or a range from which every episode draws."""

import math
from collections.abc import Mapping

import numpy as np

from pneutac_sim.errors import InputError

Condition = float | list[float]


def check_conditions(conditions: Mapping[str, Condition]) -> None:
    """Raises InputError where a condition is neither a finite number nor a range [low, high] of such."""
    for name, value in conditions.items():
        low, high = value if isinstance(value, list | tuple) and len(value) == 2 else (value, value)
        numbers = all(type(v) in (int, float) and math.isfinite(v) for v in (low, high))
        if not (numbers and low <= high):
            raise InputError(f"conditions has {name}: {value}; give a finite number, or a range [low, high].")


def draw(conditions: Mapping[str, Condition], rng: np.random.Generator) -> dict[str, float]:
    """A number for each condition, from its range where it has one."""
    return {
        name: float(rng.uniform(*value) if isinstance(value, list | tuple) else value)
        for name, value in conditions.items()
    }
