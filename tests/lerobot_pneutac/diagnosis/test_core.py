"""Selection, bootstrap and fingerprints on toy models whose answer is known."""

import numpy as np
import pandas as pd
import pytest

from lerobot_pneutac.diagnosis.bootstrap import Resampler
from lerobot_pneutac.diagnosis.fingerprints import fingerprints, lagged, play, steps
from lerobot_pneutac.diagnosis.fits import FittedModel, effective_count
from lerobot_pneutac.diagnosis.parts import deal
from lerobot_pneutac.diagnosis.selection import select
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.twin import Twin

N, HZ = 4000, 10.0


def make_recording(seed=0, noise=0.3):
    """Ramps, holds and steps over 400 s in four trials; the tip follows the pressure alone."""
    rng = np.random.default_rng(seed)
    t = np.arange(N) / HZ
    knots = rng.uniform(0, 50, 81)
    p = np.interp(t, np.linspace(0, N / HZ, 81), knots)
    p[N // 2 :] = np.repeat(rng.uniform(0, 50, 40), N // 80)
    trial = np.arange(N) // (N // 4)
    table = pd.DataFrame(
        {
            "trial": trial,
            "time_s": t - trial * (N // 4) / HZ,
            "program": np.where(np.arange(N) < N // 2, "ramps", "steps"),
            "pressure_cmd_kpa": p,
            "tip_x_mm": 100 - 0.2 * p,
            "tip_y_mm": 0.0,
            "tip_z_mm": p + noise * rng.normal(size=N),
        }
    )
    return Recording(None, {"length_mm": 110.0}, table, "finger")


TWIN = Twin("finger", 110.0)  # stands there; the toy's fits have no use for it


class LinearFitter:
    """Effects are columns that are added to a straight line in pressure; the fit is exact least squares."""

    def __init__(self, recording, parts, columns):
        self.p = recording.column("pressure_cmd_kpa")
        self.y = recording.column("tip_z_mm")
        self.parts, self.columns = parts, columns

    def fit_all(self, effects, start=None):
        fits = []
        for names in effects:
            J = np.stack([np.ones(N), self.p, *(self.columns[n] for n in names)], 1)
            theta = np.linalg.lstsq(J[self.parts.train], self.y[self.parts.train], rcond=None)[0]
            fits.append(FittedModel(tuple(names), (self.y - J @ theta)[:, None], J.shape[1], TWIN))
        return fits

    def promising(self, fit, candidates, least):
        return candidates


def toy(hidden, seed=0, noise=0.3):
    recording = make_recording(seed, noise)
    dt = steps(recording)
    p = recording.column("pressure_cmd_kpa")
    columns = {
        "creep": lagged(p, dt, 20.0) - p,
        "valve_lag": lagged(p, dt, 0.3) - p,
        "hysteresis": play(p, dt, 8.0) - p,
        "stiffening": p**2 / 50,
        "drift": np.arange(N) / N,
    }
    recording.samples["tip_z_mm"] += sum(size * columns[name] for name, size in hidden.items())
    parts = deal(recording, seed)
    return (
        recording,
        parts,
        select(LinearFitter(recording, parts, columns), (), list(columns), parts, noise, seed),
    )


@pytest.mark.parametrize("hidden", [{"creep": 0.1}, {"stiffening": 0.3}, {"hysteresis": 0.3, "creep": 0.2}])
def test_selection_finds_exactly_the_hidden_effects(hidden):
    _, _, found = toy(hidden)
    assert set(found.selected) == set(hidden)
    assert [set(f.effects) for f in found.path] == [set(found.added[:i]) for i in range(len(found.path))]


def test_selection_is_silent_when_nothing_is_missing():
    for seed in range(10):
        assert toy({}, seed)[2].selected == []


def test_the_most_important_effect_comes_first():
    assert toy({"hysteresis": 0.05, "creep": 0.4})[2].selected[0] == "creep"


def test_bootstrap_interval_covers_the_true_drop():
    """Errors correlated within blocks: the 98 % interval holds the true drop in most worlds."""
    covered = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        unit = np.repeat(np.arange(30), 40)
        level = rng.gamma(2.0, 1.0, 30)[unit]
        before, after = 3.0 + level, 2.0 + level * 0.5
        judge = Resampler(np.ones(1200, bool), unit, np.zeros(30, int), seed)
        _, low, high = judge.drop(before, after)
        covered += low <= 1.0 + 0.5 * 2.0 <= high
    assert covered >= 54


def test_stratified_draws_never_lose_a_rare_condition():
    unit = np.repeat(np.arange(36), 10)
    stratum = np.r_[np.zeros(32, int), np.ones(4, int)]
    gain = np.where(np.isin(unit, np.arange(32, 36)), 1.0, 0.0)
    judge = Resampler(np.ones(360, bool), unit, stratum, 0)
    _, low, _ = judge.drop(gain, np.zeros(360))
    assert low == pytest.approx(4 / 36)
    plain = Resampler(np.ones(360, bool), unit, np.zeros(36, int), 0)
    assert plain.drop(gain, np.zeros(360))[1] < low


def test_reduction_is_one_when_only_noise_is_left():
    unit = np.repeat(np.arange(20), 50)
    judge = Resampler(np.ones(1000, bool), unit, np.zeros(20, int), 0)
    rng = np.random.default_rng(0)
    noise = rng.normal(size=1000) ** 2
    share, (lo, hi) = judge.reduction(noise + 8.0, noise, 1.0)
    assert share == pytest.approx(1.0, abs=0.02) and lo <= share <= hi
    share, _ = judge.reduction(noise + 8.0, noise + 4.0, 1.0)
    assert share == pytest.approx(0.5, abs=0.02)


def test_effective_count_follows_the_autocorrelation():
    rng = np.random.default_rng(0)
    rho, x = 0.9, np.zeros((20000, 1))
    e = rng.normal(size=20000)
    for i in range(1, 20000):
        x[i] = rho * x[i - 1] + e[i]
    everywhere = np.ones(20000, bool)
    assert effective_count(x, everywhere) == pytest.approx(20000 * 0.1 / 1.9, rel=0.15)
    assert effective_count(e[:, None], everywhere) > 19000


def test_parts_are_apart_and_hold_every_condition():
    recording = make_recording()
    parts = deal(recording, 3)
    assert (parts.train.astype(int) + parts.validation + parts.test == 1).all() and parts.has_test
    for part in (parts.train, parts.validation, parts.test):
        assert set(recording.samples["program"][part]) == {"ramps", "steps"}
    for u in np.unique(parts.unit):
        assert len({tuple(x) for x in np.stack([parts.train, parts.validation], 1)[parts.unit == u]}) == 1


@pytest.mark.parametrize("hidden", ["creep", "stiffening"])
def test_fingerprint_of_the_hidden_effect_stands_above_chance(hidden):
    recording, _, found = toy({hidden: 0.3})
    residual = np.c_[np.zeros(N), np.zeros(N), found.base.residual]
    prints = fingerprints(recording, residual, recording.samples[["pressure_cmd_kpa"]].to_numpy())
    mine = next(f for f in prints if f.effect == hidden)
    assert mine.share > 0.7 and mine.share > 2 * mine.chance and mine.p_value < 0.02


def test_fingerprints_of_pure_noise_stay_at_chance():
    recording, _, found = toy({})
    prints = fingerprints(recording, found.base.residual, recording.samples[["pressure_cmd_kpa"]].to_numpy())
    assert sum(f.p_value < 0.01 for f in prints) <= 1
