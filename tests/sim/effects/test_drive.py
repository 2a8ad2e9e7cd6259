"""Actuation effects: curves, loops, sticking."""

import numpy as np
import pytest

from pneutac_sim.effects import get_effect

WEIGHTS = {"width_kpa": 5.0} | {f"weight_{i}": 0.1 for i in range(1, 6)}


def apply(name, x, values, conditions=None):
    return get_effect(name).apply(x, np.ones(len(x)), values, conditions)


def path(*corners, n=200):
    return np.concatenate([np.linspace(a, b, n) for a, b in zip(corners[:-1], corners[1:], strict=True)])


def area(x, y):
    return float(np.sum(0.5 * (y[1:] + y[:-1]) * np.diff(x)))


def test_hysteresis_bend_lags_the_pressure():
    x = path(0, 10, 0)
    y = apply("hysteresis", x, WEIGHTS)
    out, back = y[:200], y[200:][::-1]
    assert (back[10:-10] > out[10:-10]).all()  # on the way back it is still bent
    assert area(x, y) < 0


def test_hysteresis_loop_closes_and_has_the_same_area_at_any_speed():
    cycle = path(0, 10, 0)
    y = apply("hysteresis", np.r_[cycle, cycle, cycle], WEIGHTS)
    second, third = y[400:800], y[800:]
    np.testing.assert_allclose(second, third, atol=1e-12)
    slow = path(0, 10, 0, n=2000)
    z = apply("hysteresis", np.r_[slow, slow], WEIGHTS)
    assert area(slow, z[4000:]) == pytest.approx(area(cycle, third), rel=1e-2)


def test_hysteresis_remembers_its_return_points():
    """After a minor loop the path goes on as if it had not been (wiping out, Madelung's rule)."""
    with_loop = path(0, 10, 2, 6, 2, 0)
    without = path(0, 10, 2, 0)
    a, b = apply("hysteresis", with_loop, WEIGHTS), apply("hysteresis", without, WEIGHTS)
    assert a[799] == pytest.approx(b[399], abs=1e-12)
    np.testing.assert_allclose(a[800:], b[400:], atol=1e-12)


def test_friction_has_a_dead_band_at_each_reversal_and_slides_behind():
    x = path(0, 10, 0)
    y = apply("friction", x, {"coulomb_kpa": 0.5, "breakaway_kpa": 0.0})
    np.testing.assert_allclose(y[50:200], x[50:200] - 0.5, atol=1e-12)
    turn = x[200:] > 9.0
    np.testing.assert_allclose(y[200:][turn], 9.5)
    np.testing.assert_allclose(y[300:], x[300:] + 0.5, atol=1e-12)


def test_friction_breaks_away_with_a_jump():
    x = np.linspace(0, 3, 301)
    y = apply("friction", x, {"coulomb_kpa": 0.5, "breakaway_kpa": 0.4})
    assert y[x < 0.9].max() == 0.0
    first = np.argmax(y > 0)
    assert x[first] == pytest.approx(0.9, abs=0.02) and y[first] == pytest.approx(0.4, abs=0.02)
    np.testing.assert_allclose(y[first:], x[first:] - 0.5, atol=1e-12)


def test_friction_holds_small_moves_still():
    x = np.r_[np.linspace(0, 5, 100), 5 - 0.3 + 0.3 * np.cos(np.linspace(0, 60, 500))]
    y = apply("friction", x, {"coulomb_kpa": 0.4, "breakaway_kpa": 0.0})
    assert np.ptp(y[100:]) == 0.0


def test_crosstalk_adds_shares_of_the_other_pressures():
    others = np.array([[1.0, 2.0, 0.0], [0.0, 4.0, 0.0]])
    y = apply("crosstalk", np.array([3.0, 3.0]), {"share_1": 0.5, "share_2": -0.25, "share_3": 0.0}, others)
    np.testing.assert_allclose(y, [3.0, 2.0])
