"""Controllers that answer lines of text: `P 8.00` with `8.02`; docs/reference/pressure_protocol.md."""

import re

from lerobot_robot_pneutac.hardware.pressure_limits import positive
from lerobot_robot_pneutac.hardware.serial_pressure import Command, SerialPressure

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
    """A rig that answers each line `P <kPa>` with the measured pressure.

    Nothing here proves that a command arrived whole, and whether the chamber is vented when the lines stop is
    up to the rig: docs/reference/pressure_protocol.md says what to build in.

    Args:
        port: serial port, such as /dev/serial/by-id/usb-...
        max_kpa: the highest set-point; a rig of this kind does not report it.
        baud: of the port.
        reconnect_s: how long a silent rig is waited for; a board that restarts takes about 2 s.
    """

    def __init__(self, port: str, max_kpa: float, baud: int = 115200, reconnect_s: float = 3.0):
        limit = positive("max_kpa", max_kpa)
        super().__init__(port, lambda: TextExchange(limit), baud, reconnect_s)
