"""Frames, and host and firmware talking over a bad line in simulated time."""

import random
from pathlib import Path

import pytest
from pressure_rig import SimulatedTime, converse

from lerobot_robot_pneutac.hardware import pneutac_serial as wire
from lerobot_robot_pneutac.hardware.pneutac_serial import Flag, Frame, FrameReader, PneutacExchange
from lerobot_robot_pneutac.hardware.serial_pressure import STALE_S, Command

NOTHING = Command(None, 0)


@pytest.fixture
def rig(program):
    rig = SimulatedTime(program)
    yield rig
    rig.close()


def random_frame(rng):
    payload = bytes(rng.choices([0, 1, 255, rng.randrange(256)], k=rng.randrange(wire.MAX_PAYLOAD + 1)))
    return Frame(rng.randrange(256), rng.randrange(65536), rng.randrange(65536), payload)


def test_a_frame_looks_on_the_wire_as_the_document_says():
    document = Path(__file__).parents[3] / "docs" / "reference" / "pressure_protocol.md"
    assert wire.set_point(0x1234, 5, 8000).hex(" ").upper() in document.read_text()


def test_every_frame_survives_the_wire_cut_into_any_pieces():
    rng = random.Random(0)
    frames = [random_frame(rng) for _ in range(300)]
    stream, reader, read = b"".join(map(wire.encode, frames)), FrameReader(), []
    while stream:
        n = rng.randrange(1, 30)
        read += reader.feed(stream[:n])
        stream = stream[n:]
    assert read == frames
    assert reader.bad == 0


def test_no_single_or_double_bit_error_makes_another_frame():
    whole = wire.set_point(7, 1, 8000)
    bits = 8 * len(whole)
    for i in range(bits):
        for j in range(i, bits):
            data = bytearray(whole)
            for bit in {i, j}:
                data[bit // 8] ^= 1 << bit % 8
            assert FrameReader().feed(bytes(data)) in ([], [Frame(2, 7, 1, (8000).to_bytes(4, "little"))])


def test_an_endless_line_without_a_frame_takes_no_memory_and_ends_at_the_next_frame():
    reader = FrameReader()
    for _ in range(1000):
        assert reader.feed(b"\x11" * 1000) == []
    assert len(reader._rest) < 100
    frame = Frame(4, 7, 1)
    assert reader.feed(wire.encode(frame)) == [frame]
    assert reader.bad == 1


def test_the_firmware_counts_a_doubled_and_a_late_set_point_once(rig):
    hello = rig.open()
    first, second = wire.set_point(7, 1, 5000), wire.set_point(7, 2, 8000)
    rig.send(first * 3 + second * 2 + first)
    rig.beat(40)
    assert (rig.status.applied, rig.status.repeated, rig.status.target_pa) == (2, 4, 8000)
    rig.send(wire.vent(7, 3) + second)
    rig.beat(40)
    assert (rig.status.applied, rig.status.repeated) == (2, 5)
    assert Flag.VENTED in rig.status.flags
    rig.send(hello + first)  # a double of the hello lets nothing in again either
    rig.beat(40)
    assert (rig.status.applied, rig.status.repeated) == (2, 6)


def test_the_firmware_applies_nothing_out_of_random_bytes_and_recovers(rig):
    rng = random.Random(1)
    rig.open()
    rig.send(wire.set_point(7, 1, 5000))
    for _ in range(100):
        rig.send(rng.randbytes(1000))
        rig.send(wire.heartbeat(7, rig.now_ms + 1))
        rig.run(20)
    assert (rig.status.applied, rig.status.command, rig.status.target_pa) == (1, 1, 5000)
    assert rig.status.bad > 300
    rig.send(b"\0" + wire.set_point(7, 2, 6000))
    rig.run(20)
    assert (rig.status.applied, rig.status.target_pa) == (2, 6000)


class BadLine:
    """Loses, doubles, cuts, delays and damages chunks of bytes."""

    def __init__(self, seed, rate):
        self.rng, self.rate, self.late = random.Random(seed), rate, b""

    def __call__(self, data):
        data, self.late = self.late + data, b""
        if not data or self.rng.random() > self.rate:
            return data
        kind, at = self.rng.randrange(5), self.rng.randrange(len(data))
        if kind == 0:
            return b""
        if kind == 1:
            return data + data
        if kind == 2:
            self.late = data[at:]
            return data[:at]
        if kind == 3:
            self.late = data
            return b""
        return data[:at] + self.rng.randbytes(1) + data[at + 1 :]


@pytest.mark.parametrize("seed", range(2))
def test_over_a_bad_line_each_command_is_applied_once_and_no_other(rig, seed):
    exchange, lines = PneutacExchange(), (BadLine(seed, 0.1), BadLine(seed + 100, 0.1))
    converse(rig, exchange, 200)
    session, targets = exchange._session, []
    for number in range(1, 41):
        kpa = 2 + number % 10
        converse(rig, exchange, 100, Command(kpa, number), *lines)
        targets.append(rig.status.target_pa)
    converse(rig, exchange, 500, Command(kpa, number))
    assert exchange.fault is None
    assert exchange._session == session, "the line was so bad that the heartbeat was lost"
    assert rig.status.repeated + rig.status.bad > 10
    assert rig.status.applied == 40
    assert targets == [1000 * (2 + n % 10) for n in range(1, 41)]
    assert exchange.measured_kpa == pytest.approx(kpa, abs=0.15)


def test_the_age_of_a_measurement_is_never_understated(rig):
    exchange, queue = PneutacExchange(), []
    for _ in range(200):  # statuses arrive 50 ms late
        now_s = rig.now_ms / 1000
        rig.send(exchange.transmit(now_s, NOTHING))
        queue.append(rig.run(5))
        if len(queue) > 10:
            exchange.receive(queue.pop(0), now_s + 0.005)
    age_s = rig.now_ms / 1000 - exchange.measured_s
    assert 0.05 <= age_s <= 0.05 + 0.035


def test_a_silent_controller_makes_the_measurement_old_and_a_new_session(rig):
    exchange = PneutacExchange()
    converse(rig, exchange, 200, Command(5.0, 1))
    session, measured_s = exchange._session, exchange.measured_s
    converse(rig, exchange, int(1000 * STALE_S) + 50, Command(5.0, 1), to_host=lambda data: b"")
    assert exchange.measured_s == measured_s
    assert exchange._session != session
    converse(rig, exchange, 300, Command(5.0, 1))
    assert exchange.fault is None and rig.status.applied == 0, "a set-point from before the loss came again"
    converse(rig, exchange, 500, Command(5.0, 2))
    assert rig.status.applied == 1
    assert exchange.measured_kpa == pytest.approx(5.0, abs=0.15)


def test_numbers_that_begin_anew_at_zero_end_no_session(rig):
    exchange, n = PneutacExchange(), 0

    def control(ms):
        nonlocal n
        for _ in range(0, ms, 50):
            n += 1
            converse(rig, exchange, 50, Command(4.0 + n % 3, n))

    control(500)
    session = exchange._session
    for number in (30000, 60000, 65500):  # no step of more than half the range is newer
        exchange._beat = exchange._sequence = number
        control(300)
    applied = rig.status.applied
    control(2500)  # 125 heartbeats and 50 commands: both pass zero
    assert exchange._beat < 200 and exchange._sequence < 200
    assert exchange._session == session and exchange.fault is None
    assert rig.status.applied - applied >= 49
    assert rig.now_ms / 1000 - exchange.measured_s < 0.05


def test_a_fault_that_arose_while_unplugged_is_not_hidden(program):
    rig = SimulatedTime(program, "--stick-inlet", 0, "--fault-at-s", 0.3)
    try:
        exchange = PneutacExchange()
        converse(rig, exchange, 300, Command(1.0, 1))
        converse(rig, exchange, 800, Command(8.0, 2))
        assert "does not follow" in exchange.fault
        exchange.restart()
        exchange.fault = None
        converse(rig, exchange, 100, Command(8.0, 2))
        assert "does not follow" in exchange.fault
    finally:
        rig.close()


def test_versions_that_differ_are_named():
    exchange = PneutacExchange()
    exchange.transmit(0.0, NOTHING)
    exchange.receive(wire.encode(Frame(wire.Type.HELLO_REPLY, 0, 0, bytes([3] + 16 * [0]))), 0.01)
    assert "version 3" in exchange.fault and "version 2" in exchange.fault
