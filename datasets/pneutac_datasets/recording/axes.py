"""Along which axes an error may be looked at: pressure, direction, rate, hold time, logged conditions.

Which device has how many chambers, and what its pressures are called in a table.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from pneutac_datasets.recording.noise import quiet_s
from pneutac_datasets.recording.recording import GRAVITY, Recording
from pneutac_datasets.recording.units import BASE_UNIT, base_unit
from pneutac_datasets.recording.wording import an, plural
from pneutac_sim.errors import InputError
from pneutac_sim.features import CHAMBERS
from pneutac_sim.finger.inputs import pressure_columns

STILL_1_PER_S = 0.005  # of the range of pressures: a slower change counts as a hold
HOLD_EDGES_S = (0.0, 1.0, 3.0, 10.0, 30.0, 100.0, np.inf)


@dataclass
class Axis:
    """One way to sort samples."""

    name: str  # column or derived quantity
    value: np.ndarray | None  # (n,) number of each sample, None for labels
    bin: np.ndarray  # (n,) bin number of each sample, -1 where it belongs to none
    labels: list[str]  # what to call each bin


def axes(recording: Recording) -> list[Axis]:
    """Every axis that this recording's columns allow, also those along which it never varied.

    For a finger or an arm: commanded pressures, `direction` (loading, unloading, hold), `rate` (kPa/s),
    `hold_time_s`, `program`, `trial`, `gravity`, and all other columns by their own name.
    """
    s = recording.samples
    found = [numbers(c, recording.column(c), 8) for c in recording.pressure_columns]
    rate, rest_s = motion(recording)
    still = np.abs(rate) <= STILL_1_PER_S * max(float(np.ptp(recording.commands)), 1e-9)
    way = np.where(still, 2, np.where(rate > 0, 0, 1))
    found.append(Axis("direction", None, way, ["loading", "unloading", "hold"]))
    found.append(_rates(rate, still))
    at = np.where(still, np.clip(np.searchsorted(HOLD_EDGES_S, rest_s, side="right") - 1, 0, 5), -1)
    names = [f"{a:g} to {b:g} s" for a, b in zip(HOLD_EDGES_S[:-1], HOLD_EDGES_S[1:], strict=True)]
    found.append(Axis("hold_time_s", rest_s, at, [*names[:-1], f"over {HOLD_EDGES_S[-2]:g} s"]))
    for name in ("program", "trial"):
        if name in s:
            found.append(_labels(name, s[name]))
    if "gravity_x" in s:
        g = s[[*GRAVITY]].to_numpy(float).round(1) + 0.0
        found.append(_labels("gravity", pd.Series([", ".join(f"{x:g}" for x in v) for v in g])))
    for name in recording.conditions:
        if name == "program" or name.startswith("gravity_"):
            continue
        if s[name].dtype.kind in "if":
            found.append(numbers(name, recording.column(name).astype(float), 6))
        elif s[name].nunique() <= 30:
            found.append(_labels(name, s[name]))
    for axis in found:  # only bins that hold a sample
        used, at = np.unique(axis.bin[axis.bin >= 0], return_inverse=True)
        axis.bin, axis.labels = axis.bin.copy(), [axis.labels[i] for i in used]
        axis.bin[axis.bin >= 0] = at
    return [axis for axis in found if axis.labels]


def motion(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Rate of the commanded pressure (n,), kPa/s, over the last 0.2 s, and time since it last moved (n,), s.

    Of several chambers the rate is their sum's, since loading means more air in all.
    """
    p, time_s, begins = recording.commands, recording.column("time_s"), np.zeros(len(recording), bool)
    rate = np.zeros(len(recording))
    for rows in recording.trials().values():
        t, q, begins[rows.start] = time_s[rows], p[rows], True
        back = np.minimum(np.searchsorted(t, t - 0.2), np.maximum(np.arange(len(t)) - 1, 0))
        rate[rows] = (q - q[back]).sum(1) / np.maximum(t - t[back], 1e-9)
    return rate, quiet_s(time_s, begins, p)


def numbers(name: str, value: np.ndarray, bins: int) -> Axis:
    """Few distinct numbers are bins of their own; otherwise equal steps over the range."""
    distinct = np.unique(value[np.isfinite(value)])
    if len(distinct) <= bins:
        place = np.searchsorted(distinct, value)
        return Axis(name, value, np.where(np.isfinite(value), place, -1), [f"{x:g}" for x in distinct])
    edges = np.linspace(distinct[0], distinct[-1], bins + 1)
    place = np.clip(np.searchsorted(edges, value, side="right") - 1, 0, bins - 1)
    digits = max(0, int(np.ceil(-np.log10((edges[1] - edges[0]) / 2))))
    shown = [f"{x:.{digits}f}" for x in np.round(edges, digits) + 0.0]  # + 0.0 makes -0 a 0
    labels = [f"{a} to {b}" for a, b in zip(shown[:-1], shown[1:], strict=True)]
    return Axis(name, value, np.where(np.isfinite(value), place, -1), labels)


def _rates(rate: np.ndarray, still: np.ndarray) -> Axis:
    """Holds, then thirds of the moving samples by the size of their rate; ramps of one speed share a bin."""
    size = np.abs(rate)
    moving = size[~still]
    if len(moving) == 0:
        return Axis("rate", rate, np.zeros(len(rate), int), ["hold"])
    edges = np.unique(np.round(np.quantile(moving, [0, 1 / 3, 2 / 3, 1]), 6))
    edges = edges if len(edges) > 1 else np.r_[edges, edges[-1] + 1]
    at = 1 + np.clip(np.searchsorted(edges, size, side="right") - 1, 0, len(edges) - 2)
    labels = [f"{a:.3g} to {b:.3g} kPa/s" for a, b in zip(edges[:-1], edges[1:], strict=True)]
    return Axis("rate", rate, np.where(still, 0, at), ["hold", *labels])


def _labels(name: str, column: pd.Series) -> Axis:
    at, labels = pd.factorize(column)
    return Axis(name, None, at, [str(x) for x in labels])


def unit_of(name: str) -> str:
    """Unit in a column's name, for axis titles."""
    unit = base_unit(name)
    return {"temperature": "°C"}.get(unit.dimension, BASE_UNIT[unit.dimension]) if unit else ""


def device_with(chambers: int) -> str:
    """The device that has so many chambers; raises InputError where none has."""
    if device := next((d for d, count in CHAMBERS.items() if count == chambers), ""):
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
