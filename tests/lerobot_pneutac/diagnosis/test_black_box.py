"""The black box as an alarm: it finds what a model left, and nothing in noise."""

import numpy as np
import pytest

from lerobot_pneutac.diagnosis.black_box import predict, share_left
from pneutac_sim.effects.laws import law

HZ, N, NOISE = 10.0, 6000, 0.2
BLOCK = np.arange(N) // 250
TEST = BLOCK % 4 == 3


def pressure(seed):
    rng = np.random.default_rng(seed)
    p = np.interp(np.arange(N), np.linspace(0, N - 1, 300), rng.uniform(0, 1, 300))
    p[N // 2 :] = np.repeat(rng.uniform(0, 1, N // 100), 50)
    return p


def lagged(p, tau):
    values = {"weight": 1.0, "scale_kpa": 1.0, "time_s": tau}
    return law("lag(p)").apply(p, np.full(N, 1 / HZ), values)


def features(p):
    return np.stack([p, *(lagged(p, tau) - p for tau in (0.15, 0.5, 1.5, 5.0, 20.0))], axis=1)


def noise(seed, columns=2):
    return NOISE * np.random.default_rng([seed, 1]).normal(size=(N, columns))


def share(residual, p):
    return share_left(residual, features(p), ~TEST, TEST, NOISE * np.sqrt(residual.shape[1]))


@pytest.mark.parametrize("tau", [0.8, 3.0])
def test_a_lag_that_was_left_is_found(tau):
    p = pressure(0)
    left = np.outer(lagged(p, tau) - p, [3.0, -1.0])
    assert share(left + noise(0), p) > 0.8


def test_nothing_is_found_in_noise():
    for seed in range(6):
        assert share(noise(seed), pressure(seed)) < 0.05


def test_nothing_is_found_in_what_the_inputs_do_not_tell():
    """A slow drift and bumps at random: more than noise, and none of them follows the pressure."""
    for seed in range(4):
        rng = np.random.default_rng([seed, 2])
        bumps = np.repeat(rng.normal(size=N // 50), 50)[:, None] * [0.5, 0.5]
        assert share(bumps + noise(seed), pressure(seed)) < 0.1


def test_half_of_what_is_left_is_half():
    p, rng = pressure(3), np.random.default_rng(5)
    known = lagged(p, 1.5) - p
    unknown = np.repeat(rng.normal(size=N // 10), 10)
    unknown *= known[TEST].std() / unknown[TEST].std()
    residual = 5 * np.stack([known, unknown], axis=1)
    assert share(residual + noise(3), p) == pytest.approx(0.5, abs=0.08)


def test_it_learns_from_its_own_part_alone():
    p = pressure(1)
    left = np.outer(lagged(p, 1.5) - p, [3.0])
    changed = left.copy()
    changed[TEST] = 100.0
    np.testing.assert_array_equal(predict(left, features(p), ~TEST), predict(changed, features(p), ~TEST))


def test_a_feature_that_stands_still_while_learning_tells_nothing():
    p = pressure(1)
    still = np.where(TEST, 1.0, 0.0)
    left = np.outer(lagged(p, 1.5) - p, [3.0]) + noise(1, 1)
    with_it = np.c_[features(p), still]
    np.testing.assert_allclose(predict(left, with_it, ~TEST), predict(left, features(p), ~TEST))
