"""The pressure controller of `firmware/pressure_controller`, over docs/reference/pressure_protocol.md."""

import binascii
import logging
import secrets
import struct
from dataclasses import dataclass
from enum import IntEnum, IntFlag

from lerobot_robot_pneutac.hardware.pressure_limits import positive
from lerobot_robot_pneutac.hardware.serial_pressure import STALE_S, Command, SerialPressure

VERSION = 2
MAX_PAYLOAD = 32
_HEADER = struct.Struct("<BHH")
_CRC = struct.Struct("<H")
_MAX_FRAME = _HEADER.size + MAX_PAYLOAD + _CRC.size
_HELLO_REPLY = struct.Struct("<BIIHHI")
_STATUS = struct.Struct("<iiHHHHHH")


class Type(IntEnum):
    """What a frame is; those of the controller have the highest bit set."""

    HELLO = 0x01
    SET_POINT = 0x02
    VENT = 0x03
    HEARTBEAT = 0x04
    HELLO_REPLY = 0x81
    STATUS = 0x82


class Flag(IntFlag):
    """What a status says of the valves and of faults."""

    INLET_OPEN = 1 << 0
    VENTED = 1 << 1
    REFUSED = 1 << 2
    HEARTBEAT_LOST = 1 << 3
    OVER_PRESSURE = 1 << 4
    SENSOR_FAULT = 1 << 5
    STUCK_VALVE = 1 << 6
    BURST_LINE = 1 << 7
    TOO_MUCH_AIR = 1 << 8


@dataclass(frozen=True)
class Frame:
    """One sound frame."""

    type: int  # a `Type`, or a number of a later version
    session: int  # number of the connection that it belongs to, 16 bits
    sequence: int  # number of the frame, 16 bits, counting up in a circle
    payload: bytes = b""  # at most `MAX_PAYLOAD` bytes


@dataclass(frozen=True)
class HelloReply:
    """What a controller is: pressures in Pa, rate in Pa/s, times in ms; `nonce` opens its next session."""

    version: int
    max_pa: int
    rate_pa_s: int
    heartbeat_ms: int
    status_ms: int
    nonce: int


@dataclass(frozen=True)
class Status:
    """What a controller measures and has received."""

    measured_pa: int  # gauge pressure of the chamber
    target_pa: int  # the set-point that it follows
    flags: Flag  # `Flag`
    beat: int  # sequence number of the newest heartbeat that it received
    command: int  # sequence number of the newest set-point or vent that it received
    applied: int  # set-points that took effect in this session
    repeated: int  # frames dropped as old or double
    bad: int  # frames dropped as broken, since power-on


def newer(a: int, b: int) -> bool:
    """Whether `a` comes after `b` on the circle of 16-bit numbers (RFC 1982)."""
    return 0 < (a - b) & 0xFFFF < 0x8000


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE: polynomial 0x1021, start 0xFFFF."""
    return binascii.crc_hqx(data, 0xFFFF)


def encode(frame: Frame) -> bytes:
    """The bytes of a frame on the wire, with a zero before and after."""
    plain = _HEADER.pack(frame.type, frame.session, frame.sequence) + frame.payload
    plain += _CRC.pack(crc16(plain))
    stuffed = b"".join(bytes([len(part) + 1]) + part for part in plain.split(b"\0"))
    return b"\0" + stuffed + b"\0"


def _unstuff(stuffed: bytes) -> bytes | None:
    """Undoes consistent overhead byte stuffing (COBS); None where the bytes are none."""
    parts, at = [], 0
    while at < len(stuffed):
        end = at + stuffed[at]
        if end > len(stuffed):
            return None
        parts.append(stuffed[at + 1 : end])
        at = end
    return b"\0".join(parts)


class FrameReader:
    """Finds frames in a stream of bytes that comes in pieces. Whatever fails a check is dropped and counted.

    Attributes:
        bad: number of broken frames.
    """

    def __init__(self):
        self.bad = 0
        self._rest = b""

    def feed(self, data: bytes) -> list[Frame]:
        """The valid frames that these bytes complete."""
        *chunks, self._rest = (self._rest + data).split(b"\0")
        # A line that never sends a zero must not fill the memory; what is cut stays too long to be a frame.
        self._rest = self._rest[: _MAX_FRAME + 2]
        frames = []
        for chunk in filter(None, chunks):
            plain = _unstuff(chunk)
            if plain is None or not _HEADER.size + _CRC.size <= len(plain) <= _MAX_FRAME:
                self.bad += 1
            elif crc16(plain[:-2]) != _CRC.unpack(plain[-2:])[0]:
                self.bad += 1
            else:
                frames.append(Frame(*_HEADER.unpack_from(plain), plain[_HEADER.size : -_CRC.size]))
        return frames


def hello(session: int, clear_faults: bool, nonce: int) -> bytes:
    """Opens a session (1 to 65535) where `nonce` is the controller's present one, else asks for it."""
    return encode(Frame(Type.HELLO, session, 0, struct.pack("<BBI", VERSION, clear_faults, nonce)))


def set_point(session: int, sequence: int, target_pa: int) -> bytes:
    """Commands a pressure."""
    return encode(Frame(Type.SET_POINT, session, sequence, struct.pack("<i", target_pa)))


def vent(session: int, sequence: int) -> bytes:
    """Asks for the chamber to be opened to the room."""
    return encode(Frame(Type.VENT, session, sequence))


def heartbeat(session: int, sequence: int) -> bytes:
    """Shows that the host is running."""
    return encode(Frame(Type.HEARTBEAT, session, sequence))


def read_hello_reply(frame: Frame) -> HelloReply | None:
    """The reply in a frame; None where the frame is none. A later version's may be longer."""
    if frame.type != Type.HELLO_REPLY or len(frame.payload) < _HELLO_REPLY.size:
        return None
    return HelloReply(*_HELLO_REPLY.unpack_from(frame.payload))


def read_status(frame: Frame) -> Status | None:
    """The status in a frame; None where the frame is none."""
    if frame.type != Type.STATUS or len(frame.payload) != _STATUS.size:
        return None
    measured, target, flags, *rest = _STATUS.unpack(frame.payload)
    return Status(measured, target, Flag(flags), *rest)


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
        self.status: Status | None = None
        self._wanted_max_kpa = max_kpa
        self._clear_faults = True  # by the first session alone: a replug must not hide a fault
        self._taken = 0  # number of the newest command that was handed over
        self._session = 0
        self.restart()

    def restart(self) -> None:
        """Begins a new session: the controller vents and drops every frame of the old one."""
        self._session = (self._session + secrets.randbelow(0xFFFE)) % 0xFFFF + 1
        self._reader = FrameReader()
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
            if now_s < self._next_s:
                return b""
            self._next_s = now_s + HELLO_S
            return hello(self._session, self._clear_faults, self._nonce)
        out = b""
        if command.number != self._taken:
            self._taken = command.number
            self._sequence = (self._sequence + 1) & 0xFFFF
            if command.target_kpa is None:
                out = vent(self._session, self._sequence)
            else:
                out = set_point(self._session, self._sequence, round(command.target_kpa * 1000))
            self._pending = out
        if now_s >= self._next_s:
            self._next_s = now_s + HEARTBEAT_S
            self._beat = (self._beat + 1) & 0xFFFF
            self._beats_s[self._beat] = now_s
            out = heartbeat(self._session, self._beat) + (out or self._pending)
        return out

    def receive(self, data: bytes, now_s: float) -> None:
        """Takes replies and statuses of this session; all else is dropped."""
        for frame in self._reader.feed(data):
            reply = read_hello_reply(frame)
            if reply:
                self._take_reply(reply, frame.session, now_s)
            status = read_status(frame)
            if status and self._open and frame.session == self._session:
                self._take_status(status, frame.sequence, now_s)

    def _take_reply(self, reply: HelloReply, session: int, now_s: float) -> None:
        if reply.version != VERSION:
            self.fault = (
                f"its firmware speaks version {reply.version} of the protocol and this driver version "
                f"{VERSION}; install firmware and driver of one release"
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

    def _take_status(self, status: Status, sequence: int, now_s: float) -> None:
        if self._status_sequence is not None and not newer(sequence, self._status_sequence):
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
        if not newer(self._sequence, status.command):
            self._pending = b""
        # It had this heartbeat when it measured, so the measurement is younger than the heartbeat: a bound on
        # the age that holds however late the status comes, and without a common clock.
        if status.beat in self._beats_s:
            self.measured_kpa = status.measured_pa / 1000
            self.measured_s = self._beats_s[status.beat]
            self._beats_s = {b: s for b, s in self._beats_s.items() if s >= self.measured_s}


class PneutacSerial(SerialPressure):
    """A controller that runs PneuTac's firmware; vents by itself 80 ms after the last heartbeat.

    The highest set-point is by default the controller's own limit. A silent controller is waited for by
    `reconnect_s`; a board that restarts takes about 2 s.
    """

    def __init__(self, port: str, max_kpa: float | None = None, reconnect_s: float = 3.0):
        limit = None if max_kpa is None else positive("max_kpa", max_kpa)
        super().__init__(port, lambda: PneutacExchange(limit), BAUD, reconnect_s)
