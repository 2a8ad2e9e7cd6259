"""The firmware to the number: every byte of its answers, every threshold, and its control law once more."""

import struct
from functools import partial

import numpy as np
import pytest

from lerobot_robot_pneutac.hardware import pneutac_serial as wire
from lerobot_robot_pneutac.hardware.pneutac_serial import Flag, Frame, Type


@pytest.fixture
def start(start):
    """Of one power-on, and without noise."""
    return partial(start, "--seed", 1, "--noise-pa", 0)


def see(rig, readings_pa):
    """Steps with these readings and heartbeats between; where the chamber was vented first, None if never."""
    begin = len(rig.trace)
    for k, pa in enumerate(readings_pa):
        if k % 20 == 0:
            rig.send(wire.heartbeat(7, rig.now_ms + 1))
        rig.see(round(pa))
    vented = [k for k, step in enumerate(rig.trace[begin:]) if step[3:] == (0, 1)]
    return vented[0] if vented else None


def noisy(pa, steps):
    """A constant with one Pa of life in it."""
    return [pa + k % 2 for k in range(steps)]


def flags(rig):
    """Ten more steps with the last reading, and what the status says then."""
    see(rig, [rig.trace[-1][2]] * 10)
    return rig.status.flags


# ---------------------------------------------------------------- bytes


def test_every_byte_of_a_status(start):
    rig = start()
    rig.send(wire.heartbeat(7, 0x0102) + wire.set_point(7, 0x0304, 1000) + wire.set_point(7, 0x0305, 8000))
    rig.send(wire.set_point(7, 0x0306, 9029) + wire.set_point(7, 0x0305, 1) + wire.heartbeat(7, 1))
    rig.send(b"\0\5\5\0" * 3 + bytes([0, *[9] * 60, 0, 0, 0]))
    rig.frames.clear()
    rig.see(*[-300] * 30)
    first, second, third = rig.frames
    assert [f.sequence - first.sequence for f in rig.frames] == [0, 1, 2]
    payload = struct.pack("<iiHHHHHH", -300, 9029, Flag.INLET_OPEN, 0x0102, 0x0306, 3, 2, 4)
    assert third == Frame(Type.STATUS, 7, third.sequence, payload)
    rig.send(wire.vent(7, 0x0307))
    rig.see(*[70000] * 10)
    flags = Flag.VENTED | Flag.OVER_PRESSURE | Flag.SENSOR_FAULT
    payload = struct.pack("<iiHHHHHH", 70000, 0, flags, 0x0102, 0x0307, 3, 2, 4)
    assert rig.frames[-1] == Frame(Type.STATUS, 7, third.sequence + 1, payload)


def test_a_status_comes_every_10_ms(start):
    rig = start()
    counts = []
    for _ in range(60):
        before = len(rig.frames)
        rig.see(0)
        counts.append(len(rig.frames) - before)
    at = [k for k, n in enumerate(counts) if n]
    assert sum(counts) == len(at) == 6 and set(np.diff(at)) == {10}


def test_frames_of_another_size_or_type_do_nothing(start):
    rig = start()
    rig.send(wire.heartbeat(7, 5) + wire.set_point(7, 5, 5000))
    for kind in (Type.SET_POINT, Type.VENT, Type.HEARTBEAT, 5, 0):
        for size in {Type.SET_POINT: (0, 3, 5), Type.VENT: (1, 4), Type.HEARTBEAT: (1, 4)}.get(kind, (0, 4)):
            rig.send(wire.encode(Frame(kind, 7, 6, bytes(size))))
    rig.see(*range(20))
    status = rig.status
    assert (status.beat, status.command, status.applied, status.repeated, status.bad) == (5, 5, 1, 0, 0)
    assert status.target_pa == 5000 and Flag.VENTED not in status.flags


# ---------------------------------------------------------------- sessions


def test_before_the_first_session_nothing_counts_and_no_heartbeat_is_missed(start):
    rig = start(session=None)
    rig.send(wire.set_point(0, 1, 5000) + wire.heartbeat(0, 1))
    rig.run(200)
    assert rig.status.flags == Flag.VENTED
    assert (rig.status.applied, rig.status.beat) == (0, 0)
    rig.open()
    rig.run(20)
    assert rig.status.flags == Flag.VENTED


@pytest.mark.parametrize(("steps", "faulty"), [(59, False), (60, True)])
def test_a_new_session_begins_all_numbers_and_times_at_zero(start, steps, faulty):
    rig = start()
    rig.send(wire.heartbeat(7, 3) * 2 + wire.set_point(7, 4, 99999))
    see(rig, noisy(8000, 20))
    rig.send(wire.set_point(7, 5, 10000))
    assert see(rig, [*noisy(8000, 20), *[8000] * 55]) is None  # nearly the 60 ms of a frozen reading
    rig.send(wire.hello(8, False, rig.reply.nonce))
    rig.see(*[8000] * steps, *noisy(8001, 20))
    status = rig.status
    assert (status.beat, status.command, status.applied, status.repeated) == (0, 0, 0, 0)
    assert status.flags == Flag.VENTED | (Flag.SENSOR_FAULT if faulty else 0)


def test_a_refused_set_point_is_told_until_a_good_one_and_0_and_the_highest_are_good(start):
    rig = start()
    for number, (pa, refused, target) in enumerate(
        [(15001, True, 0), (15000, False, 15000), (-1, True, 15000), (0, False, 0)], 1
    ):
        rig.send(wire.set_point(7, number, pa))
        see(rig, noisy(100, 10))
        assert (Flag.REFUSED in rig.status.flags, rig.status.target_pa) == (refused, target)
        assert Flag.VENTED in rig.status.flags or number > 1


# ---------------------------------------------------------------- the control law


class Law:
    """The firmware's control law, air account and rise check, with 1 ms a step; pressures in Pa."""

    def __init__(self, fill_s=0.25, vent_s=0.1, leak=0.0):
        self.fill_s, self.vent_s, self.leak = fill_s, vent_s, leak
        self.air = self.smooth = self.smooth_air = self.ramp = self.integral = self.target = 0.0
        self.rise_air = self.rise_pa = 0.0
        self.drive, self.controlling, self.fault, self.measured = -1.0, False, False, 0.0
        self.rise_ms = self.owed_ms = 0

    def set_point(self, pa):
        if not self.controlling:
            self.ramp, self.integral = float(np.clip(self.measured, 0, 15000)), 0.0
        self.controlling, self.target = True, pa

    def vent(self):
        self.controlling, self.drive = False, -1.0

    def step(self, pa):
        self.measured = pa
        if self.drive > 0:
            self.air += (40000 - self.air) * self.drive * 1e-3 / self.fill_s
        else:
            self.air += self.air * self.drive * 1e-3 / self.vent_s
        self.air -= self.air * self.leak * 1e-3
        self.smooth += (pa - self.smooth) * 0.02
        self.smooth_air += (self.air - self.smooth_air) * 0.02
        if self.controlling:
            self.ramp += np.clip(self.target - self.ramp, -50, 50)
            error, rate = self.ramp - pa, (pa - self.smooth) / 0.05
            if self.ramp == self.target and abs(rate) < 1050:
                self.integral = np.clip(self.integral + 8e-4 * error * 1e-3, -0.25, 0.25)
            self.drive = np.clip(4e-4 * error + self.integral, -1, 1)
        air = self.smooth_air - self.rise_air
        rises = air > 1050
        owed = rises and self.smooth - self.rise_pa < 0.25 * air
        self.owed_ms = self.owed_ms + 1 if owed else 0
        self.rise_ms += 1
        if not owed and (rises or air < 0 or self.rise_ms >= 500):
            self.rise_ms, self.rise_air, self.rise_pa = 0, self.smooth_air, self.smooth
        self.fault = self.fault or self.owed_ms >= 60 or self.air > 0.98 * 16500
        if self.fault:
            self.vent()


def play(rig, law, commands, reading, steps):
    """Both on one script: commands {step: Pa or None to vent}; `reading(law, step)` gives the sensor's.

    Returns:
        Step of the fault by the firmware and by the law, None where there is none.
    """
    for _ in range(rig.now_ms):
        law.step(0)
    begin, number, law_step = len(rig.trace), 0, None
    for k in range(steps):
        if k in commands:
            number += 1
            pa = commands[k]
            rig.send(wire.vent(7, number) if pa is None else wire.set_point(7, number, pa))
            law.vent() if pa is None else law.set_point(pa)
        if k % 20 == 0:
            rig.send(wire.heartbeat(7, k + 1))
        pa = round(reading(law, k))
        rig.see(pa)
        law.step(pa)
        if law.fault:
            law_step = k
            break
        inlet, vent = rig.trace[-1][3:]
        assert inlet - vent == pytest.approx(law.drive, abs=3e-4), f"step {k}"
    if law_step is not None:
        rig.see(pa, pa)  # the two count with other precision
    late = [k for k, step in enumerate(rig.trace[begin:]) if step[3:] == (0, 1) and k > max(commands)]
    return late[0] if late else None, law_step


def test_valves_follow_the_law(start):
    """Limits of the integral, readings that are settled and not, and a start at any pressure."""
    rng = np.random.default_rng(0)
    noise = rng.integers(-8, 9, 6000)
    commands = {0: 8000, 3600: None, 3700: 6000, 4100: None, 4150: 15000, 4300: None, 4400: 500}
    points = [
        (0, 0), (160, 8000), (161, 7700), (1600, 7700), (1601, 8000), (2600, 8970), (2601, 8000),
        (3599, 6880), (3600, 8400), (3700, 5000), (3750, 6000), (4000, 6200), (4100, 6000), (4101, 15600),
        (4149, 15600), (4150, 15500), (4300, 15200), (4301, -300),
    ]  # fmt: skip
    path = np.interp(np.arange(6000), *zip(*points, strict=True))
    rig = start("--leak-per-s", 200)
    assert play(rig, Law(leak=200), commands, lambda law, k: path[k] + noise[k], 4700) == (None, None)
    rig = start("--leak-per-s", 200)
    high = [300] * 3400
    assert play(rig, Law(leak=200), {0: 0}, lambda law, k: high[k] + noise[k], 1500) == (None, None)


def test_after_a_stall_the_first_reading_is_the_smoothed_one(start):
    rig = start("--leak-per-s", 200)
    see(rig, [8000] * 9)
    rig.send(wire.set_point(7, 1, 8000))
    see(rig, [8000] * 301)
    before = rig.trace[-1][3] - rig.trace[-1][4]
    rig.stall(70)
    see(rig, [7000])  # settled by that, so it goes into the integral
    assert rig.trace[-1][3] - before == pytest.approx(4e-4 * 1000 + 8e-4 * 1000 * 0.071, abs=2e-4)


@pytest.mark.parametrize("vent_ms", [0, 30])
def test_too_much_air_is_told_when_the_law_counts_it(start, vent_ms):
    rig = start("--fill-s", 0.2, "--vent-s", 0.08, "--leak-per-s", 2)
    commands = {0: 15000} | ({60: None, 60 + vent_ms: 15000} if vent_ms else {})
    told, law = play(rig, Law(0.2, 0.08, 2), commands, lambda law, k: 0.5 * law.air + k % 2, 600)
    assert law is not None and abs(told - law) <= 1
    assert flags(rig) == Flag.TOO_MUCH_AIR | Flag.VENTED


@pytest.mark.parametrize(
    ("answer", "target", "fault"),
    [(0.0, 8000, True), (0.22, 8000, True), (0.28, 8000, False), (0.0, 5020, True)],
)
def test_a_reading_that_does_not_rise_with_the_air_is_a_fault(start, answer, target, fault):
    rig = start()
    # Settled at 5 kPa, then the reading rises by a share of what the air does.
    commands = {300: target}
    told, law = play(rig, Law(), commands, lambda law, k: 5000 + answer * law.air + k % 2, 1500)
    assert (law is not None) == fault
    if fault:
        assert abs(told - law) <= 1
        assert flags(rig) == Flag.STUCK_VALVE | Flag.VENTED
    if target == 5020:
        assert law > 300 + 500  # slower than half a second is a leak that is made up for


def test_a_rise_counts_from_where_the_air_last_fell(start):
    rig = start()
    stuck = 900

    def reading(law, k):
        return (law.air if k < stuck else 4000) + k % 2

    told, law = play(rig, Law(), {0: 10000, 400: 4000, stuck: 9000}, reading, 1500)
    assert law is not None and abs(told - law) <= 1


# ---------------------------------------------------------------- thresholds


@pytest.mark.parametrize(
    ("pa", "flag"),
    [
        (16500, 0),
        (16501, Flag.OVER_PRESSURE),
        (60000, Flag.OVER_PRESSURE),
        (60004, Flag.OVER_PRESSURE | Flag.SENSOR_FAULT),
        (-1500, 0),
        (-1501, Flag.SENSOR_FAULT),
    ],
)
def test_limits_of_a_reading(start, pa, flag):
    rig = start()
    rig.see(pa)
    assert flags(rig) == flag | Flag.VENTED or pa < -1500


@pytest.mark.parametrize(("pa", "target"), [(6000, 8000), (8000, 5800), (500, 2000)])
def test_a_reading_that_stays_the_same_for_60_ms_while_air_flows_is_a_fault(start, pa, target):
    rig = start("--leak-per-s", 200)
    see(rig, noisy(pa, 50))
    begin = len(rig.trace)
    rig.send(wire.set_point(7, 1, target))
    see(rig, noisy(pa, 2))
    see(rig, [pa] * 150)
    drives = [step[3] - step[4] for step in rig.trace[begin:]]
    driven = next(k for k, drive in enumerate(drives) if abs(drive) > 0.3)
    faulty = next(k for k, drive in enumerate(drives) if k > driven and drive == -1)
    assert faulty - driven == 59
    assert flags(rig) == Flag.SENSOR_FAULT | Flag.VENTED


def test_a_reading_that_stays_the_same_while_no_air_flows_is_none(start):
    rig = start("--leak-per-s", 200)
    see(rig, noisy(7900, 50))
    rig.send(wire.set_point(7, 1, 8000))
    assert see(rig, [7900] * 300) is None
    rig.send(wire.vent(7, 2))
    see(rig, [1049] * 300)  # empty
    assert rig.status.flags == Flag.VENTED
    see(rig, [1050] * 60)
    assert flags(rig) == Flag.SENSOR_FAULT | Flag.VENTED


def vented_from(rig, pa):
    """A chamber that was at a pressure, and a vent command."""
    see(rig, noisy(pa, 5))
    rig.send(wire.set_point(7, 1, pa))
    see(rig, noisy(pa, 20))
    rig.send(wire.vent(7, 2))
    return rig


@pytest.mark.parametrize(("steps", "told"), [(499, False), (500, True)])
def test_a_chamber_that_does_not_empty_in_500_ms_is_told(start, steps, told):
    rig = vented_from(start(), 1051)
    see(rig, [*noisy(1051, steps), *[0] * 11])
    assert rig.status.flags == (Flag.STUCK_VALVE if told else 0) | Flag.VENTED


def test_a_chamber_that_is_nearly_empty_is_not_stuck(start):
    rig = vented_from(start(), 1048)
    see(rig, noisy(1048, 700))
    assert rig.status.flags == Flag.VENTED


@pytest.mark.parametrize(("fall", "told"), [(400, True), (520, True), (530, False), (900, False)])
def test_a_chamber_that_empties_by_a_thirtieth_of_the_range_in_half_a_second_is_slow_and_not_stuck(
    start, fall, told
):
    rig = vented_from(start(), 5000)
    see(rig, [5000 - fall * (k // 450) + k % 2 for k in range(1800)])
    assert (Flag.STUCK_VALVE in rig.status.flags) == told


@pytest.mark.parametrize(("rise", "told"), [(0, True), (400, True), (530, False), (900, False)])
def test_a_pressure_that_does_not_rise_in_500_ms_with_the_inlet_open_is_told(start, rise, told):
    rig = start("--leak-per-s", 200)
    see(rig, noisy(2000, 50))
    rig.send(wire.set_point(7, 1, 15000))
    begin = len(rig.trace)
    vented = see(rig, [2000 + rise * (k // 450) + k % 2 for k in range(1500)])
    assert (vented is not None) == told
    if rise == 0:
        full = next(k for k, step in enumerate(rig.trace[begin:]) if step[3] > 0.99)
        assert vented - full == 499
        assert flags(rig) == Flag.STUCK_VALVE | Flag.VENTED


def test_an_error_that_the_valves_work_on_is_not_stuck(start):
    rig = start("--leak-per-s", 200)
    see(rig, noisy(6000, 50))
    rig.send(wire.set_point(7, 1, 7200))
    assert see(rig, noisy(6000, 700)) is None
    rig.send(wire.set_point(7, 2, 4800))
    assert see(rig, noisy(6000, 700)) is None
    assert rig.status.flags & ~Flag.INLET_OPEN == 0


@pytest.mark.parametrize(("fall", "told"), [(1495, False), (1505, True)])
def test_a_tenth_of_the_range_lost_for_30_ms_while_filling_is_a_burst(start, fall, told):
    rig = start("--leak-per-s", 200)
    see(rig, noisy(8000, 50))
    rig.send(wire.set_point(7, 1, 10000))
    assert see(rig, [*noisy(8000, 100), *noisy(8000 - fall, 29)]) is None
    assert see(rig, noisy(8000 - fall, 40)) == (0 if told else None)
    assert (Flag.BURST_LINE in flags(rig)) == told


def test_no_valve_is_asked_for_more_than_all_of_it(start):
    rig = start("--leak-per-s", 200)
    see(rig, noisy(8000, 20))
    for number, target in enumerate((8000, 100, 15000, 15000)):
        rig.send(wire.set_point(7, number + 1, target))
        see(rig, noisy(8000, 100))
    drives = [step[3] - step[4] for step in rig.trace]
    assert (max(drives), min(drives)) == (1, -1) and rig.status.flags == Flag.INLET_OPEN


def test_pressure_that_was_let_out_is_no_burst(start):
    rig = start("--leak-per-s", 200)
    see(rig, noisy(10000, 50))
    rig.send(wire.set_point(7, 1, 10200))
    assert see(rig, noisy(10000, 60)) is None
    rig.send(wire.set_point(7, 2, 3000))
    assert see(rig, [10000 - 35 * k for k in range(200)]) is None
    rig.send(wire.set_point(7, 3, 5000))
    assert see(rig, noisy(3000, 100)) is None
    assert rig.status.flags == Flag.INLET_OPEN
