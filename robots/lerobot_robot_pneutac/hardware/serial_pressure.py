"""Pressure controllers at a serial port: the thread that owns the port, limits and ages; lines of text.

A controller that answers lines of text gets `P 8.00` and sends `8.02`; docs/reference/pressure_protocol.md.
"""

import logging
import math
import re
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import serial

from lerobot_robot_pneutac.hardware.parts import COMMAND_S, HardwareFault, wait
from lerobot_robot_pneutac.hardware.pressure_limits import checked_kpa, positive

STALE_S = 0.2  # a measured pressure older than this is none
STALL_S = 0.1  # a turn of the port's thread that took longer: a busy computer, not a silent controller
BUSY_S = 0.6  # a measurement is waited for until the newest is so old, where the computer was busy
POLL_S = 0.005
REOPEN_S = 0.05
FAREWELL_S = 0.06  # on disconnecting: long enough to repeat a lost vent twice

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Command:
    """What the caller wants."""

    target_kpa: float | None  # the set-point; None to vent
    number: int  # counts calls; the same number is the same command


class Exchange(Protocol):
    """A protocol's host side without its port, so that it runs on any clock."""

    measured_kpa: float | None  # the newest measured pressure; None before the first
    measured_s: float  # a time before which that pressure was not measured
    max_kpa: float | None  # the highest set-point; None before the controller reported it
    fault: str | None  # why the controller is of no use any more; None while it is

    def restart(self) -> None:
        """The port was opened again: forget what was under way, and never send an old command again."""

    def transmit(self, now_s: float, command: Command) -> bytes:
        """The bytes to send now."""

    def receive(self, data: bytes, now_s: float) -> None:
        """Processes received bytes."""


class SerialPressure:
    """A pressure controller behind an `Exchange`. One thread owns the port.

    A set-point is void `COMMAND_S` after its call, and the chamber is vented: a caller that hangs keeps no
    pressure. A lost port is opened again for `reconnect_s`; the chamber stays vented until the next
    set-point.

    Attributes:
        port: the serial port's name; a link in /dev/serial/by-id keeps its name when replugged.
        reconnect_s: how long a silent controller is waited for, at connecting and after a loss.
    """

    def __init__(self, port: str, make_exchange: Callable[[], Exchange], baud: int, reconnect_s: float):
        self.port = port
        self.reconnect_s = positive("reconnect_s", reconnect_s)
        self._make_exchange = make_exchange
        self._exchange = make_exchange()
        self._baud = int(positive("baud", baud))
        self._lock = threading.Lock()
        self._command = Command(None, 0)
        self._commanded_s = 0.0
        self._fault: str | None = None
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._turn_s = 0.0  # when the thread last had its turn
        self._alive_s = 0.0  # when it last heard something, or went on after a stall

    @property
    def max_kpa(self) -> float:
        """The highest set-point; raises HardwareFault before `connect`."""
        self._check_running()
        return self._exchange.max_kpa

    def connect(self) -> None:
        """Opens the port and waits for the first measurement; the chamber stays vented."""
        if self._thread:
            raise HardwareFault(f"{self} is connected already; disconnect it first.")
        self._exchange = self._make_exchange()
        self._fault = None
        self._stop.clear()
        self.vent()
        self._thread = threading.Thread(target=self._run, name=f"pressure {self.port}", daemon=True)
        self._thread.start()
        wait(lambda: self._exchange.measured_kpa is not None or not self._thread.is_alive(), math.inf, POLL_S)
        if self._fault:
            fault = self._fault
            self.disconnect()
            raise HardwareFault(fault)

    def set_pressure(self, kpa: float) -> None:
        """Sets the target in kPa; returns at once.

        Raises:
            InputError: the target is not finite or outside 0 ... `max_kpa`.
            HardwareFault: the controller reported a fault or is lost.
        """
        wait(self._fresh, math.inf, POLL_S)
        target = checked_kpa(kpa, self.max_kpa)
        with self._lock:
            self._command = Command(target, self._command.number + 1)
            self._commanded_s = time.monotonic()

    def pressure(self) -> float:
        """The newest measured pressure in kPa, at most `STALE_S` old.

        Where this computer was held up, or a new session is being opened, the next one is waited for.

        Raises HardwareFault: the controller was silent for `STALE_S`, or there is none after `BUSY_S`.
        """
        wait(self._fresh, math.inf, POLL_S)
        return self._exchange.measured_kpa

    def vent(self) -> None:
        """Opens the chamber to the room; never raises."""
        with self._lock:
            self._command = Command(None, self._command.number + 1)

    def disconnect(self) -> None:
        self.vent()
        self._stop.set()
        if self._thread:
            self._thread.join()
        self._thread = None

    def __str__(self) -> str:
        return f"Pressure controller at {self.port}"

    def _check_running(self) -> None:
        if self._fault:
            raise HardwareFault(self._fault)
        if not self._thread:
            raise HardwareFault(f"{self} is not connected; call connect first.")

    def _fresh(self) -> bool:
        """Whether the measurement is young enough; raises HardwareFault where none will come."""
        self._check_running()
        now, measured_s = time.monotonic(), self._exchange.measured_s
        if now - measured_s <= STALE_S:
            return True
        silent = now - max(measured_s, self._alive_s) > STALE_S and now - self._turn_s <= STALL_S
        if silent or now - measured_s > BUSY_S:
            raise HardwareFault(
                f"{self}: the newest measurement is {now - measured_s:.2f} s old; check cable and power."
            )
        return False

    def _take_turn(self, heard: bool = False) -> None:
        """The port's thread runs, and may have heard something."""
        now = time.monotonic()
        if heard or now - self._turn_s > STALL_S:
            self._alive_s = now
        self._turn_s = now

    def _current(self, now_s: float) -> Command:
        with self._lock:
            if self._command.target_kpa is not None and now_s - self._commanded_s > COMMAND_S:
                self._command = Command(None, self._command.number + 1)
            return self._command

    def _run(self) -> None:
        lost_s = time.monotonic()
        reason = ""
        while not self._stop.is_set():
            self._take_turn()
            # Without `exclusive` a second program at the port would eat half of the answers.
            how = {"timeout": POLL_S, "write_timeout": STALE_S, "exclusive": True}
            try:
                with serial.Serial(self.port, self._baud, **how) as port:
                    self._exchange.restart()
                    self._talk(port, lost_s)
                    return
            except Exception as e:  # mostly OSError; pyserial also lets termios' own through
                if str(e) != reason:
                    logger.warning("%s: %s; opening the port again.", self, e)
                reason = str(e)
            if self._exchange.measured_kpa is None:
                self._fault = f"{self} cannot be used ({reason}); check cable, power and the port's name."
                return
            lost_s = max(lost_s, self._exchange.measured_s)
            if time.monotonic() - lost_s > self.reconnect_s:
                self._fail_lost(reason)
                return
            self._stop.wait(REOPEN_S)

    def _talk(self, port: serial.Serial, lost_s: float) -> None:
        end_s = None
        while end_s is None or time.monotonic() < end_s:
            now = time.monotonic()
            out = self._exchange.transmit(now, self._current(now))
            if out:
                port.write(out)
            data = port.read(max(1, port.in_waiting))
            self._exchange.receive(data, time.monotonic())
            self._take_turn(heard=bool(data))
            if self._exchange.fault:
                self._fault = f"{self}: {self._exchange.fault}."
                return
            if now - max(lost_s, self._exchange.measured_s) > self.reconnect_s:
                self._fail_lost("it does not answer")
                return
            if end_s is None and self._stop.is_set():
                end_s = now + FAREWELL_S

    def _fail_lost(self, reason: str) -> None:
        self._fault = (
            f"{self} was lost for {self.reconnect_s:g} s ({reason}); check cable and power, then reconnect."
        )


PERIOD_S = 0.05
ANSWER_S = 0.1
MAX_LINE = 32
_NUMBER = re.compile(rb"[+-]?\d{1,4}(\.\d{1,6})?")


class TextExchange:
    """Asks every 50 ms, one question at a time; the repeated set-point is the heartbeat.

    Attributes:
        measured_kpa: see `Exchange`; so are `measured_s`, `max_kpa` and `fault`.
    """

    def __init__(self, max_kpa: float):
        self.measured_kpa: float | None = None
        self.measured_s = 0.0
        self.max_kpa = max_kpa
        self.fault: str | None = None
        self.restart()

    def restart(self) -> None:
        """Drops half a line, and every set-point from before the loss."""
        self._void: int | None = None  # commands up to this number were given before
        self._rest = b""
        self._asked_s: float | None = None  # when the oldest question without an answer was sent
        self._next_s = 0.0
        self._filling = False  # whether the newest line was a set-point

    def transmit(self, now_s: float, command: Command) -> bytes:
        """The set-point's line, where it is due; a vent does not wait for the answer to a set-point."""
        if self._void is None:
            self._void = command.number
        void = command.target_kpa is None or command.number <= self._void
        if now_s < self._next_s and not (void and self._filling):
            return b""
        self._next_s = now_s + ANSWER_S
        self._filling = not void
        if self._asked_s is None:
            self._asked_s = now_s
        return f"P {0.0 if void else command.target_kpa:.2f}\n".encode()

    def receive(self, data: bytes, now_s: float) -> None:
        """Takes whole lines that are a plausible pressure."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        self._rest = self._rest[: MAX_LINE + 1]
        for line in lines:
            if self._asked_s is None or not _NUMBER.fullmatch(line.strip()):
                continue
            kpa = float(line)
            if not -self.max_kpa / 2 <= kpa <= 4 * self.max_kpa:
                continue
            self.measured_kpa = kpa
            self.measured_s = self._asked_s
            self._next_s = self._asked_s + PERIOD_S
            self._asked_s = None


class TextSerial(SerialPressure):
    """A rig that answers each line `P <kPa>` with the measured pressure; options as of `PneutacSerial`.

    Nothing here proves that a command arrived whole, and whether the chamber is vented when the lines stop is
    up to the rig: docs/reference/pressure_protocol.md says what to build in. It does not report `max_kpa`.
    """

    def __init__(self, port: str, max_kpa: float, baud: int = 115200, reconnect_s: float = 3.0):
        limit = positive("max_kpa", max_kpa)
        super().__init__(port, lambda: TextExchange(limit), baud, reconnect_s)
