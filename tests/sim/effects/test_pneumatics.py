"""Pneumatic effects against their analytic solutions."""

import numpy as np
import pytest

from pneutac_sim.effects import get_effect
from pneutac_sim.effects.orifice_flow import ATMOSPHERE_KPA, fill, vent

HZ = 50


RESONANCE = {"frequency_rad_per_s": 11.0, "damping_ratio": 0.3}


def apply(name, x, values, dt=1 / HZ, conditions=None):
    return get_effect(name).apply(x, np.full(len(x), dt), values, conditions)


@pytest.mark.parametrize(
    ("effect", "law", "values"),
    [
        ("valve_lag", "fill_vent(p)", {"fill_time_s": 0.3, "vent_time_s": 1.1}),
        ("air_resonance", "mode(p)", RESONANCE),
        ("air_resonance", "mode(p)", RESONANCE | {"damping_ratio": 1.7}),
    ],
)
def test_effects_with_a_law_alike_act_as_it_does(effect, law, values):
    """Laws have closed forms in `test_laws.py`."""
    x = np.interp(np.linspace(0, 29, 801), np.arange(30), np.random.default_rng(0).uniform(0, 8, 30))
    alike = apply(law, x, values | {"weight": 1.0, "scale_kpa": 8.0})
    np.testing.assert_allclose(apply(effect, x, values), alike, atol=1e-12)


def test_a_trial_begins_settled_at_its_first_pressure():
    x = np.r_[np.zeros(50), np.full(50, 8.0)]
    dt = np.full(100, 0.02)
    dt[50] = np.inf
    for name in ("valve_lag", "orifice_flow", "dead_time"):
        np.testing.assert_array_equal(get_effect(name).apply(x, dt), x)


@pytest.mark.parametrize("direction", ["fill", "vent"])
def test_flow_solves_iso_6358_across_choked_and_subsonic(direction):
    b, k, t_end = 0.3, 0.8, 1.1
    p1, p2 = (500.0, 120.0) if direction == "fill" else (700.0, 150.0)
    p = p2 if direction == "fill" else p1
    n = 400_000
    for _ in range(n):  # explicit Euler of the equation itself
        up, down = (p1, p) if direction == "fill" else (p, p2)
        r = down / up
        psi = 1.0 if r <= b else np.sqrt(max(0.0, 1 - ((r - b) / (1 - b)) ** 2))
        p += (1 if direction == "fill" else -1) * k * up * psi * t_end / n
    flow, start, other = (fill, p2, p1) if direction == "fill" else (vent, p1, p2)
    whole = flow(start, other, k, b, t_end)
    assert whole == pytest.approx(p, rel=2e-4)
    halves = flow(flow(start, other, k, b, 0.4), other, k, b, t_end - 0.4)
    assert halves == pytest.approx(whole, rel=1e-3)


def test_orifice_arrives_in_finite_time_and_takes_longer_for_larger_steps():
    def arrival(step):
        x = np.r_[0.0, np.full(4000, step)]
        y = apply("orifice_flow", x, {"fill_rate_1_per_s": 0.5, "vent_rate_1_per_s": 0.5}, 0.005)
        assert y[-1] == step and (np.diff(y) >= 0).all()
        return np.argmax(y == step) * 0.005

    # phi runs from asin((p2/p1 - b)/(1 - b)) to pi/2 at the rate k/(1 - b)
    r = ATMOSPHERE_KPA / (ATMOSPHERE_KPA + 50)
    exact = (np.pi / 2 - np.arcsin((r - 0.3) / 0.7)) * 0.7 / 0.5
    assert arrival(50.0) == pytest.approx(exact, abs=0.02)
    assert arrival(5.0) < 0.5 * arrival(50.0)


def test_dead_time_shifts_a_ramp_and_holds_before_it():
    t = np.cumsum(np.random.default_rng(3).uniform(0.005, 0.05, 500))
    x = np.where(t > t[0] + 1.0, t - t[0] - 1.0, 0.0) + 2.0
    y = get_effect("dead_time").apply(x, np.diff(t, prepend=0), {"delay_s": 0.33})
    expected = np.interp(t - 0.33, t, x)
    np.testing.assert_allclose(y, expected, atol=1e-12)


def test_leak_decays_while_the_command_holds_and_refills_when_it_moves():
    x = np.r_[np.zeros(10), np.full(200, 12.0), np.full(100, 6.0)]
    y = apply("leak", x, {"leak_rate_1_per_s": 0.08})
    t = np.arange(200) / HZ
    np.testing.assert_allclose(y[10:210], 12.0 * np.exp(-0.08 * t), rtol=1e-12)
    assert y[210] == 6.0


# ---------------------------------------------------------------- slew

SLEW = {"fill_rate_kpa_per_s": 4.0, "vent_rate_kpa_per_s": 2.0, "band_kpa": 0.5, "vent_growth": 0.0}


def test_a_slow_valve_fills_in_a_straight_line_and_settles_within_its_band():
    dt = np.r_[np.inf, 1e-9, np.full(400, 0.01)]
    y = get_effect("valve_slew").apply(np.r_[0.0, np.full(401, 6.0)], dt, SLEW | {"scale_kpa": 6.0})
    t = 0.01 * np.arange(401)
    to_band = 5.5 / 4.0
    expected = np.where(t < to_band, 4.0 * t, 6.0 - 0.5 * np.exp(-(t - to_band) * 4.0 / 0.5))
    np.testing.assert_allclose(y[1:], expected, atol=1e-7)


def test_it_vents_quicker_from_a_higher_pressure():
    dt = np.r_[np.inf, 1e-9, np.full(100, 0.01)]
    values = SLEW | {"vent_growth": 1.5, "scale_kpa": 10.0}
    y = get_effect("valve_slew").apply(np.r_[10.0, np.zeros(101)], dt, values)
    t = 0.01 * np.arange(101)
    a = 0.15  # p' = -2 (1 + 0.15 p), until the band
    expected = (10.0 + 1 / a) * np.exp(-2.0 * a * t) - 1 / a
    assert expected[-1] > 0.5
    np.testing.assert_allclose(y[1:], expected, atol=0.02)


def test_twice_the_samples_of_straight_lines_hardly_matter_and_a_rest_lasts():
    """Of effects with a law alike `test_laws.py` says so."""
    name, values = "valve_slew", SLEW
    levels = np.random.default_rng(0).uniform(0, 8, 30)
    x = np.interp(np.linspace(0, 29, 801), np.arange(30), levels)
    fine = np.interp(np.arange(0, 800.5, 0.5), np.arange(801), x)
    coarse = apply(name, x, values)
    assert np.abs(coarse - apply(name, fine, values, 0.5 / HZ)[::2]).max() < 0.02 * np.abs(coarse - x).max()
    np.testing.assert_allclose(apply(name, np.full(50, 3.0), values), 3.0, atol=1e-12)
    dt = np.full(801, 1 / HZ)
    dt[400] = np.inf
    whole = get_effect(name).apply(x, dt, values)
    np.testing.assert_allclose(whole[400:], apply(name, x[400:], values), atol=1e-12)
