"""Limits by themselves: what they let through, to the number, and what they refuse."""

import numpy as np
import pytest
from draccus.utils import DecodingError

from lerobot_robot_pneutac.hardware.parts import COMMAND_S
from lerobot_robot_pneutac.hardware.safety import EXCESS, STOPPING_S, Limits, why_refused

CENTRE = np.array([0.5, 0.0, 0.4])


def test_the_defaults_are_those_of_the_manual():
    limits = Limits()
    assert (limits.low_m, limits.high_m) == ((0.25, -0.35, 0.12), (0.65, 0.35, 0.65))
    assert (limits.speed_m_s, limits.force_n) == (0.1, 20.0)
    assert (limits.pressure_kpa, limits.pressure_rate_kpa_s) == (15.0, 100.0)
    assert limits.overpressure_kpa == pytest.approx(17.25)
    assert (STOPPING_S, EXCESS) == (0.15, 0.2)


def test_no_velocity_carries_the_flange_out_of_its_box_even_as_the_last_command():
    limits, rng = Limits(), np.random.default_rng(0)
    low, high = np.array(limits.low_m), np.array(limits.high_m)
    for _ in range(500):
        at = rng.uniform(low, high)
        v = limits.velocity(rng.uniform(-0.3, 0.3, 3), at)
        assert (np.abs(v) <= limits.speed_m_s).all()
        end = at + v * (COMMAND_S + STOPPING_S)
        assert (end >= low - 1e-12).all() and (end <= high + 1e-12).all()
    outside = high + 0.05
    assert (limits.velocity(np.full(3, 0.05), outside) == 0).all()
    assert (limits.velocity(np.full(3, -0.05), outside) == -0.05).all()
    outside = low - 0.05
    assert (limits.velocity(np.full(3, -0.05), outside) == 0).all()
    assert (limits.velocity(np.full(3, 0.05), outside) == 0.05).all()


def test_near_a_wall_the_speed_is_the_room_by_the_time_to_rest():
    limits = Limits()
    near = np.array(limits.high_m) - 0.01
    room = 0.01 / (COMMAND_S + STOPPING_S)
    np.testing.assert_allclose(limits.velocity(np.full(3, 0.1), near), room)
    np.testing.assert_allclose(limits.velocity(np.full(3, -0.1), np.array(limits.low_m) + 0.01), -room)
    np.testing.assert_array_equal(limits.velocity(np.array([0.3, -0.3, 0.02]), CENTRE), [0.1, -0.1, 0.02])


def test_the_set_point_rises_and_falls_at_the_rate_and_ends_at_the_limit():
    limits = Limits(pressure_rate_kpa_s=30.0, pressure_kpa=10.0)
    kpa, path = 0.0, []
    for _ in range(10):
        kpa = limits.pressure(14.0, kpa, 0.1)
        path.append(kpa)
    np.testing.assert_allclose(path, [3, 6, 9, *[10] * 7])
    assert limits.pressure(-1.0, 10.0, 0.1) == pytest.approx(7.0)
    assert limits.pressure(-1.0, 1.0, 0.1) == 0.0
    assert limits.pressure(0.4, 0.5, 0.1) == 0.4
    assert limits.pressure(10.0, 0.0, 60.0) == pytest.approx(30 * COMMAND_S)  # a pause earns no jump


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ([np.nan, 0, 0, 0], "dx.vel is nan"),
        ([0, 0, 0, np.inf], "pressure.pos is inf"),
        ([0, 0, 0, 40], "pressure.pos is 40, far outside 0 to 15"),
        ([0.141, 0, 0, 0], "dx.vel is 0.141, far outside"),
        ([0.139, 0, -0.139, 17.9], None),
        ([-0.139, 0, 0.139, -2.9], None),
    ],
)
def test_what_is_refused(values, reason):
    found = why_refused(np.array(values, float))
    assert (found is None) if reason is None else found.startswith(reason)


def test_an_action_of_another_length_is_no_action():
    with pytest.raises(ValueError, match="zip"):
        why_refused(np.zeros(5))


@pytest.mark.parametrize(
    ("force_n", "kpa", "words"),
    [
        (20.0, 17.25, None),
        (20.1, 0.0, "force at the flange is 20.1 N, above limits.force_n = 20"),
        (0.0, 17.3, "pressure is 17.3 kPa, above limits.overpressure_kpa = 17.25"),
        (np.inf, 0.0, "check the sensors"),
        (0.0, np.nan, "check the sensors"),
    ],
)
def test_what_a_measurement_breaks(force_n, kpa, words):
    found = Limits().broken_by(force_n, kpa)
    assert (found is None) if words is None else words in found


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        ({"speed_m_s": 0.5}, "speed_m_s is 0.5; actions reach 0.1 at most"),
        ({"speed_m_s": 0.0}, "speed_m_s is 0.0; it must be a positive number"),
        ({"force_n": float("nan")}, "force_n is nan; it must be a positive number"),
        ({"vacuum_kpa": 1.0}, "vacuum_kpa is 1.0; it must be 0, or below"),
        ({"low_m": (0.8, 0, 0)}, "low_m is .* the first below the second"),
        ({"low_m": (0.25,)}, "low_m is .* give three numbers each"),
        ({"overpressure_kpa": 14.0}, "overpressure_kpa is 14.0; it must be above .* set-point, 15.0"),
    ],
)
def test_impossible_limits_are_named(bad, words):
    with pytest.raises(DecodingError, match=f"limits.{words}"):
        Limits(**bad)


def test_set_points_that_are_not_given_are_the_twins():
    limits = Limits().of_twin((-30.0, 60.0))
    assert (limits.vacuum_kpa, limits.pressure_kpa, limits.action_kpa) == (-30.0, 60.0, (-30.0, 60.0))
    assert limits.overpressure_kpa == pytest.approx(69.0)
    assert limits.pressure(-90.0, -29.0, 0.1) == -30.0
    assert why_refused(np.array([0, 0, 0, 55.0]), limits.action_kpa) is None
    assert "far outside -30 to 60" in why_refused(np.array([0, 0, 0, 79.0]), limits.action_kpa)
    assert limits.broken_by(0.0, -68.0) is None
    assert "farther below zero" in limits.broken_by(0.0, -70.0)


def test_beyond_the_twin_asks_for_a_flag():
    for given in ({"pressure_kpa": 20.0}, {"vacuum_kpa": -1.0}):
        with pytest.raises(DecodingError, match="measured from 0 to 15 kPa.*beyond_twin=true"):
            Limits(**given).of_twin((0.0, 15.0))
    assert Limits(pressure_kpa=20.0, beyond_twin=True).of_twin((0.0, 15.0)).action_kpa == (0.0, 20.0)
    lowered = Limits(pressure_kpa=3.0).of_twin((0.0, 15.0))  # a caution: actions beyond are held, not refused
    assert (lowered.pressure_kpa, lowered.action_kpa) == (3.0, (0.0, 15.0))
