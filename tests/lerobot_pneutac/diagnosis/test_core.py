"""Bootstrap and parts, on recordings and errors whose answer is known.

Out-of-time validation: rows of a condition that never occurred before stay in the fit.
"""

import numpy as np
import pandas as pd
import pytest

from lerobot_pneutac.diagnosis.bootstrap import BlockBootstrap, PairedTest, conditions, deal, out_of_time
from pneutac_datasets.recording.recording import Recording

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


def test_bootstrap_interval_covers_the_true_drop():
    """Errors correlated within blocks: the 98 % interval holds the true drop in most worlds."""
    covered = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        unit = np.repeat(np.arange(30), 40)
        level = rng.gamma(2.0, 1.0, 30)[unit]
        before, after = 3.0 + level, 2.0 + level * 0.5
        judge = BlockBootstrap(np.ones(1200, bool), unit, np.zeros(30, int), seed)
        _, low, high = judge.drop(before, after)
        covered += low <= 1.0 + 0.5 * 2.0 <= high
    assert covered >= 54


def test_a_fall_is_sure_where_nearly_all_units_agree_though_two_hold_all_of_it():
    """Just after steps of the command squares are a thousand times those of the rest, both ways."""
    rng = np.random.default_rng(0)
    unit, noise = np.repeat(np.arange(60), 25), rng.chisquare(3, 1500)
    judge = BlockBootstrap(np.ones(1500, bool), unit, np.zeros(60, int), 0)
    before, after = 1.2 * noise, noise.copy()
    for u, b, a in ((3, 9e3, 100.0), (20, 3e3, 50.0), (40, 50.0, 4e3)):
        before[25 * u], after[25 * u] = b, a
    assert judge.drop(before, after)[1] < 0 < judge.drop(before, after)[0]
    assert judge.significant_drop(before, after) and not judge.significant_drop(after, before)
    once = after.copy()
    once[75] = 900.0
    assert not judge.significant_drop(once, after) and not judge.significant_drop(after, once), (
        "one unit is chance"
    )


@pytest.mark.parametrize("seed", range(5))
def test_a_few_units_far_above_the_noise_decide_and_those_at_the_noise_do_not(seed):
    """A slow valve shows in nine units of eighty; elsewhere the better model errs a little more."""
    rng = np.random.default_rng(seed)
    unit = np.repeat(np.arange(80), 20)
    noise = rng.chisquare(3, 1600) / 3
    judge = BlockBootstrap(np.ones(1600, bool), unit, np.zeros(80, int), seed)
    before, after = noise.copy(), 1.1 * noise
    for u, b, a in ((3, 460, 0.7), (40, 260, 0.7), (9, 9, 1), (51, 10, 5), (60, 1.0, 3.1)):
        before[unit == u], after[unit == u] = b, a
    few = before.copy(), after.copy()
    for u in (12, 30, 45, 70):
        before[unit == u] = 3.2
    assert judge.significant_drop(before, after, 1.0) and not judge.significant_drop(after, before, 1.0)
    assert not judge.significant_drop(before, after), "without the noise no unit stands out"
    assert not judge.significant_drop(*few, 1.0), "too few"
    plain = noise * rng.uniform(0.9, 1.1, 1600), noise
    assert not judge.significant_drop(*plain, 1.0) and not judge.significant_drop(*plain[::-1], 1.0)


def test_so_many_times_the_recording_shows_the_fall_with_the_power_that_is_stated():
    """Falls of units are normal with a mean of 0.25 standard deviations, over errors that vary much more."""
    rng, times, found = np.random.default_rng(4), [], []

    def test(n: int) -> PairedTest:
        judge = BlockBootstrap(np.ones(n, bool), np.arange(n), np.zeros(n, int), 0)
        level = rng.gamma(2.0, 20.0, n) + 20.0
        return judge.paired(level, level - rng.normal(0.25, 1.0, n), judge)

    for _ in range(40):
        t = test(40)
        times.append((t.least / 0.25) ** 2)  # of the true fall, not of the one that this draw shows
        assert t.significant or t.times > 1
    n = round(40 * float(np.median(times)))
    found = [test(n).low > 0 for _ in range(60)]
    assert n == pytest.approx((2.326 + 0.842) ** 2 / 0.25**2, rel=0.15)
    assert 0.65 < np.mean(found) < 0.93, "a power of 80 %, of sixty draws"


def test_a_fall_that_few_heavy_blocks_hide_counts_if_sessions_agree():
    """Two blocks of 96 hold most of the squared error, and vary by chance."""
    unit, trial = np.repeat(np.arange(96), 10), np.repeat(np.arange(8), 120)
    blocks, sessions = (
        BlockBootstrap(np.ones(960, bool), u, np.zeros(u.max() + 1, int), 0) for u in (unit, trial)
    )
    before = np.repeat(np.random.default_rng(1).gamma(2.0, 1.0, 96), 10)
    heavy = np.isin(unit, (5, 50))
    before[heavy] = 300.0
    by_chance = np.where(unit == 5, 220.0, 375.0)
    everywhere = np.where(heavy, by_chance, 0.7 * before)
    in_three = np.where(heavy, by_chance, np.where(trial > 4, 0.2, 1.02) * before)
    all_of_them, three = (blocks.paired(before, a, sessions) for a in (everywhere, in_three))
    assert all_of_them.low < 0 < all_of_them.value and all_of_them.significant
    assert blocks.significant_drop(before, in_three), "as if blocks of one session were independent"
    assert three.value > 0 and not three.significant
    worse = blocks.paired(before, 1.1 * before, sessions)
    assert not worse.significant and np.isinf(worse.times)


def test_stratified_draws_never_lose_a_rare_condition():
    unit = np.repeat(np.arange(36), 10)
    stratum = np.r_[np.zeros(32, int), np.ones(4, int)]
    gain = np.where(np.isin(unit, np.arange(32, 36)), 1.0, 0.0)
    judge = BlockBootstrap(np.ones(360, bool), unit, stratum, 0)
    _, low, _ = judge.drop(gain, np.zeros(360))
    assert low == pytest.approx(4 / 36)
    plain = BlockBootstrap(np.ones(360, bool), unit, np.zeros(36, int), 0)
    assert plain.drop(gain, np.zeros(360))[1] < low


def test_reduction_is_one_when_only_noise_is_left():
    unit = np.repeat(np.arange(20), 50)
    judge = BlockBootstrap(np.ones(1000, bool), unit, np.zeros(20, int), 0)
    rng = np.random.default_rng(0)
    noise = rng.normal(size=1000) ** 2
    share, (lo, hi) = judge.reduction(noise + 8.0, noise, 1.0)
    assert share == pytest.approx(1.0, abs=0.02) and lo <= share <= hi
    share, _ = judge.reduction(noise + 8.0, noise + 4.0, 1.0)
    assert share == pytest.approx(0.5, abs=0.02)


def test_parts_are_apart_and_hold_every_condition():
    recording = make_recording()
    parts = deal(recording, 3)
    assert (parts.train.astype(int) + parts.validation + parts.test == 1).all() and parts.has_test
    for part in (parts.train, parts.validation, parts.test):
        assert set(recording.samples["program"][part]) == {"ramps", "steps"}
    for u in np.unique(parts.unit):
        assert len({tuple(x) for x in np.stack([parts.train, parts.validation], 1)[parts.unit == u]}) == 1


def test_later_rows_are_left_out_only_where_their_condition_occurred_before(tmp_path):
    n = 100
    table = pd.DataFrame(
        {"trial": 0, "time_s": np.arange(n) / 10, "pressure_cmd_kpa": 0.0, "bend_angle_rad": 0.0}
    )
    over = np.where(np.arange(n) >= 80, 1.0, -1.0)
    table = table.assign(gravity_x=0.0, gravity_y=0.0, gravity_z=over, payload_g=0.0)
    recording = Recording(tmp_path, {"device": "finger", "length_mm": 100.0}, table, "finger")
    condition = conditions(recording)
    assert len(np.unique(condition)) == 2
    fold = out_of_time(condition, 50)
    assert (fold[:50] == -1).all() and (fold[50:80] == 0).all() and (fold[80:] == -1).all()
    assert (out_of_time(condition, 90)[90:] == 0).all()
    assert (out_of_time(np.zeros(n, int), 50)[50:] == 0).all(), (
        "one condition alone: all later rows are predicted"
    )
