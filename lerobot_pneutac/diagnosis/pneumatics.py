"""Where the pressure was measured, air and body are told apart by it.

Pneumatic effects are fitted to the measured pressure itself; the body is driven by the pressure that was
there, so nothing that the air does can pass for creep, or the other way round.
"""

from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter1d

from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.finger.quantities import rms
from pneutac_sim.twin import Twin

MAD = 1.4826
SMOOTH_SAMPLES = 2.0
JUST_NOISE = 1.1  # pressure error over its noise up to which the model's pressure is as good as the measured


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


def is_pneumatic(effect: str) -> bool:
    """Whether an effect acts between command and measured pressure; a gauge's error lies behind it."""
    return get_effect(effect).of_air


def driven_by(recording: Recording, columns: list[str], residual: np.ndarray, noise: float) -> Recording:
    """The recording with the best guess of the true pressure in its measured columns.

    The model's pressure plus the smoothed rest; where the rest is noise alone, the model's pressure.

    Args:
        recording: with measured pressure.
        columns: measured pressure.
        residual: (n, chambers) measured minus modelled, kPa.
        noise: of the measured pressure, kPa.
    """
    rest = np.zeros_like(residual)
    if rms(residual) > JUST_NOISE * noise:
        for rows in recording.trials().values():
            rest[rows] = gaussian_filter1d(residual[rows], SMOOTH_SAMPLES, axis=0, mode="nearest")
    samples = recording.samples.copy()
    samples[columns] = samples[columns].to_numpy(float) - residual + rest
    return replace(recording, samples=samples)


def joined(body: Twin, air: Twin) -> Twin:
    """The body of one twin with the pneumatic effects of another."""
    out = body.copy()
    out.effects = {k: v for k, v in out.effects.items() if not is_pneumatic(k)}
    out.effects |= {k: dict(v) for k, v in air.effects.items() if is_pneumatic(k)}
    return out
