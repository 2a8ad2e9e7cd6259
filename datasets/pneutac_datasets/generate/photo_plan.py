"""Which hidden device is photographed under which pressures, and how its joints follow them."""

import numpy as np
import pandas as pd

from pneutac_datasets.generate.photo_cameras import CAMERAS
from pneutac_sim.errors import InputError
from pneutac_sim.features import CHAMBERS
from pneutac_sim.finger.inputs import Inputs, pressure_columns
from pneutac_sim.finger.pipeline import Pipeline
from pneutac_sim.twin import PAPER_FINGER, Twin, Value

PRESSURES_KPA = tuple(float(p) for p in range(16))


def hidden_twin(seed: int, device: str) -> Twin:
    """A device with parameters around the paper's calibrated ones (Sec. IV-A).

    Args:
        seed: decides them.
        device: `finger` or `arm`.
    """
    if device not in CAMERAS:
        raise InputError(f"There are no photographs of a '{device}'; choose finger or arm.")
    rng = np.random.default_rng([seed, 11])
    p = PAPER_FINGER
    scale, even, straight = {"finger": (1.0, 1.0, 1.0), "arm": (0.7, 0.3, 0.1)}[device]
    values = {
        "gain_rad_per_kpa": scale * p["gain_rad_per_kpa"] * rng.uniform(0.8, 1.25),
        "gain_alpha": p["gain_alpha"] + rng.uniform(-0.06, 0.06),
        "gain_beta": p["gain_beta"] * rng.uniform(0.5, 1.2) * even,
        "rest_pressure_kpa": straight * p["rest_pressure_kpa"] * rng.uniform(0.6, 1.2),
        "youngs_modulus_mpa": p["youngs_modulus_mpa"] * rng.uniform(0.7, 1.4),
        "poissons_ratio": p["poissons_ratio"] + rng.uniform(-0.04, 0.02),
        "joint_stiffness_nm_per_rad": p["joint_stiffness_nm_per_rad"] * rng.uniform(0.8, 1.25),
    }
    length = {"finger": 110.0, "arm": 200.0}[device]
    return Twin(device, length, parameters={k: Value(float(v)) for k, v in values.items()})


def default_pressures(device: str) -> np.ndarray:
    """(T, chambers) kPa: 0 to 15 kPa in steps of 1; of an arm in steps of 3, each chamber by itself."""
    if CHAMBERS[device] == 1:
        return np.array(PRESSURES_KPA)[:, None]
    one = np.array(PRESSURES_KPA[::3])
    rows = [np.zeros((1, CHAMBERS[device]))]
    rows += [p * np.eye(CHAMBERS[device])[[c]] for c in range(CHAMBERS[device]) for p in one[1:]]
    return np.concatenate(rows)


def session(pressure: np.ndarray, device: str, after_s: tuple[float, ...], conditions: dict) -> pd.DataFrame:
    """When the device is photographed under which pressure: the recording's table without what is seen."""
    pressure = pressure[:, None] if pressure.ndim == 1 else pressure
    times = np.asarray(after_s, float)
    if len(times) and not (np.isfinite(times).all() and (np.diff(times, prepend=0.0) > 0).all()):
        raise InputError(f"after_s is {times.tolist()}; give rising times above 0 s, such as (2, 60).")
    if pressure.ndim != 2 or pressure.shape[1] != CHAMBERS[device] or not np.isfinite(pressure).all():
        raise InputError(
            f"pressures_kpa must be rows of {CHAMBERS[device]} finite numbers, one a chamber of the {device}."
        )
    count = len(pressure)
    if len(times):
        trial, time = (
            np.zeros(count * len(times), int),
            (times[-1] * np.arange(count)[:, None] + times).ravel(),
        )
    else:
        trial, time = np.arange(count), np.zeros(count)
    each = max(len(times), 1)
    table = {"trial": trial, "time_s": time}
    table |= dict(zip(pressure_columns(device)[0], np.repeat(pressure, each, 0).T, strict=True))
    for name, value in conditions.items():
        table[name] = np.repeat(np.broadcast_to(np.asarray(value, float), count), each)
    return pd.DataFrame(table)


def joints_of(twin: Twin, samples: pd.DataFrame) -> np.ndarray:
    """(n, H) rad of the joint targets at each sample of a recording, as it went.

    Raises:
        InputError: an effect of the twin asks for a column that is not there.
    """
    inputs = Inputs.from_samples(samples, twin.device, twin.length_mm, source="command", start="held")
    pipeline = Pipeline.of(twin, inputs)
    for name, why in pipeline.left_out.items():
        raise InputError(f"The twin's effect '{name}' cannot act: {why}.")
    return pipeline.run(inputs, pipeline.theta(twin)).joints
