"""The bounded least squares against closed forms."""

import numpy as np
import pytest

from pneutac_sim.least_squares import minimise


@pytest.fixture
def linear():
    rng = np.random.default_rng(0)
    A, truth = rng.normal(size=(60, 4)), np.array([0.4, 0.6, 0.5, 0.45])
    return A, A @ truth + 0.1 * rng.normal(size=60)


def solve(A, b, start, **options):
    return minimise(lambda v: A @ v - b, lambda v: A, np.full(A.shape[1], start), **options)


def test_with_a_prior_it_is_ridge_regression(linear):
    A, b = linear
    centre = np.array([0.5, 0.5, 0.2, 0.8])
    W = np.diag([3.0, 30.0, 300.0, 0.0]) + 1.0
    expected = np.linalg.solve(A.T @ A + W, A.T @ b + W @ centre)
    assert ((expected > 0) & (expected < 1)).all()
    found = solve(A, b, 0.3, prior=(centre, W))
    np.testing.assert_allclose(found.v, expected, atol=1e-4)
    cost = ((A @ expected - b) ** 2).sum() + (expected - centre) @ W @ (expected - centre)
    assert found.cost == pytest.approx(cost, rel=1e-4)


def test_a_strong_prior_holds_the_centre_and_a_weak_one_leaves_it(linear):
    A, b = linear
    centre = np.full(4, 0.5)
    free = np.linalg.lstsq(A, b, rcond=None)[0]
    np.testing.assert_allclose(solve(A, b, 0.3, prior=(centre, 1e8 * np.eye(4))).v, centre, atol=1e-5)
    np.testing.assert_allclose(solve(A, b, 0.3, prior=(centre, 1e-9 * np.eye(4))).v, free, atol=1e-3)
    np.testing.assert_allclose(solve(A, b, 0.3).v, free, atol=1e-3)


def test_what_the_data_leave_open_stays_at_the_centre(linear):
    A, b = linear
    A = np.c_[A, np.zeros(60)]
    prior = (np.array([0.5, 0.5, 0.5, 0.5, 0.7]), np.diag([0.0, 0, 0, 0, 1.0]))
    assert solve(A, b, 0.3, prior=prior).v[4] == pytest.approx(0.7, abs=1e-4)
    assert solve(A, b, 0.3).v[4] == pytest.approx(0.3)


def test_bounds_hold_with_a_prior(linear):
    A, b = linear
    found = solve(A, b + A @ np.array([1.0, 0, 0, 0]), 0.3, prior=(np.full(4, 0.5), 0.1 * np.eye(4)))
    assert found.v[0] == 1.0 and ((found.v >= 0) & (found.v <= 1)).all()
