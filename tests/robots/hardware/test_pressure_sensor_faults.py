"""One sensor that lies, on a supply of 40 kPa: how high the true pressure comes, in simulated time."""

import math

import numpy as np
import pytest
from pressure_rig import SimulatedTime

from lerobot_robot_pneutac.hardware.pressure_protocol import Flag

LIMIT_PA = 16500


def random_fault(rng) -> list:
    """Options of the simulator: one way to lie, from some time on."""
    kind = ("stuck", "offset", "drift", "noise", "gain")[rng.integers(5)]
    value = {
        "stuck": rng.uniform(-1000, 16000),
        "offset": rng.uniform(-15000, 15000),
        "drift": rng.choice([-1, 1]) * 10 ** rng.uniform(1.5, 4.3),  # Pa/s
        "noise": 10 ** rng.uniform(2, 4),
        "gain": rng.uniform(0, 1.5),
    }[kind]
    options = [f"--sensor-{kind}", f"{value:.4f}", "--fault-at-s", f"{rng.uniform(0, 3):.3f}"]
    return options + (["--sensor-noise", f"{rng.uniform(0, 200):.1f}"] if kind == "stuck" else [])


def peak_pa(program, rng, options, seconds) -> float:
    """Highest true pressure while random set-points are sent, in three sessions that clear all faults."""
    rig = SimulatedTime(program, *options)
    try:
        rig.open()
        for session in range(8, 11):
            rig.follow(rng.choice([rng.uniform(1000, 15000), 15000], seconds), 1000, session - 1)
            rig.open(session)
        return rig.peak_pa
    finally:
        rig.close()


def test_a_sensor_stuck_at_9_kpa_with_noise_fills_no_more_than_the_cut_off(program):
    rig = SimulatedTime(program, "--sensor-stuck", 9000, "--fault-at-s", 1)
    rig.open()
    rig.follow([9500] * 60, 1000)
    flags = rig.status.flags
    rig.close()
    assert rig.peak_pa <= LIMIT_PA
    assert flags & (Flag.STUCK_VALVE | Flag.TOO_MUCH_AIR) and Flag.VENTED in flags


@pytest.mark.parametrize(("number", "seconds"), [(40, 5), pytest.param(1000, 20, marks=pytest.mark.nightly)])
def test_the_chamber_stays_below_the_cut_off_whatever_one_sensor_reads(program, number, seconds):
    rng, over = np.random.default_rng(0), []
    for _ in range(number):
        options = random_fault(rng)
        peak = peak_pa(program, rng, options, seconds)
        if peak > LIMIT_PA:
            over.append((round(peak), options))
    assert not over


@pytest.mark.parametrize(
    "options",
    [
        (),
        ("--noise-pa", 100),
        ("--noise-pa", 3),
        ("--leak-per-s", 1),
        ("--wrong-air", 1.03),
        ("--wrong-air", 0.9),
        ("--fill-s", 2, "--vent-s", 0.8),
    ],
)
@pytest.mark.parametrize("seconds", [6, pytest.param(300, marks=pytest.mark.nightly)])
def test_no_alarm_in_normal_use(program, options, seconds):
    """Steps, a sine at 15 Hz of set-points, and the highest set-point held."""
    rng = np.random.default_rng(1)
    rig = SimulatedTime(program, *options)
    rig.open()
    sine = [7500 + 7500 * math.sin(2 * math.pi * k / 15) for k in range(5 * seconds)]
    rig.follow([*np.repeat(rng.uniform(0, 15000, 2 * seconds), 3)], 150)
    assert rig.status.flags & ~Flag.INLET_OPEN == 0
    rig.open(8)
    rig.follow(sine, 67, 8)
    assert rig.status.flags & ~Flag.INLET_OPEN == 0
    rig.open(9)
    rig.follow([15000] * seconds, 1000, 9)
    assert rig.status.flags & ~Flag.INLET_OPEN == 0
    assert rig.peak_pa < 15500
    rig.close()
