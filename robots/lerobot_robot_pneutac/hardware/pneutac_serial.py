"""The pressure controller of `firmware/pressure_controller`, over docs/reference/pressure_protocol.md."""

import logging
import secrets

from lerobot_robot_pneutac.hardware import pressure_protocol as wire
from lerobot_robot_pneutac.hardware.pressure_limits import positive
from lerobot_robot_pneutac.hardware.pressure_protocol import Flag
from lerobot_robot_pneutac.hardware.serial_pressure import STALE_S, Command, SerialPressure

BAUD = 115200
HEARTBEAT_S = 0.02
HELLO_S = 0.05

FAULTS = {
    Flag.OVER_PRESSURE: "the pressure exceeded the cut-off; look for a stuck inlet or a squeezed finger",
    Flag.SENSOR_FAULT: "the pressure sensor is stuck or out of range; check its wiring",
    Flag.BURST_LINE: "the pressure falls while the inlet is open; look for a burst finger or a loose line",
    Flag.STUCK_VALVE: (
        "the pressure does not follow; look for a stuck valve, no supply, a loose line or a stuck sensor"
    ),
    Flag.TOO_MUCH_AIR: "more air went in than the pressure shows; check the sensor and look for a leak",
    Flag.REFUSED: "it refused a set-point; connect again",
}

logger = logging.getLogger(__name__)


class PneutacExchange:
    """The protocol's host side without its port: opens sessions, beats, and repeats what was not received.

    Attributes:
        measured_kpa: see `Exchange`; so are `measured_s`, `max_kpa` and `fault`.
        status: the newest status; None before the first.
    """

    def __init__(self, max_kpa: float | None = None):
        self.measured_kpa: float | None = None
        self.measured_s = 0.0
        self.max_kpa: float | None = None
        self.fault: str | None = None
        self.status: wire.Status | None = None
        self._wanted_max_kpa = max_kpa
        self._clear_faults = True  # by the first session alone: a replug must not hide a fault
        self._taken = 0  # number of the newest command that was handed over
        self._session = 0
        self.restart()

    def restart(self) -> None:
        """Begins a new session: the controller vents and drops every frame of the old one."""
        self._session = (self._session + secrets.randbelow(0xFFFE)) % 0xFFFF + 1
        self._reader = wire.FrameReader()
        self._open = False
        self._nonce = 0  # none yet
        self._status_sequence: int | None = None
        self._sequence = 0
        self._pending = b""  # the newest command until it was received
        self._beat = 0
        self._beats_s: dict[int, float] = {}  # when each heartbeat was sent
        self._next_s = 0.0
        self._heard_s: float | None = None

    def transmit(self, now_s: float, command: Command) -> bytes:
        """Hello until it is answered; then the heartbeat, and a command until it was received."""
        if self._heard_s is not None and now_s - self._heard_s > STALE_S:
            logger.warning("The pressure controller is silent; opening a new session.")
            self.restart()
        if not self._open:
            self._taken = command.number  # given before the session, so not meant for it
            return self._hello(now_s)
        out = b""
        if command.number != self._taken:
            self._taken = command.number
            self._sequence = (self._sequence + 1) & 0xFFFF
            if command.target_kpa is None:
                out = wire.vent(self._session, self._sequence)
            else:
                out = wire.set_point(self._session, self._sequence, round(command.target_kpa * 1000))
            self._pending = out
        if now_s >= self._next_s:
            self._next_s = now_s + HEARTBEAT_S
            self._beat = (self._beat + 1) & 0xFFFF
            self._beats_s[self._beat] = now_s
            out = wire.heartbeat(self._session, self._beat) + (out or self._pending)
        return out

    def receive(self, data: bytes, now_s: float) -> None:
        """Takes replies and statuses of this session; all else is dropped."""
        for frame in self._reader.feed(data):
            reply = wire.read_hello_reply(frame)
            if reply:
                self._take_reply(reply, frame.session, now_s)
            status = wire.read_status(frame)
            if status and self._open and frame.session == self._session:
                self._take_status(status, frame.sequence, now_s)

    def _hello(self, now_s: float) -> bytes:
        if now_s < self._next_s:
            return b""
        self._next_s = now_s + HELLO_S
        return wire.hello(self._session, self._clear_faults, self._nonce)

    def _take_reply(self, reply: wire.HelloReply, session: int, now_s: float) -> None:
        if reply.version != wire.VERSION:
            self.fault = (
                f"its firmware speaks version {reply.version} of the protocol and this driver version "
                f"{wire.VERSION}; install firmware and driver of one release"
            )
            return
        if self._open:
            return
        if session != self._session or not self._nonce:  # now the nonce is known
            self._nonce = reply.nonce
            self._next_s = now_s
            return
        allowed = reply.max_pa / 1000
        if self._wanted_max_kpa is not None and self._wanted_max_kpa > allowed:
            self.fault = (
                f"its limit is {allowed:g} kPa, below max_kpa = {self._wanted_max_kpa:g}; lower max_kpa"
            )
            return
        self.max_kpa = allowed if self._wanted_max_kpa is None else self._wanted_max_kpa
        self._open = True
        self._clear_faults = False
        self._heard_s = now_s

    def _take_status(self, status: wire.Status, sequence: int, now_s: float) -> None:
        if self._status_sequence is not None and not wire.newer(sequence, self._status_sequence):
            return
        self._status_sequence = sequence
        self.fault = next((text for flag, text in FAULTS.items() if flag & status.flags), None)
        if status.flags & Flag.HEARTBEAT_LOST and self.fault in (None, FAULTS[Flag.REFUSED]):
            self.fault = None
            logger.warning("The pressure controller vented: no heartbeat reached it. Opening a new session.")
            self.restart()
            return
        self._heard_s = now_s
        self.status = status
        if not wire.newer(self._sequence, status.command):
            self._pending = b""
        # It had this heartbeat when it measured, so the measurement is younger than the heartbeat: a bound on
        # the age that holds however late the status comes, and without a common clock.
        if status.beat in self._beats_s:
            self.measured_kpa = status.measured_pa / 1000
            self.measured_s = self._beats_s[status.beat]
            self._beats_s = {b: s for b, s in self._beats_s.items() if s >= self.measured_s}


class PneutacSerial(SerialPressure):
    """A controller that runs PneuTac's firmware; vents by itself 80 ms after the last heartbeat.

    Args:
        port: serial port, such as /dev/serial/by-id/usb-...
        max_kpa: the highest set-point; default the controller's own limit.
        reconnect_s: how long a silent controller is waited for; a board that restarts takes about 2 s.
    """

    def __init__(self, port: str, max_kpa: float | None = None, reconnect_s: float = 3.0):
        limit = None if max_kpa is None else positive("max_kpa", max_kpa)
        super().__init__(port, lambda: PneutacExchange(limit), BAUD, reconnect_s)
