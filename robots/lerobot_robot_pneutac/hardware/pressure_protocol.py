"""Frames of the pressure controller's serial protocol; every byte: docs/reference/pressure_protocol.md."""

import binascii
import struct
from dataclasses import dataclass
from enum import IntEnum, IntFlag

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
