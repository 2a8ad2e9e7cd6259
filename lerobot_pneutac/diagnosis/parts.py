"""Deals a recording into training, validation and test, and into the units that the bootstrap resamples."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lerobot_pneutac.diagnosis import thresholds as T
from pneutac_datasets.recording.recording import LEVELS, Recording, assign, strata


@dataclass
class Parts:
    """Which samples are for what."""

    train: np.ndarray  # (n,) mask: fits parameters and ranks effects
    validation: np.ndarray  # (n,) mask: decides whether an effect stays
    # (n,) mask: looked at by the report alone; equal to `validation` where there is little data
    test: np.ndarray
    unit: np.ndarray  # (n,) resampling unit of each sample: a block of time or a piece of one
    stratum: np.ndarray  # (units,) condition of each unit (program, orientation, temperature, payload)

    @property
    def heldout(self) -> np.ndarray:
        """(n,) mask of all samples that no parameter was fitted to."""
        return ~self.train

    @property
    def learnt(self) -> np.ndarray:
        """(n,) mask of what a search may learn from: all but the test part, where there is one of its own."""
        return ~self.test if self.has_test else self.train

    @property
    def has_test(self) -> bool:
        """Whether a part was left untouched by the choice of effects."""
        return not np.array_equal(self.validation, self.test)


def deal(recording: Recording, seed: int) -> Parts:
    """Splits by whole blocks of time, stratified by condition; the seed decides which goes where."""
    block = recording.blocks()
    if len(np.unique(block)) < T.FEW_BLOCKS:
        train, test = recording.split(seed=seed)
        validation = test
    else:
        block = _refine(recording, block)
        part = assign(recording.samples, block, seed, T.FRACTIONS)
        train, validation, test = (part == i for i in range(3))
    pieces = 1
    for part in (validation, test):
        pieces = max(pieces, min(4, -(-T.UNITS // max(1, len(np.unique(block[part]))))))
    unit = _cut(block, np.full(block.max() + 1, pieces))
    stratum = strata(recording.samples, block)[block]
    first = np.unique(unit, return_index=True)[1]
    return Parts(train, validation, test, unit, stratum[first])


def conditions(recording: Recording, levels: Sequence[str] = LEVELS) -> np.ndarray:
    """Number (n,) of each sample's condition: direction of gravity, levels of load and temperature."""
    samples, key = recording.samples, [np.zeros(len(recording), int)]
    for name in ("gravity_x", "gravity_y", "gravity_z", *levels):
        if name in samples:
            v = samples[name].to_numpy(float)
            span = np.ptp(v) if name in LEVELS else 2.0
            key.append(np.round(2 * (v - v.min()) / max(span, 1e-12)).astype(int))
    return np.unique(np.stack(key, 1), axis=0, return_inverse=True)[1].reshape(-1)


def out_of_time(condition: np.ndarray, begin: int) -> np.ndarray:
    """(N,) folds that leave out (0) the rows from `begin` on; all others are fitted (-1).

    Later rows whose condition never occurred before `begin` stay in the fit: what the first load or the first
    turn of the base does cannot be predicted from rows without it.
    """
    later = np.arange(len(condition)) >= begin
    return np.where(later & np.isin(condition, condition[:begin]), 0, -1)


def _refine(recording: Recording, block: np.ndarray) -> np.ndarray:
    """Finer blocks (n,) where a condition has too few of them for every part to get some."""
    stratum = strata(recording.samples, block)
    count = np.bincount(stratum)[stratum]
    return _cut(block, np.where(count < T.RARE, -(-T.LEAST_OF_A_KIND // count), 1))


def _cut(block: np.ndarray, pieces: np.ndarray) -> np.ndarray:
    """Blocks (n,), each cut into so many pieces of equal length."""
    position = np.arange(len(block)) - np.unique(block, return_index=True)[1][block]
    size = np.bincount(block)[block]
    within = position * pieces[block] // size
    return np.unique(block * (pieces.max() + 1) + within, return_inverse=True)[1]
