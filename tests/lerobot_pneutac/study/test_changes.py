"""A device that changes once for good, and one that changes all the while."""

from types import SimpleNamespace

import numpy as np
import pytest

from lerobot_pneutac.study.data_breaks import find_change

N, NOISE = 1500, 0.4


def model(change):
    """A linear model of three outputs, fitted to a device with a law of its own from each row on."""
    rng = np.random.default_rng(1)
    drive = np.repeat(rng.uniform(0, 1, 100), 15)
    J = np.stack(
        [np.outer(np.ones(N), [1, 0, 0]), np.outer(drive, [0, 1, 2]), np.outer(drive**2, [1, 1, 0])], 2
    )
    truth = np.array([0.5, -4.0, 2.0]) + change[:, None] * np.array([1.5, 3.0, 0.0])
    seen = np.einsum("ndf,nf->nd", J, truth) + rng.normal(0, NOISE, (N, 3))
    flat = J.reshape(-1, 3)
    theta = np.linalg.lstsq(flat, seen.ravel(), rcond=None)[0]
    residual = (flat @ theta).reshape(N, 3) - seen
    zero = np.zeros(3)
    return SimpleNamespace(residual=residual, v=zero, jacobian=flat, weight=np.diag(zero), pull=zero)


def least(m):
    return 0.5 * ((m.residual**2).sum(axis=1).mean() - 3 * NOISE**2)


@pytest.mark.parametrize("at", [300, 777, 1200])
def test_the_moment_is_found_to_a_sample(at):
    m = model((np.arange(N) >= at).astype(float))
    assert abs(find_change(m, least(m)) - at) <= 2


def test_what_changes_all_the_while_or_for_a_while_has_no_moment():
    t = np.arange(N)
    for change in (2 * t / N, 1 - np.exp(-t / 400), np.sin(t / 60), ((t > 500) & (t < 700)).astype(float)):
        m = model(change)
        assert find_change(m, least(m)) is None


def test_nothing_is_found_in_noise():
    m = model(np.zeros(N))
    assert find_change(m, 0.05 * NOISE**2) is None
