"""The error that demonstrations have by themselves, as one length at the tip."""

import numpy as np

from lerobot_pneutac.study.demonstration_fit import Fitter
from lerobot_pneutac.study.demonstration_words import UNIT
from pneutac_datasets.recording.noise import NoiseFloor

MAD = 1.4826  # standard deviation of a normal distribution over its median absolute deviation


def frame_noise(fitter: Fitter, remainder: float | None) -> NoiseFloor:
    """What differs from frame to frame; or what the twin left before, where that is known and more.

    Of each signal by the median size of its third differences over the root of 20, their gain on white noise:
    motion has little of them.

    Args:
        fitter: with the episodes.
        remainder: the most that the twin left of the demonstrations that it was last fitted to, mm; None
            where it was to none.
    """
    columns: dict[str, list[np.ndarray]] = {"flange": [], "pressure.pos": [], "imprint": []}
    for e in fitter.episodes:
        columns["flange"].append(1e3 * np.sqrt(3) * np.diff(e.flange_m, 3, axis=0).ravel())
        columns["pressure.pos"].append(fitter.mm_per_kpa * np.diff(e.pressure_kpa, 3))
        strong = e.imprint > 0.5 * e.imprint.max()
        columns["imprint"].append(fitter.mm_per_rad * np.diff(e.imprint[strong], 3) / fitter.slope)
    sizes = {k: float(MAD * np.median(np.abs(np.concatenate(v))) / np.sqrt(20)) for k, v in columns.items()}
    value = float(np.sqrt(sum(s**2 for s in sizes.values())))
    if remainder is not None and remainder > value:
        how = "what the twin left of the demonstrations that it was last fitted to, at most"
        return NoiseFloor(remainder, None, UNIT, how, sizes, True)
    return NoiseFloor(value, None, UNIT, "what differs from frame to frame", sizes, False)
