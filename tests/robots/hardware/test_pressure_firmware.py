"""The firmware's safety in simulated time: every number here is exact and the same on every computer.

One sensor that lies, on a supply of 40 kPa: how high the true pressure comes, in simulated time.
"""

import math
import shutil
import subprocess

import numpy as np
import pytest
from pressure_rig import FIRMWARE, SimulatedTime

from lerobot_robot_pneutac.hardware import pneutac_serial as wire
from lerobot_robot_pneutac.hardware.pneutac_serial import Flag


def at_8_kpa(rig, ms=1000):
    rig.send(wire.set_point(7, 1, 8000))
    rig.beat(ms)
    return rig


@pytest.mark.parametrize("kpa", [2, 8, 15])
@pytest.mark.parametrize("leak", [0, 1])
def test_the_pressure_settles_on_the_target_without_overshoot(start, kpa, leak):
    rig = start("--leak-per-s", leak)
    rig.send(wire.set_point(7, 1, kpa * 1000))
    rig.beat(2000)
    true_pa = [step[1] for step in rig.trace]
    assert max(true_pa) < kpa * 1000 + 75  # 0.5 % of the range
    assert all(abs(p - kpa * 1000) < 150 for p in true_pa[1000:])
    assert rig.status.flags & ~Flag.INLET_OPEN == 0


def test_the_target_moves_no_faster_than_the_stated_rate(start):
    rig = start()
    rig.send(wire.set_point(7, 1, 15000))
    rig.beat(400)
    true_pa = [step[1] for step in rig.trace]
    fastest = max(b - a for a, b in zip(true_pa, true_pa[20:], strict=False)) / 0.02
    assert fastest < 1.15 * 50000


@pytest.mark.parametrize("phase_ms", (0, 7, 19))
def test_the_vent_opens_within_100_ms_of_the_last_heartbeat(start, phase_ms):
    rig = at_8_kpa(start())
    rig.run(phase_ms)
    rig.send(wire.heartbeat(7, 30000))
    last_ms = rig.now_ms
    rig.run(150)
    opened_ms = next(step[0] for step in rig.trace if step[0] > last_ms and step[4] == 1 and step[3] == 0)
    assert opened_ms - last_ms == 80
    rig.run(500)
    assert rig.trace[-1][1] < 100
    assert Flag.HEARTBEAT_LOST | Flag.VENTED in rig.status.flags


def test_a_repeated_heartbeat_is_no_sign_of_life(start):
    rig = at_8_kpa(start())
    for _ in range(6):
        rig.send(wire.heartbeat(7, 50))
        rig.run(20)
    assert Flag.HEARTBEAT_LOST | Flag.VENTED in rig.status.flags


def test_after_a_lost_heartbeat_nothing_of_the_old_session_counts(start):
    rig = at_8_kpa(start())
    rig.run(100)
    rig.send(wire.set_point(7, 2, 8000))
    rig.send(wire.heartbeat(7, 30000))
    rig.run(500)
    assert rig.trace[-1][1] < 100
    assert rig.status.applied == 1
    rig.open(session=9)
    rig.send(wire.set_point(7, 3, 8000))
    rig.run(40)
    assert rig.status.applied == 0


def test_above_the_cut_off_the_chamber_is_vented_at_once_and_stays_so(start):
    rig = at_8_kpa(start("--stick-inlet", 1, "--fault-at-s", 0.5, "--stick-vent", 0), 800)
    over_ms = next(step[0] for step in rig.trace if step[2] > 16500)
    assert all(step[3] == 0 and step[4] == 1 for step in rig.trace if step[0] >= over_ms)
    assert Flag.OVER_PRESSURE in rig.status.flags
    rig.send(wire.set_point(7, 2, 1000))
    rig.beat(40)
    assert Flag.REFUSED in rig.status.flags
    assert rig.status.applied == 1


@pytest.mark.parametrize(
    "options, flag",
    [
        (("--stick-inlet", 0), Flag.STUCK_VALVE),
        (("--stick-inlet", 1, "--fault-at-s", 0.6), Flag.STUCK_VALVE),
        (("--burst", "--fault-at-s", 0.6), Flag.BURST_LINE),
        (("--freeze-sensor", "--fault-at-s", 0.1), Flag.SENSOR_FAULT),
        (("--loose-sensor", "--fault-at-s", 0.3), Flag.SENSOR_FAULT),
    ],
)
def test_a_broken_part_is_reported_and_the_chamber_vented(start, options, flag):
    rig = at_8_kpa(start(*options), 1500)
    assert flag | Flag.VENTED in rig.status.flags
    assert rig.trace[-1][3:] == (0, 1)


def test_a_vent_valve_that_sticks_is_reported_when_it_is_needed(start):
    rig = at_8_kpa(start("--stick-vent", 0))
    assert rig.status.flags & ~Flag.INLET_OPEN == 0
    rig.send(wire.set_point(7, 2, 2000))
    rig.beat(1000)
    assert Flag.STUCK_VALVE in rig.status.flags


def test_a_wire_that_is_loose_from_the_start_never_opens_the_inlet(start):
    rig = at_8_kpa(start("--loose-sensor"))
    assert all(step[3] == 0 for step in rig.trace)
    assert rig.status.flags == Flag.SENSOR_FAULT | Flag.REFUSED | Flag.VENTED


def test_hellos_of_another_time_are_answered_and_change_nothing(start):
    """A recording of a whole session, and a guessed nonce."""
    rig = start()
    old = rig.open(session=9) + wire.heartbeat(9, 1) + wire.set_point(9, 1, 9000)
    rig.open(session=7)
    rig.send(wire.heartbeat(7, 1) + wire.set_point(7, 1, 4000))
    rig.run(20)
    nonce = rig.reply.nonce
    for frames in (old, wire.hello(9, True, nonce ^ 1), wire.hello(9, True, 0), wire.hello(0, True, nonce)):
        rig.send(frames)
        rig.run(15)
    assert (rig.status.target_pa, rig.status.applied) == (4000, 1)
    assert rig.reply.nonce == nonce
    assert rig.frames[-1].session == 7 and Flag.VENTED not in rig.status.flags


def test_no_nonce_comes_twice_in_a_run_and_each_power_on_has_its_own(start, program):
    rig, nonces = start("--seed", 1), set()
    for session in range(1, 51):
        rig.open(session)
        nonces.add(rig.reply.nonce)
    assert len(nonces) == 50 and 0 not in nonces
    assert start("--seed", 2).reply.nonce not in nonces


def test_a_hello_whose_answer_was_lost_is_answered_again(start):
    rig = start()
    hello = rig.open(session=9)
    rig.frames.clear()
    rig.send(wire.heartbeat(9, 1) + wire.set_point(9, 1, 4000) + hello)
    rig.run(20)
    assert rig.frames[0].session == 9 and wire.read_hello_reply(rig.frames[0])
    assert rig.status.applied == 1


def test_another_version_gets_an_answer_but_no_session(start):
    rig = start()
    rig.frames.clear()
    rig.send(wire.encode(wire.Frame(wire.Type.HELLO, 8, 0, bytes([99, 1, 0, 0, 0, 0]))))
    rig.send(wire.set_point(8, 1, 5000))
    rig.run(20)
    assert wire.read_hello_reply(rig.frames[0]).version == wire.VERSION
    assert rig.status.applied == 0


def test_it_compiles_as_for_an_uno(tmp_path, program):
    """`program` skips where no compiler is there."""
    compiler = shutil.which("g++") or shutil.which("clang++")
    folder, stub = FIRMWARE / "pressure_controller", FIRMWARE / "board_stub"
    for source in folder.iterdir():
        if source.suffix in (".ino", ".cpp"):
            flags = ["-std=c++11", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", "-x", "c++"]
            for board in ([], ["-D__AVR__"]):
                include = ["-I", stub, "-include", stub / "Arduino.h"]
                subprocess.run([compiler, *flags, *board, *include, source], check=True)


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


def test_a_frozen_sensor_overfills_by_no_more_than_60_ms_of_air(start):
    rig = at_8_kpa(start("--freeze-sensor", "--fault-at-s", 0.1))
    assert max(step[1] for step in rig.trace) < 8000 + 0.06 * 40000 / 0.25
