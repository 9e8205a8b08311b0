"""The FIFOs of the OTG core: packets in 1.25 KB of RAM, counted in words as the core counts them.

The receive FIFO holds a status word for each event and the words of each packet behind its status; the
program pops the status, then reads the words. A transmit FIFO takes words until they make a packet. RM0431,
"FIFO RAM allocation" and "OTG_FS data FIFOs".
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NoReturn

from neuroflight.sim.board.core.context import Kept

RAM_WORDS = 320  # of all FIFOs together
DEPTH_MIN = 16  # words of a FIFO (RM0431, OTG_GRXFSIZ and OTG_DIEPTXFx)

# PKTSTS of GRXSTSP in device mode.
GLOBAL_OUT_NAK, OUT_DATA, OUT_DONE, SETUP_DONE, SETUP_DATA = 1, 2, 3, 4, 6


def words_of(length: int) -> int:
    """Return how many words hold `length` bytes."""
    return (length + 3) // 4


class ReceiveFifo(Kept):
    """Packets and events from the host that the program has not read."""

    kept = ("entries", "unread", "_used")

    def __init__(self, fail: Callable[[str], NoReturn]) -> None:
        self._fail = fail
        self.entries: list[tuple[int, bytes]] = []  # status word, packet
        self.unread: list[int] = []  # words of the packet whose status was popped
        self._used = 0  # words in the RAM

    def clear(self) -> None:
        self.entries, self.unread, self._used = [], [], 0

    def room(self, depth: int, words: int) -> bool:
        return self._used + words <= depth

    def push(self, status: int, endpoint: int, frame: int, data: bytes = b"", toggle: int = 0) -> None:
        """Store an event: `status` is PKTSTS; toggle: 0 or 1 for DATA0 or DATA1."""
        # DPID: 0 DATA0, 2 DATA1.
        word = endpoint | len(data) << 4 | 2 * toggle << 15 | status << 17 | (frame & 15) << 21
        self.entries.append((word, data))
        self._used += 1 + words_of(len(data))

    def peek(self) -> int:
        return self.entries[0][0] if self.entries else 0

    def pop(self) -> int:
        """Take the first status word; 0: there is none. Its packet's words are to be read next."""
        if self.unread:
            self._fail(
                f"OTG_FS_GRXSTSP is read while {len(self.unread)} words of the packet before are in the "
                "receive FIFO, expected all read"
            )
        if not self.entries:
            return 0
        word, data = self.entries.pop(0)
        self._used -= 1
        padded = data + bytes(-len(data) % 4)
        self.unread = [int.from_bytes(padded[i : i + 4], "little") for i in range(0, len(padded), 4)]
        return word

    def read(self) -> int:
        """Read the next word of the packet whose status was popped."""
        if not self.unread:
            self._fail("the receive FIFO is read, but no packet's status was popped that has words left")
        self._used -= 1
        return self.unread.pop(0)


class TransmitFifo(Kept):
    """Packets for the host in one of the transmit FIFOs."""

    kept = ("packets", "partial", "used")

    def __init__(self) -> None:
        self.packets: list[bytes] = []
        self.partial = b""  # the words so far of the packet that is being written
        self.used = 0  # words

    def clear(self) -> None:
        self.packets, self.partial, self.used = [], b"", 0

    def write(self, word: int, length: int) -> bool:
        """Append a word to the packet of `length` bytes. Returns True if that packet is whole now."""
        self.partial += word.to_bytes(4, "little")
        self.used += 1
        if len(self.partial) < length:
            return False
        self.packets.append(self.partial[:length])
        self.partial = b""
        return True

    def take(self) -> bytes:
        packet = self.packets.pop(0)
        self.used -= words_of(len(packet))
        return packet
