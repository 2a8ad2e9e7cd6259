"""What a measured pressure is worth: whether it tells anything, and how noisy it is."""

import numpy as np

from pneutac_datasets.recording.recording import Recording

MAD = 1.4826


def measured_columns(recording: Recording) -> list[str]:
    """Columns of measured pressure, empty where one is missing or tells nothing."""
    columns = [c.replace("pressure_cmd", "pressure") for c in recording.pressure_columns]
    for command, measured in zip(recording.pressure_columns, columns, strict=True):
        if not recording.has(measured):
            return []
        p, m = recording.column(command).astype(float), recording.column(measured).astype(float)
        if np.ptp(p) <= 1e-3 or np.ptp(m) < 0.05 * np.ptp(p):
            return []
    return columns


def sensor_noise(recording: Recording, columns: list[str]) -> float:
    """Noise of the measured pressures together, kPa.

    From second differences, whose variance is six times that of white noise; their median is blind to steps.
    """
    total = 0.0
    for rows in recording.trials().values():
        p = recording.samples[columns].to_numpy(float)[rows]
        if len(p) >= 20:
            d = np.diff(p, 2, axis=0)
            total = max(total, float(((MAD * np.median(np.abs(d), axis=0)) ** 2).sum() / 6))
    return float(np.sqrt(total))
