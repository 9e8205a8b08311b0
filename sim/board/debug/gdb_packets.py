"""Framing of GDB's remote protocol: bytes in, packets, acknowledgements and interrupts out. No socket."""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import Enum, auto

PACKET_BYTES = 0x4000  # that a client may send between $ and #, as told by PacketSize
_LONGEST = PACKET_BYTES + len("$#00")
_STARTS = re.compile(rb"[$\x03-]")  # a packet, an interrupt, a request to send again


class Kind(Enum):
    """Kind of an event."""

    PACKET = auto()
    DAMAGED = auto()  # a packet whose checksum is wrong
    INTERRUPT = auto()  # Ctrl-C
    AGAIN = auto()  # a request to send the last packet again


@dataclass(frozen=True)
class Event:
    """A received packet or signal; data: of a packet, unescaped."""

    kind: Kind
    data: bytes = b""


class Inbox:
    """Bytes received and not taken yet: no more than one packet of the longest kind."""

    def __init__(self) -> None:
        self._buffer = b""

    def feed(self, data: bytes) -> None:
        self._buffer += data

    def take(self) -> Event | None:
        """Return the next event, None if more bytes are needed. Bytes that are no event are skipped."""
        while found := _STARTS.search(self._buffer):
            self._buffer = self._buffer[found.start() :]
            if found[0] != b"$":
                self._buffer = self._buffer[1:]
                return Event(Kind.AGAIN if found[0] == b"-" else Kind.INTERRUPT)
            end = self._buffer.find(b"#")
            restart = self._buffer.rfind(b"$", 1, end if end >= 0 else None)
            if restart > 0:  # the packet before was cut short
                self._buffer = self._buffer[restart:]
                continue
            if end < 0 and len(self._buffer) > _LONGEST:
                break
            if end > PACKET_BYTES + 1:
                self._buffer = self._buffer[end:]
                continue
            if end < 0 or len(self._buffer) < end + 3:
                return None
            data, told = self._buffer[1:end], self._buffer[end + 1 : end + 3]
            self._buffer = self._buffer[end + 3 :]
            good = told.lower() == checksum(data)
            return Event(Kind.PACKET, _unescaped(data)) if good else Event(Kind.DAMAGED)
        self._buffer = b""
        return None

    def take_interrupt(self) -> bool:
        """Take events up to the first interrupt, ignoring others; return whether one came."""
        while (event := self.take()) is not None:
            if event.kind is Kind.INTERRUPT:
                return True
        return False


def checksum(data: bytes) -> bytes:
    """Return the two hexadecimal digits that follow #."""
    return b"%02x" % (sum(data) % 256)


def packet(data: bytes) -> bytes:
    """Return `data`, which holds none of $ # } *, framed with its checksum."""
    return b"$" + data + b"#" + checksum(data)


def _unescaped(data: bytes) -> bytes:
    return re.sub(rb"}(.)", lambda found: bytes([found[1][0] ^ 0x20]), data, flags=re.DOTALL)
