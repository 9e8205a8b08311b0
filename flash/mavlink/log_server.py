"""MAVLink's log download: logs are listed and read for one peer at a time, a few packets at each turn.

Numbers of logs are as PX4 has them, from 0: ground stations take other numbers from ArduPilot alone. Nothing
is kept of what was sent; a peer asks again for what it lost.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from neuroflight.flash.link.client import Client, NoAnswerError, RefusedError
from neuroflight.flash.logs.catalogue import check_readable, read_info, refusal_words
from neuroflight.flash.logs.messages import LogEntry, entry_request, log_entry
from neuroflight.flash.logs.reading import LogReader
from neuroflight.flash.mavlink.ground import Ground
from neuroflight.flash.mavlink.offboard import Source
from neuroflight.toolchain.contract import Msp
from neuroflight.toolchain.errors import LinkError

MESSAGES = frozenset({"LOG_REQUEST_LIST", "LOG_REQUEST_DATA", "LOG_REQUEST_END", "LOG_ERASE"})
PACKET_BYTES = 90  # of a log in LOG_DATA
TURN_S, TURN_PACKETS = 0.01, 24  # 216 kB/s at most, which a slow ground station's socket can buffer
WAIT_S = 0.005  # longest wait for bytes in a turn, which blocks other work
# Blocks on their way at once: so many as the line brings in AHEAD_S, as answers to others wait behind them;
# one while a companion steers. What the line brings is measured for MEASURE_S.
WINDOW_MAX, AHEAD_S, BLOCK_BYTES, MEASURE_S = 16, 0.04, 171, 0.1
HELD_S = 5.0  # after a peer's last request until others get their turn
UNKNOWN_TIME = 0  # the firmware has no clock


@dataclass
class Transfer:
    """Bytes that a peer waits for."""

    index: int
    at: int  # of the next packet
    end: int
    reader: LogReader | None = None  # None: the log's length is not known yet
    bytes: bytes = b""  # read and not sent
    window: int = 1  # blocks
    measured: int = 0  # bytes since `since`
    since: float = 0.0


class LogServer:
    """A server of log downloads from one firmware."""

    def __init__(self, client: Client, ground: Ground, clock: Callable[[], float]) -> None:
        self._client, self._ground, self._clock = client, ground, clock
        self._entries: dict[int, LogEntry] = {}
        self._count = 0  # of logs, as last told
        self._listing: deque[int] = deque()
        self._transfer: Transfer | None = None
        self._peer: Source | None = None
        self._asked = clock()  # when the peer asked last
        self._due = clock()

    @property
    def due(self) -> float | None:
        """Time of the next task [s]; None: there is none."""
        return self._due if self._listing or self._transfer is not None else None

    def handle(self, source: Source, message: Any) -> None:  # noqa: ANN401 - pymavlink's are untyped
        """Handle one of MESSAGES. Raises NoAnswerError, and LinkError once the line is lost."""
        kind = message.get_type()
        if kind == "LOG_ERASE":
            self._ground.complain(
                "Logs are erased by `neuroflight board logs erase`, which looks whether copies are there"
            )
            return
        if not self._take_turn(source):
            self._ground.complain("Logs: another peer is being served; try again when it is done")
            return
        if kind == "LOG_REQUEST_END":
            self._end()
        elif kind == "LOG_REQUEST_LIST":
            self._list(message.start, message.end)
        else:
            end = message.ofs + message.count
            self._transfer = Transfer(int(message.id), int(message.ofs), int(end))

    def step(self, *, steered: bool) -> None:
        """Send what one turn has room for. steered: a companion steers meanwhile."""
        self._due = self._clock() + TURN_S
        try:
            if self._listing:
                self._tell_entry()
            elif self._transfer is not None:
                self._send(self._transfer, steered=steered)
        except NoAnswerError:
            raise
        except RefusedError as error:
            self._give_up(refusal_words(self._client, error))
        except LinkError as error:
            self._give_up(error)

    def _take_turn(self, source: Source) -> bool:
        """Return True if it is this peer's turn."""
        now = self._clock()
        if self._peer not in (None, source) and now < self._asked + HELD_S:
            return False
        self._peer, self._asked = source, now
        return True

    def _end(self) -> None:
        self._transfer, self._peer = None, None
        self._listing.clear()

    def _give_up(self, error: LinkError) -> None:
        self._end()
        self._tell(error)

    def _tell(self, error: LinkError) -> None:
        self._ground.refuse(str(error).removeprefix(f"{self._client.name}: "))

    # --- The list --------------------------------------------------------------------------------------
    def _list(self, first: int, last: int) -> None:
        """Announce the logs `first` to `last`, or that there are none."""
        self._entries.clear()
        self._transfer, self._count = None, 0
        try:
            info = read_info(self._client)
            check_readable(self._client, info)
            self._count = info.logs
        except NoAnswerError:
            raise
        except LinkError as error:
            self._tell(error)
        self._listing = deque(range(first, min(last + 1, self._count)))
        if not self._listing:
            self._answer(mavlink.MAVLink_log_entry_message(0, self._count, 0, UNKNOWN_TIME, 0))

    def _tell_entry(self) -> None:
        entry = self._entry(self._listing[0])
        if entry is None:  # the device still looks for it
            return
        self._listing.popleft()
        last = self._count - 1
        self._answer(
            mavlink.MAVLink_log_entry_message(entry.index, self._count, last, UNKNOWN_TIME, entry.bytes)
        )

    def _entry(self, index: int) -> LogEntry | None:
        """Read a log's name and size; None: ask again."""
        if index not in self._entries:
            told = log_entry(self._client.request(Msp.LOG_ENTRY, entry_request(index)))
            if told is None:
                return None
            self._entries[index] = told
        return self._entries[index]

    # --- The bytes -------------------------------------------------------------------------------------
    def _send(self, transfer: Transfer, *, steered: bool) -> None:
        """Send the next packets of a transfer."""
        if transfer.reader is None:
            entry = self._entry(transfer.index)
            if entry is None:
                return
            transfer.end = min(transfer.end, entry.bytes)
            if transfer.at >= transfer.end:  # a peer that missed the end of the log asks for it in this way
                self._send_packet(transfer, b"")
                self._transfer = None
                return
            transfer.since = self._clock()
            transfer.reader = LogReader(self._client, transfer.index, transfer.at, transfer.end, self._clock)
        self._read(transfer, transfer.reader, steered=steered)
        for _ in range(TURN_PACKETS):
            ends = transfer.at + len(transfer.bytes) == transfer.end
            if not transfer.bytes or (len(transfer.bytes) < PACKET_BYTES and not ends):
                break
            self._send_packet(transfer, transfer.bytes[:PACKET_BYTES])
            transfer.bytes = transfer.bytes[PACKET_BYTES:]
        if transfer.at == transfer.end:
            self._transfer = None

    def _read(self, transfer: Transfer, reader: LogReader, *, steered: bool) -> None:
        """Read the bytes that arrive within a turn; their number shows the line's speed."""
        now = self._clock()
        reader.limit(1 if steered else transfer.window)
        while len(transfer.bytes) < TURN_PACKETS * PACKET_BYTES and self._clock() < now + WAIT_S:
            part = reader.read(WAIT_S)
            if not part:
                break
            transfer.bytes += part
            transfer.measured += len(part)
        if now > transfer.since + MEASURE_S:
            bears = transfer.measured / (now - transfer.since) * AHEAD_S / BLOCK_BYTES
            transfer.window = min(max(math.ceil(bears), 1), WINDOW_MAX)
            transfer.measured, transfer.since = 0, now

    def _send_packet(self, transfer: Transfer, data: bytes) -> None:
        padded = list(data.ljust(PACKET_BYTES, b"\0"))
        self._answer(mavlink.MAVLink_log_data_message(transfer.index, transfer.at, len(data), padded))
        transfer.at += len(data)

    def _answer(self, message: Any) -> None:  # noqa: ANN401
        assert self._peer is not None
        self._ground.answer(self._peer, message)
