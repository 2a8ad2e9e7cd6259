"""Checks of a set-point that every pressure controller makes before anything is sent."""

import math

from pneutac_sim.errors import InputError


def checked_kpa(kpa: float, max_kpa: float) -> float:
    """The set-point in kPa (gauge) as a float.

    Raises:
        InputError: it is no number, not finite, or outside 0 ... `max_kpa`.
    """
    try:
        value = float(kpa)
    except (TypeError, ValueError):
        raise InputError(f"The set-point {kpa!r} is no number; it must be a pressure in kPa.") from None
    if not math.isfinite(value):
        raise InputError(f"The set-point is {value}; it must be a finite pressure in kPa.")
    if not 0 <= value <= max_kpa:
        raise InputError(f"The set-point {value:g} kPa is outside this controller's 0 ... {max_kpa:g} kPa.")
    return value


def checked_max_kpa(max_kpa: float) -> float:
    """The option `max_kpa` as a float; raises InputError unless it is positive and finite."""
    if not (isinstance(max_kpa, int | float) and math.isfinite(max_kpa) and max_kpa > 0):
        raise InputError(f"max_kpa is {max_kpa!r}; it must be a positive pressure in kPa.")
    return float(max_kpa)
