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
from enum import Enum, IntEnum
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
_PREAMBLE = (b"$", b"MX", b"<>!")  # the bytes that may stand in each of a frame's first places


def _first_frame(data: bytes, payload_max: int) -> tuple[Event | None, int]:
    """Read the frame that begins `data`: the event it gives, if any, and its length [bytes].

    Without an event, the length is that of the part to wait for, or 0 when no frame begins here.
    """
    if any(byte not in allowed for byte, allowed in zip(data, _PREAMBLE, strict=False)):
        return None, 0
    version = Version.V2 if data[1:2] == b"X" else Version.V1
    jumbo = version is Version.V1 and data[3:4] == bytes([JUMBO_MARK])
    start = 8 if version is Version.V2 else 7 if jumbo else 5  # of the payload
    if len(data) < start:
        return None, start
    if version is Version.V2:
        command, size = struct.unpack_from("<HH", data, 4)
    else:
        size, command = (int.from_bytes(data[5:7], "little") if jumbo else data[3]), data[4]
    end = start + size
    if size > payload_max:
        detail = f"command {command} announces {size} bytes, expected at most {payload_max}"
        return Corrupt(Reason.TOO_LONG, detail), start
    if len(data) <= end:
        return None, end + 1
    checksum = _CHECKSUMS[version](data[3:end], 0)
    if data[end] != checksum:
        detail = f"command {command} came with 0x{data[end]:02X}, expected 0x{checksum:02X}"
        return Corrupt(Reason.CHECKSUM, detail), end + 1
    return Message(version, Direction(data[2:3]), command, data[start:end]), end + 1


class Decoder:
    """A decoder that finds the frames in a stream of bytes. Takes any bytes, in any pieces, and never raises.

    The events do not depend on how the stream was cut into pieces. After a frame that failed the
    search goes on at the byte behind its `$`, so a true frame inside a false one's length is found.
    Between calls at most one unfinished frame is kept: FRAME_OVERHEAD_MAX + payload_max bytes.
    """

    def __init__(self, payload_max: int = MSP_PAYLOAD_MAX) -> None:
        """payload_max: longest payload to accept [bytes]; a frame that announces more is Corrupt."""
        self._payload_max = payload_max
        self._buffer = b""
        self.skipped = 0  # bytes so far that belonged to no whole frame

    @property
    def pending(self) -> int:
        """Bytes kept of a frame that is not finished."""
        return len(self._buffer)

    def feed(self, data: bytes) -> list[Event]:
        """Decode the bytes that arrived and return the events they complete, in order."""
        self._buffer += data
        events: list[Event] = []
        while self._buffer:
            event, length = _first_frame(self._buffer, self._payload_max)
            if event is not None:
                events.append(event)
            if isinstance(event, Message):
                self._buffer = self._buffer[length:]
            elif event is not None or length == 0:
                self._skip_to_next_mark()
            else:
                break
        return events

    def flush(self) -> list[Event]:
        """Discard the unfinished frame, because the line is silent, and search its bytes again."""
        events: list[Event] = []
        while self._buffer:
            if len(self._buffer) >= len(_PREAMBLE):
                detail = f"{len(self._buffer)} bytes and then silence, expected the rest of a frame"
                events.append(Corrupt(Reason.TRUNCATED, detail))
            self._skip_to_next_mark()
            events += self.feed(b"")
        return events

    def _skip_to_next_mark(self) -> None:
        """Skip to the next byte that may begin a frame."""
        start = self._buffer.find(b"$", 1)
        start = len(self._buffer) if start < 0 else start
        self.skipped += start
        self._buffer = self._buffer[start:]
