"""Checks of set-points and options that pressure controllers share."""

import math

from pneutac_sim.errors import InputError


def checked_kpa(kpa: float, max_kpa: float, min_kpa: float = 0.0) -> float:
    """The set-point in kPa (gauge) as a float.

    Raises InputError: it is no number, not finite, or outside `min_kpa` ... `max_kpa`.
    """
    try:
        value = float(kpa)
    except OverflowError:  # a whole number beyond all floats
        value = math.inf
    except (TypeError, ValueError):
        raise InputError(f"The set-point {kpa!r} is no number; it must be a pressure in kPa.") from None
    if not math.isfinite(value):
        raise InputError(f"The set-point is {value}; it must be a finite pressure in kPa.")
    if not min_kpa <= value <= max_kpa:
        raise InputError(
            f"The set-point {value:g} kPa is outside this controller's {min_kpa:g} ... {max_kpa:g} kPa."
        )
    return value


def positive(name: str, value: float | str) -> float:
    """A numeric option, which from a command line may come as text; raises InputError naming it."""
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not 0 < number < math.inf:
        raise InputError(f"{name} is {value!r}; it must be a positive number.")
    return number
