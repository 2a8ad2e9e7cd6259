"""Deals photographs of a gel into training, validation and test.

As one pair of images cannot tell a drift or a shift, some of the photographs beside the calibration pair
train too; of the others one half decides which effects are kept and the other half is looked at by the
report alone.
"""

import numpy as np

from lerobot_pneutac.diagnosis.parts import Parts
from lerobot_pneutac.diagnosis.verdict import FEW_UNITS
from pneutac_datasets.recording import blocks
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError

MOST_TRAINED = 6  # photographs that train; more cost time and pin the light no better
FEW_TRAINED = 2  # below this no drift and no shift can be told
NEEDED = FEW_TRAINED + 2 * FEW_UNITS  # photographs, the calibration pair's among them


def deal_photographs(recording: Recording, seed: int) -> Parts:
    """Photographs for training, validation and test; the last two are one where there are few.

    Raises:
        InputError: there is no photograph beside the calibration pair.
    """
    n = len(recording)
    roles = recording.samples["role"].astype(str) if recording.has("role") else np.full(n, "")
    train = np.asarray(roles == "calibration")
    others = np.flatnonzero(~train)
    if not len(others):
        raise InputError("The recording has no image beside the calibration pair, so nothing can be judged.")
    spare = min(MOST_TRAINED - int(train.sum()), len(others) - 2 * FEW_UNITS)
    if len(others) < 2 * FEW_UNITS:  # too few for a verdict; the fits shall be of use all the same
        spare = min(spare + FEW_UNITS, len(others) // 2)
    if spare > 0:
        train[np.random.default_rng([seed, 5]).permutation(others)[:spare]] = True
    rest = np.flatnonzero(~train)
    validation, test = ~train, ~train
    if len(rest) >= 2 * FEW_UNITS:
        samples = recording.samples.iloc[rest]
        half = blocks.assign(samples, np.arange(len(rest)), seed, (0.5, 0.5))
        validation, test = (np.isin(np.arange(n), rest[half == i]) for i in range(2))
    stratum = np.unique(np.asarray(roles), return_inverse=True)[1]
    return Parts(train, validation, test, np.arange(n), stratum)
