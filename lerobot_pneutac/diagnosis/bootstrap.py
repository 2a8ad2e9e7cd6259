"""Paired block bootstrap, stratified by condition.

Neighbouring errors are correlated, so whole units of time are drawn; both models are scored on the same draw,
so what is easy or hard in a unit cancels. Each condition keeps its number of units in every draw: gravity may
show in four units of thirty-six, and plain resampling would often miss all four. `Parts` deals a recording
into these units, and into training, validation and test.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from lerobot_pneutac.diagnosis import thresholds as T
from pneutac_datasets.recording.recording import LEVELS, Recording, assign, strata


@dataclass(frozen=True)
class PairedTest:
    """Two models on the same units of time: the fall of the mean square error, and how certain that is."""

    value: float  # fall of the mean square error
    low: float  # its lower 1 % bound
    high: float  # its upper 99 % bound
    significant: bool  # whether it falls, by `BlockBootstrap.paired`
    units: int  # that were compared
    least: float  # fall that is significant in `POWER` of such recordings
    # how much longer a recording in which a fall of `value` is significant in `POWER` of all must be;
    # infinite where the error does not fall
    times: float


class BlockBootstrap:
    """Draws of mean square errors of the samples `mask` (n,) of a recording.

    `unit` (n,) is the resampling unit of each sample, `stratum` (units,) the condition of each unit.
    """

    def __init__(self, mask: np.ndarray, unit: np.ndarray, stratum: np.ndarray, seed: int):
        self.mask = mask
        used, self._index = np.unique(unit[mask], return_inverse=True)
        self.units = len(used)
        self._size = np.bincount(self._index, minlength=self.units).astype(float)
        rng = np.random.default_rng([seed, 77])
        weight = np.zeros((T.DRAWS, self.units))
        for members in _strata(stratum[used]):
            weight[:, members] = rng.multinomial(
                len(members), np.full(len(members), 1 / len(members)), T.DRAWS
            )
        self._weight = weight
        self._total = weight @ self._size

    def sums(self, squared: np.ndarray) -> np.ndarray:
        """Sum (units,) of the squared errors (n,) of each unit."""
        return np.bincount(self._index, squared[self.mask], self.units)

    def mse(self, squared: np.ndarray) -> np.ndarray:
        """Mean square error (DRAWS,) under each draw, from squared errors (n,)."""
        return self._weight @ self.sums(squared) / self._total

    def value(self, squared: np.ndarray) -> float:
        return float(squared[self.mask].mean())

    def shares(self, models: Sequence[np.ndarray]) -> np.ndarray:
        """How likely each of n models is the best (n,), from squared errors (n,) on what its fit did not see.

        The share of the draws in which it has the least; of few units it is no certainty (Laplace's rule).
        """
        errors = np.stack([self.mse(squared) for squared in models])
        best = np.bincount(errors.argmin(axis=0), minlength=len(errors)) / errors.shape[1]
        return (best * self.units + 1) / (self.units + len(errors))

    def drop(self, before: np.ndarray, after: np.ndarray) -> tuple[float, float, float]:
        """Fall of the mean square error: value, lower 1 % bound, upper 99 % bound."""
        d = self.mse(before) - self.mse(after)
        lo, hi = np.quantile(d, [T.SIGNIFICANCE, 1 - T.SIGNIFICANCE])
        return self.value(before) - self.value(after), float(lo), float(hi)

    def paired(self, before: np.ndarray, after: np.ndarray, trials: "BlockBootstrap") -> PairedTest:
        """The paired test of squared errors (n,) without and with something, with its power.

        The mean square error falls significantly if its lower bound is positive, or if it falls and
        `significant_drop` confirms that across units and, where these are enough, across whole trials:
        sessions may differ by more than the blocks within one.

        The power is that of a normal mean whose standard error is that of the lower bound and shrinks with
        the root of the number of units: Cohen, Statistical Power Analysis (1988), section 2.
        """
        value, low, high = self.drop(before, after)
        across = [self, *([trials] if trials.units > T.FEW_UNITS else [])]
        sure = low > 0 or (value > 0 and all(b.significant_drop(before, after) for b in across))
        needed = norm.ppf(1 - T.SIGNIFICANCE)
        least = (value - low) * float(1 + norm.ppf(T.POWER) / needed)
        times = (least / value) ** 2 if value > 0 else np.inf
        return PairedTest(value, low, high, bool(sure), self.units, least, float(times))

    def significant_drop(self, before: np.ndarray, after: np.ndarray, noise_mse: float = 0.0) -> bool:
        """Whether the error falls significantly, by squared errors (n,), in one of two ways.

        1. In 99 % of the draws of units the fall as a share of both errors is positive on average. The
           moments after a step of the command can hold nearly all of the squared error, in two units of
           sixty: its mean then says little of whether a model is better.
        2. The sum of squares falls in 99 % of the draws from the units in which a model errs clearly more
           than the noise, if these are more than `FEW_UNITS`. In all others the noise decides which model
           errs less, and where they are many, their shares hide what the few show. Without the mean square
           of the noise the first way stands alone.
        """
        b, a = self.sums(before), self.sums(after)
        if np.quantile(self._weight @ ((b - a) / np.maximum(b + a, 1e-300)), T.SIGNIFICANCE) > 0:
            return True
        fall = (b - a)[np.maximum(b, a) > T.CLOSE**2 * noise_mse * self._size]
        n = len(fall)
        if noise_mse == 0 or n <= T.FEW_UNITS:
            return False
        draws = np.random.default_rng(78).multinomial(n, np.full(n, 1 / n), T.DRAWS)
        return bool(np.quantile(draws @ fall, T.SIGNIFICANCE) > 0)

    def reduction(
        self, before: np.ndarray, after: np.ndarray, floor: float
    ) -> tuple[float, tuple[float, float]]:
        """Share of the avoidable error that went, 1 - (MSE - floor^2) / (MSE_0 - floor^2), and its 95 % CI.

        By squared errors (n,) without and with an effect, and the noise floor in their root's unit. The share
        is at most 1, and 0 where nothing was avoidable.
        """
        excess = self.value(before) - floor**2
        if excess <= T.AVOIDABLE * floor**2 or self.units < 2:
            return 0.0, (0.0, 0.0)
        share = 1 - (self.value(after) - floor**2) / excess
        b, a = self.mse(before) - floor**2, self.mse(after) - floor**2
        ok = b > 0.01 * floor**2
        draws = 1 - a[ok] / b[ok]
        lo, hi = np.quantile(draws, [0.025, 0.975]) if ok.any() else (share, share)
        lo, hi = min(lo, share), max(hi, share)
        return _clip(share), (_clip(lo), _clip(hi))


def _clip(x: float) -> float:
    return float(np.clip(x, -1.0, 1.0))


def _strata(stratum: np.ndarray) -> list[np.ndarray]:
    """Groups of units to draw within; conditions with one unit are pooled, for one unit has no spread."""
    groups = [np.flatnonzero(stratum == s) for s in np.unique(stratum)]
    large = [g for g in groups if len(g) > 1]
    single = [g for g in groups if len(g) == 1]
    if single:
        pool = np.concatenate(single)
        if len(pool) > 1 or not large:
            large.append(pool)
        else:
            i = max(range(len(large)), key=lambda k: len(large[k]))
            large[i] = np.concatenate([large[i], pool])
    return large


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
