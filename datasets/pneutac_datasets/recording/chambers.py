"""Which device has how many chambers, and what its pressures are called in a table."""

from collections.abc import Iterable, Sequence

import numpy as np

from pneutac_datasets.recording.wording import an, plural
from pneutac_sim.errors import InputError
from pneutac_sim.features import CHAMBERS
from pneutac_sim.finger.inputs import pressure_columns


def device_with(chambers: int) -> str:
    """The device that has so many chambers; raises InputError where none has."""
    for device, count in CHAMBERS.items():
        if count == chambers:
            return device
    known = " and ".join(f"{an(device)} has {count}" for device, count in CHAMBERS.items())
    raise InputError(f"There is no device with {chambers} chambers; {known}.")


def command_columns(chambers: int) -> list[str]:
    """Columns of the commands, one a chamber: `pressure_cmd_kpa`, or `pressure_cmd_1_kpa` and so on."""
    return pressure_columns(device_with(chambers))[0]


def measured_columns(chambers: int) -> list[str]:
    """Columns of the measured pressures, one a chamber."""
    return pressure_columns(device_with(chambers))[1]


def chambers_commanded(columns: Iterable[str]) -> int:
    """How many chambers has the device of which a table has commands; 0 where it has none."""
    present = set(columns)
    return max((n for n in CHAMBERS.values() if present.intersection(command_columns(n))), default=0)


def per_chamber(name: str, value: float | Sequence[float] | np.ndarray, chambers: int) -> np.ndarray:
    """A limit of each chamber (chambers,); raises InputError where there are neither one nor so many."""
    values = np.atleast_1d(np.asarray(value, float))
    if values.shape not in ((1,), (chambers,)):
        raise InputError(
            f"{name} has {plural(len(values), 'number')} for {plural(chambers, 'chamber')}; give one for all,"
            " or one for each."
        )
    return np.broadcast_to(values, chambers)
