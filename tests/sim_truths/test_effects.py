"""Single effects against what their sources say of them."""

import numpy as np
import pytest

from pneutac_truths.effects import air, load, material
from pneutac_truths.programs import DT_S, Plan
from pneutac_truths.world import Body, World


def world(command: np.ndarray) -> World:
    """A rod of one trial with this command (n,) on the fine grid."""
    n = len(command)
    plan = Plan(np.arange(n) * DT_S, command[:, None], np.zeros(n), [0], [n], ["steps"], [0.0])
    w = World(Body.draw("rod", 1), plan, 1, 1)
    w.air = w.sent.copy()
    w.drive = w.body.bend_rad * w.air
    w.memory = np.zeros_like(w.drive)
    return w


def step(seconds: float) -> np.ndarray:
    return np.r_[np.zeros(20), np.ones(round(seconds / DT_S))]


def loops(n: int, low: float = 0.0, high: float = 1.0) -> np.ndarray:
    return low + (high - low) * (0.5 - 0.5 * np.cos(2 * np.pi * np.arange(n * 800) / 800))


@pytest.mark.parametrize("order", [0.15, 0.4])
def test_fractional_creep_grows_with_its_order(order):
    w = world(step(100))
    material.creep_fractional(w, order=order, size=0.05)
    t = np.arange(len(w.memory) - 20) * DT_S
    late = t > 0.5
    slope = np.polyfit(np.log(t[late]), np.log(w.memory[20:, 0][late]), 1)[0]
    assert slope == pytest.approx(order, abs=0.01)
    at_one = w.memory[20 + round(1 / DT_S), 0]
    assert at_one == pytest.approx(0.05 * w.body.bend_rad[0], rel=0.01)


def test_preisach_closes_minor_loops_and_forgets_them():
    """Return-point memory: after a minor loop the major one goes on as if it had not been."""
    up = np.linspace(0, 0.8, 400)
    minor = np.r_[np.linspace(0.8, 0.4, 200), np.linspace(0.4, 0.8, 200)]
    rest = np.linspace(0.8, 1.0, 100)
    with_loop, without = world(np.r_[up, minor, rest]), world(np.r_[up, rest])
    for w in (with_loop, without):
        material.hysteresis_preisach(w, width=0.2, size=1.0)
    np.testing.assert_allclose(with_loop.memory[-99:], without.memory[-99:], atol=1e-12)
    assert np.ptp(with_loop.memory[400:800]) > 0.01


def test_maxwell_slip_takes_work_in_every_cycle_at_any_pace():
    def area(command):
        w = world(command)
        material.friction_maxwell(w, strength=1.2, size=0.1)
        bend = (w.drive + w.memory)[:, 0]
        last = slice(-800 * (len(command) // 2400), None)
        return abs(np.trapezoid(w.air[last, 0], bend[last]))

    slow = np.repeat(loops(3), 3)
    assert area(loops(3)) > 0.02
    assert area(slow[: 3 * 2400]) == pytest.approx(area(loops(3)), rel=0.05)


def test_an_orifice_fills_at_a_choked_rate_and_slows_when_subsonic():
    w = world(step(10))
    air.fill_orifice(w, critical=0.3, supply=9.0, growth=0.0, size=2.0)
    x = w.air[20:, 0]
    assert np.interp(0.8, x, np.arange(len(x)) * DT_S) == pytest.approx(1.6, rel=0.05)
    early = np.diff(x)[10:200]
    assert np.ptp(early) < 0.02 * early.mean()  # choked: the rate does not depend on the chamber's pressure
    near = world(step(10))
    air.fill_orifice(near, critical=0.3, supply=1.05, growth=0.0, size=2.0)
    late = np.diff(near.air[20:, 0])
    reach = near.air[20:-1, 0]
    assert late[np.argmin(abs(reach - 0.85))] < 0.9 * late[np.argmin(abs(reach - 0.3))]
    assert near.air[-1, 0] == pytest.approx(1.0, abs=0.02)


def test_a_long_line_swings_at_its_period():
    w = world(step(10))
    air.line_second_order(w, damping=0.1, size=0.8)
    x = w.air[20:, 0] - 1
    up = np.flatnonzero((x[:-1] < 0) & (x[1:] >= 0)) * DT_S
    assert np.diff(up).mean() == pytest.approx(0.8 / np.sqrt(1 - 0.1**2), rel=0.02)
    assert np.array_equal(w.at_gauge, w.sent)


@pytest.mark.parametrize(
    ("act", "parameters"),
    [
        (air.fill_orifice, {"critical": 0.3, "supply": 2.0, "growth": 0.8, "size": 0.1}),
        (air.valve_slew, {"size": 0.1}),
        (air.line_second_order, {"damping": 0.2, "size": 0.1}),
        (air.leak, {"power": 2.0, "lag_s": 0.03, "size": 0.1}),
        (air.vent_slow, {"fill_share": 0.3, "size": 0.1}),
        (air.tube_kink, {"kink": 0.5, "size": 0.1}),
    ],
)
def test_air_moves_after_its_command_not_with_it(act, parameters):
    w = world(step(0.1))
    act(w, **parameters)
    assert w.air[20, 0] == 0.0 < w.air[21, 0]


def test_a_slow_vent_is_a_lag_from_the_moment_of_the_command():
    w = world(step(0.5))
    air.vent_slow(w, fill_share=0.4, size=0.1)
    after = np.arange(len(w.air) - 20) * DT_S
    np.testing.assert_allclose(w.air[20:, 0], 1 - np.exp(-after / 0.04), atol=1e-12)


def test_a_hunting_regulator_never_settles():
    w = world(step(20) * 0.6)
    air.hunting(w, pace=0.6, size=0.05)
    late = w.air[-2000:, 0]
    assert 0.07 < np.ptp(late) < 0.16
    assert late.mean() == pytest.approx(0.6, abs=0.03)


def test_a_leak_costs_more_than_in_proportion():
    held = []
    for level in (0.5, 1.0):
        w = world(step(5) * level)
        air.leak(w, power=2.0, lag_s=0.03, size=0.1)
        held.append(level - w.air[-1, 0])
    assert held[1] > 3 * held[0] > 0


def test_mullins_softens_below_the_greatest_bend_and_recovers_at_rest():
    first = np.r_[np.linspace(0, 0.5, 400), np.linspace(0.5, 1, 400), np.linspace(1, 0, 800)]
    second = np.linspace(0, 0.5, 400)

    def gain(rest_s):
        w = world(np.r_[first, np.zeros(round(rest_s / DT_S)), second])
        material.mullins(w, forget_s=50.0, round=0.2, size=0.2)
        return w.drive[-200, 0] / (w.body.bend_rad[0] * w.air[-200, 0])

    assert gain(1.0) > 1.15
    assert gain(300.0) == pytest.approx(1.0, abs=1e-3)


def test_play_in_the_mount_is_crossed_only_after_a_turn():
    turn = load._play(np.r_[np.linspace(0, 1, 100), np.linspace(1, 0, 100)], 0.2)
    assert turn[:100].max() == 1.0 and turn[110] > 0.4 and turn[-1] == 0.0
