"""MSP frames, version 1 (with its jumbo form) and version 2: bytes in, events out.

No socket and no clock: whoever owns the line feeds what arrives and acts on the events. The three
frames, all integers little-endian, `d` one of `<` (request), `>` (reply), `!` (error reply):

    v1        $ M d   size u8      command u8            payload   xor of size..payload
    v1 jumbo  $ M d   255          command u8  size u16  payload   xor of 255..payload
    v2        $ X d   flags u8     command u16 size u16  payload   CRC-8/DVB-S2 of flags..payload

The v2 flags are sent as 0 and ignored on arrival.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, IntEnum, auto
from functools import reduce
from operator import xor

from neuroflight.toolchain.contract import CRC8_DVB_S2_POLY, MSP_PAYLOAD_MAX

V1_COMMAND_MAX = 254  # 255 would be a v2 frame inside a v1 frame, which nobody here speaks
JUMBO_MARK = 255  # the v1 size that announces a u16 size
FRAME_OVERHEAD_MAX = 9  # v2: 3 bytes of preamble, 5 of header, 1 of checksum


class Version(IntEnum):
    """The two frame formats; a jumbo frame is a long v1 frame."""

    V1 = 1
    V2 = 2


class Direction(Enum):
    """Request, reply or error reply; the value is the third byte of a frame."""

    REQUEST = b"<"
    REPLY = b">"
    ERROR = b"!"


@dataclass(frozen=True)
class Message:
    """One whole frame. `command` is 0..254 for v1 and 0..65535 for v2."""

    version: Version
    direction: Direction
    command: int
    payload: bytes = b""


class Reason(Enum):
    """Reasons for giving up a frame that had begun."""

    CHECKSUM = "wrong checksum"
    TOO_LONG = "payload over the limit"
    TRUNCATED = "frame cut short"


@dataclass(frozen=True)
class Corrupt:
    """A frame that began and could not be used; `detail` says what came and what was expected."""

    reason: Reason
    detail: str


Event = Message | Corrupt


# --- Encoding --------------------------------------------------------------------------------
def request(command: int, payload: bytes = b"") -> Message:
    """Return a request for `command`, in v1 if v1 can express it and in v2 otherwise."""
    version = Version.V1 if command <= V1_COMMAND_MAX else Version.V2
    return Message(version, Direction.REQUEST, command, payload)


def reply(to: Message, payload: bytes = b"") -> Message:
    """Return the answer to the request `to`, in the same version."""
    return Message(to.version, Direction.REPLY, to.command, payload)


def error(to: Message) -> Message:
    """Return the refusal of the request `to`: unknown command or unacceptable payload."""
    return Message(to.version, Direction.ERROR, to.command)


def encode(message: Message) -> bytes:
    """Encode `message` as a frame. Raises ValueError for a command or a length that no frame can carry."""
    size, command = len(message.payload), message.command
    command_max = V1_COMMAND_MAX if message.version is Version.V1 else 0xFFFF
    if not 0 <= command <= command_max:
        raise ValueError(f"command {command}, expected 0..{command_max} in MSP v{message.version}")
    if size > 0xFFFF:
        raise ValueError(f"payload of {size} bytes, expected at most 65535")
    if message.version is Version.V2:
        header = struct.pack("<BHH", 0, command, size)
    elif size < JUMBO_MARK:
        header = struct.pack("<BB", size, command)
    else:
        header = struct.pack("<BBH", JUMBO_MARK, command, size)
    checked = header + message.payload
    mark = b"$M" if message.version is Version.V1 else b"$X"
    checksum = _CHECKSUMS[message.version](checked, 0)
    return mark + message.direction.value + checked + bytes([checksum])


# --- Checksums: (data, checksum so far) -> checksum ------------------------------------------
def xor_checksum(data: bytes, start: int = 0) -> int:
    """Compute the v1 checksum of `data`, continued from `start`."""
    return reduce(xor, data, start)


def crc8_dvb_s2(data: bytes, start: int = 0) -> int:
    """Compute the v2 checksum of `data`: CRC-8, polynomial 0xD5, most significant bit first, no final xor."""
    crc = start
    for byte in data:
        crc = _CRC8_TABLE[crc ^ byte]
    return crc


def _crc8_of_byte(byte: int) -> int:
    for _ in range(8):
        byte = (byte << 1) ^ (CRC8_DVB_S2_POLY if byte & 0x80 else 0)
    return byte & 0xFF


_CRC8_TABLE = bytes(_crc8_of_byte(byte) for byte in range(256))
_CHECKSUMS: dict[Version, Callable[[bytes, int], int]] = {
    Version.V1: xor_checksum,
    Version.V2: crc8_dvb_s2,
}


# --- Decoding --------------------------------------------------------------------------------
class _State(Enum):
    """The next part of a frame that the decoder expects."""

    MARK = auto()
    VERSION = auto()
    DIRECTION = auto()
    V1_HEADER = auto()
    JUMBO_SIZE = auto()
    V2_HEADER = auto()
    PAYLOAD = auto()
    CHECKSUM = auto()


@dataclass
class _Frame:
    """The known part of the frame that begins at the first byte of the decoder's buffer."""

    payload_max: int
    state: _State = _State.MARK
    taken: int = 0  # bytes of the buffer that the states so far have consumed
    version: Version = Version.V1
    direction: Direction = Direction.REQUEST
    command: int = 0
    size: int = 0
    payload: bytes = b""
    checksum: int = 0

    def cover(self, data: bytes) -> None:
        """Continue the checksum over `data`."""
        self.checksum = _CHECKSUMS[self.version](data, self.checksum)


class _Noise(Enum):
    """The bytes so far are not the beginning of a frame."""

    NOISE = auto()


# Result of reading a field: the next state, a whole message, or a reason to search on.
_Outcome = _State | Message | Corrupt | _Noise


def _mark(frame: _Frame, data: bytes) -> _Outcome:
    return _State.VERSION if data == b"$" else _Noise.NOISE


def _version(frame: _Frame, data: bytes) -> _Outcome:
    if data not in (b"M", b"X"):
        return _Noise.NOISE
    frame.version = Version.V1 if data == b"M" else Version.V2
    return _State.DIRECTION


def _direction(frame: _Frame, data: bytes) -> _Outcome:
    if data not in (b"<", b">", b"!"):
        return _Noise.NOISE
    frame.direction = Direction(data)
    return _State.V1_HEADER if frame.version is Version.V1 else _State.V2_HEADER


def _v1_header(frame: _Frame, data: bytes) -> _Outcome:
    frame.cover(data)
    size, frame.command = data
    return _State.JUMBO_SIZE if size == JUMBO_MARK else _payload_of(frame, size)


def _jumbo_size(frame: _Frame, data: bytes) -> _Outcome:
    frame.cover(data)
    return _payload_of(frame, int.from_bytes(data, "little"))


def _v2_header(frame: _Frame, data: bytes) -> _Outcome:
    frame.cover(data)
    _flags, frame.command, size = struct.unpack("<BHH", data)
    return _payload_of(frame, size)


def _payload_of(frame: _Frame, size: int) -> _Outcome:
    if size > frame.payload_max:
        detail = f"command {frame.command} announces {size} bytes, expected at most {frame.payload_max}"
        return Corrupt(Reason.TOO_LONG, detail)
    frame.size = size
    return _State.PAYLOAD


def _payload(frame: _Frame, data: bytes) -> _Outcome:
    frame.cover(data)
    frame.payload = data
    return _State.CHECKSUM


def _checksum(frame: _Frame, data: bytes) -> _Outcome:
    if data[0] != frame.checksum:
        detail = f"command {frame.command} came with 0x{data[0]:02X}, expected 0x{frame.checksum:02X}"
        return Corrupt(Reason.CHECKSUM, detail)
    return Message(frame.version, frame.direction, frame.command, frame.payload)


# The state machine: for each state, the number of bytes to wait for and the function that reads them.
_TABLE: dict[_State, tuple[Callable[[_Frame], int], Callable[[_Frame, bytes], _Outcome]]] = {
    _State.MARK: (lambda frame: 1, _mark),
    _State.VERSION: (lambda frame: 1, _version),
    _State.DIRECTION: (lambda frame: 1, _direction),
    _State.V1_HEADER: (lambda frame: 2, _v1_header),
    _State.JUMBO_SIZE: (lambda frame: 2, _jumbo_size),
    _State.V2_HEADER: (lambda frame: 5, _v2_header),
    _State.PAYLOAD: (lambda frame: frame.size, _payload),
    _State.CHECKSUM: (lambda frame: 1, _checksum),
}


class Decoder:
    """A decoder that finds the frames in a stream of bytes. Takes any bytes, in any pieces, and never raises.

    The events do not depend on how the stream was cut into pieces. After a frame that failed the
    search goes on at the byte behind its `$`, so a true frame inside a false one's length is found.
    Between calls at most one unfinished frame is kept: FRAME_OVERHEAD_MAX + payload_max bytes.
    """

    def __init__(self, payload_max: int = MSP_PAYLOAD_MAX) -> None:
        """payload_max: longest payload to accept [bytes]; a frame that announces more is Corrupt."""
        self._payload_max = payload_max
        self._buffer = bytearray()
        self._frame = _Frame(payload_max)
        self._skipped = 0

    @property
    def pending(self) -> int:
        """Bytes kept of a frame that is not finished."""
        return len(self._buffer)

    @property
    def skipped(self) -> int:
        """Bytes so far that belonged to no whole frame."""
        return self._skipped

    def feed(self, data: bytes) -> list[Event]:
        """Decode the bytes that arrived and return the events they complete, in order."""
        self._buffer += data
        return self._advance()

    def flush(self) -> list[Event]:
        """Discard the unfinished frame, because the line is silent, and search its bytes again."""
        events: list[Event] = []
        while self._buffer:
            frame = self._frame
            if frame.state not in (_State.MARK, _State.VERSION, _State.DIRECTION):
                detail = f"{len(self._buffer)} bytes and then silence, expected the rest of a frame"
                events.append(Corrupt(Reason.TRUNCATED, detail))
            self._resynchronise()
            events += self._advance()
        return events

    def _advance(self) -> list[Event]:
        """Run the state machine until the buffer runs short."""
        events: list[Event] = []
        while True:
            frame = self._frame
            width, take = _TABLE[frame.state]
            end = frame.taken + width(frame)
            if end > len(self._buffer):
                return events
            outcome = take(frame, bytes(self._buffer[frame.taken : end]))
            if isinstance(outcome, _State):
                frame.state, frame.taken = outcome, end
                continue
            if isinstance(outcome, Message | Corrupt):
                events.append(outcome)
            if isinstance(outcome, Message):
                self._begin(after=end)
            else:
                self._resynchronise()

    def _resynchronise(self) -> None:
        """Skip to the next byte that may begin a frame."""
        start = self._buffer.find(b"$", 1)
        start = len(self._buffer) if start < 0 else start
        self._skipped += start
        self._begin(after=start)

    def _begin(self, after: int) -> None:
        del self._buffer[:after]
        self._frame = _Frame(self._payload_max)
