"""Conditions of a world, as a user gives them: a number, or a range from which every episode draws."""

import math
from collections.abc import Mapping

import numpy as np

from pneutac_sim.errors import InputError
from pneutac_sim.finger.online import PressurePipeline
from pneutac_sim.twin import Twin

Conditions = Mapping[str, float | list[float]]
# The flange is held pointing down, so that the straight finger hangs along gravity, a unit vector; nothing
# else hangs at its tip.
USUAL = {"gravity_x": 1.0, "gravity_y": 0.0, "gravity_z": 0.0, "payload_g": 0.0}


def conditions_for(twin: Twin, given: Conditions | None) -> Conditions:
    """All conditions of a world with this twin: those given, else gravity in the base's frame and no payload.

    Raises:
        InputError: a condition is neither a finite number nor a range [low, high] of such, or one that an
            effect of the twin needs is not given.
    """
    given = given or {}
    for name, value in given.items():
        low, high = value if isinstance(value, list | tuple) and len(value) == 2 else (value, value)
        numbers = all(type(v) in (int, float) and math.isfinite(v) for v in (low, high))
        if not (numbers and low <= high):
            raise InputError(f"conditions has {name}: {value}; give a finite number, or a range [low, high].")
    found = USUAL | dict(given)
    PressurePipeline(twin, draw(found, np.random.default_rng(0)))  # refuses an effect without its conditions
    return found


def draw(conditions: Conditions, rng: np.random.Generator) -> dict[str, float]:
    """A number for each condition, from its range where it has one."""
    return {
        name: float(rng.uniform(*value) if isinstance(value, list | tuple) else value)
        for name, value in conditions.items()
    }
