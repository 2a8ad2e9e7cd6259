"""The firmware's own core, built here, on a simulated chamber: in simulated time or on a pseudo-terminal."""

import os
import shutil
import subprocess
import time
import zlib
from contextlib import contextmanager
from pathlib import Path

import pytest
from awake import awake_s, until
from filelock import FileLock

from lerobot_robot_pneutac.hardware import pneutac_serial as wire
from lerobot_robot_pneutac.hardware.parts import HardwareFault
from lerobot_robot_pneutac.hardware.serial_pressure import Command

FIRMWARE = Path(__file__).parents[2] / "firmware"


def build(name="pressure_sim", *options):
    """A program of the firmware's Makefile, built once in a run; skips where there is no compiler."""
    compiler = shutil.which("g++") or shutil.which("clang++")
    if compiler is None or shutil.which("make") is None:
        pytest.skip("building the firmware's simulator needs make and a C++ compiler")
    folder = Path(os.environ["PNEUTAC_TEST_RECORDINGS"]) / f"firmware_{zlib.crc32(repr(options).encode()):x}"
    make = ["make", "-s", "-C", FIRMWARE, f"BUILD={folder}", f"CXX={compiler}", *options]
    with FileLock(f"{folder}.lock"):
        subprocess.run([*make, str(folder / name)], check=True)
    return folder / name


class SimulatedTime:
    """The firmware stepped by 1 ms at a time.

    Attributes:
        trace: per step (ms, true Pa, reading Pa, commanded inlet, commanded vent).
        frames: all that it sent.
        now_ms: its clock.
        peak_pa: the highest true pressure so far.
        exit_code: once closed.
    """

    def __init__(self, program, *options):
        self._process = subprocess.Popen(
            [program, *map(str, options)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self._reader = wire.FrameReader()
        self.trace, self.frames, self.now_ms, self.peak_pa = [], [], 0, 0.0

    def send(self, data):
        if data:
            self.send_line(f"rx {data.hex()}")

    def send_line(self, line):
        """A line of the program's own."""
        self._process.stdin.write(line + "\n")

    def run(self, ms):
        """Runs on; returns the bytes that it sent meanwhile."""
        self._process.stdin.write(f"run {ms}\n")
        self.now_ms += ms
        return self._answer()

    def skip(self, ms):
        """Runs on without a trace."""
        self._process.stdin.write(f"pass {ms}\n")
        self.now_ms += ms
        return self._answer()

    def see(self, *readings_pa):
        """A step of 1 ms with each of these readings in place of the chamber's."""
        for pa in readings_pa:
            self._process.stdin.write(f"see {pa}\n")
            self.now_ms += 1
            self._answer()

    def stall(self, ms):
        """No step for so long."""
        self.send_line(f"wait {ms}")
        self.now_ms += ms
        self._answer()

    def _answer(self):
        self._process.stdin.flush()
        sent = b""
        while (words := self._process.stdout.readline().split())[0] != "done":
            if words[0] == "tx":
                sent += bytes.fromhex(words[1])
            else:
                self.trace.append(tuple(map(float, words[1:])))
        self.peak_pa = float(words[1])
        self.frames += self._reader.feed(sent)
        return sent

    def beat(self, ms, session=7):
        """Runs on with a heartbeat every 20 ms."""
        for _ in range(0, ms, 20):
            self.send(wire.heartbeat(session, self.now_ms // 20 + 1))
            self.run(20)

    def follow(self, targets_pa, every_ms, session=7):
        """Set-points one after another with heartbeats between, without a trace."""
        for number, pa in enumerate(targets_pa, 1):
            self.send(wire.set_point(session, number, round(pa)))
            for _ in range(0, every_ms, 50):
                self.send(wire.heartbeat(session, self.now_ms // 20 + 1))
                self.skip(min(every_ms, 50))

    def open(self, session=7, clear_faults=True):
        """Asks for the nonce and opens a session with it; returns the hello that did."""
        self._ask(wire.hello(session, clear_faults, 0))
        hello = wire.hello(session, clear_faults, self.reply.nonce)
        self._ask(hello)
        return hello

    def _ask(self, hello):
        before = len(self.replies)
        self.send(hello)
        for _ in range(10):
            if len(self.replies) == before:
                self.run(1)

    @property
    def replies(self):
        return [r for r in map(wire.read_hello_reply, self.frames) if r]

    @property
    def reply(self):
        return self.replies[-1]

    @property
    def status(self):
        return [s for s in map(wire.read_status, self.frames) if s][-1]

    def close(self):
        self._process.stdin.close()
        self.exit_code = self._process.wait(timeout=120)
        self._process.stdout.close()


def converse(rig, exchange, ms, command=None, to_rig=bytes, to_host=bytes):
    """Host and firmware on one simulated clock; `to_rig` and `to_host` change bytes on their way."""
    command = command or Command(None, 0)
    for _ in range(0, ms, 5):
        now_s = rig.now_ms / 1000
        rig.send(to_rig(exchange.transmit(now_s, command)))
        exchange.receive(to_host(rig.run(5)), now_s + 0.005)


@contextmanager
def terminal(program, link, *options):
    """The firmware in real time behind the link; unplugged on leaving."""
    process = subprocess.Popen([program, "--pty", link, *map(str, options)])
    try:
        assert until(lambda: link.exists(), 5)
        yield process
    finally:
        process.kill()
        process.wait()
        link.unlink(missing_ok=True)


@contextmanager
def connected(controller):
    controller.connect()
    try:
        yield controller
    finally:
        controller.disconnect()


def reaches(controller, kpa, timeout_s=5.0, within=0.3):
    """Whether the pressure gets there, the set-point repeated as a control loop does.

    A reading that is too old is waited for: this computer may stall for longer than a real line would.
    """

    def there():
        try:
            controller.set_pressure(kpa)
            return abs(controller.pressure() - kpa) < within
        except HardwareFault as e:
            assert " s old" in str(e)
            return False

    return until(there, timeout_s)


def raised_by(controller, kpa, timeout_s=5.0):
    """The final fault of a control loop, past readings that are merely too old."""
    end_s = awake_s() + timeout_s
    while awake_s() < end_s:
        try:
            controller.set_pressure(kpa)
            controller.pressure()
        except HardwareFault as e:
            if " s old" not in str(e):
                return str(e)
        time.sleep(0.01)
    return ""


def raises_old(controller):
    try:
        controller.pressure()
    except HardwareFault as e:
        assert " s old; check cable and power" in str(e)
        return True
    return False
