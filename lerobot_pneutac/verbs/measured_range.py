"""The range of pressures over which a recording measures a device."""

import math

from pneutac_datasets.recording.pressures import usable
from pneutac_datasets.recording.recording import Recording

DIGITS = 2  # the range is rounded outwards to so many: valves and programs hardly ever stop at a round number


def measured_range(recording: Recording) -> tuple[float, float] | None:
    """Lowest and highest commanded pressure in kPa, 0 (vented) among them; None where nothing is driven.

    It ends where the supply does.
    """
    columns = recording.pressure_columns
    pressures = usable(recording)[0].samples[columns].to_numpy(float)
    if not pressures.size or not pressures.any():
        return None
    return 0.0 - _outwards(-min(pressures.min(), 0.0)), _outwards(max(pressures.max(), 0.0))


def range_sentence(pressure_range_kpa: tuple[float, float]) -> str:
    """What a range means for all that drives the twin."""
    low, high = pressure_range_kpa
    return (
        f"The twin was measured from {low:g} to {high:g} kPa; robots and environments drive it no farther "
        "unless `pressure_range_kpa` is given."
    )


def _outwards(value: float) -> float:
    """The next number from `value` >= 0 on that has `DIGITS` digits."""
    if value == 0:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(value)) - DIGITS + 1)
    return float(f"{math.ceil(value / unit - 1e-6) * unit:.6g}")
