"""Bytes of a log over MSP, many requests on their way at once, so that the line is never idle.

A firmware answers with some 230 bytes at a time. Waiting for each answer before the next question would leave
the line idle while a question is on its way, several milliseconds through a USB adapter. Replies come in the
order of requests and say which bytes they hold: whatever was lost is seen by what comes after it.

A card holds one sector ready, and says "ask again" for any other, which it reads then. From such an answer on
only one sector's requests are on their way; once its first bytes have come, one for no byte of the next
sector, which then is read while the rest is on the line.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from heapq import heappop, heappush

from neuroflight.flash.link.client import Client
from neuroflight.flash.logs.messages import log_block, read_request
from neuroflight.toolchain.contract import Msp
from neuroflight.toolchain.errors import LinkError

WINDOW = 16  # requests on their way: 43 ms of replies at 921,600 baud, beyond what USB adapters wait
SECTOR = 512  # bytes of a card; no request reaches into the next one
FIRST_COUNT = SECTOR  # the answer's size shows how many bytes the firmware sends at once
SHORTEST_S = 1e-3  # shortest wait for an answer
SILENCE_S = 0.5  # after which pending requests are repeated
PATIENCE_S = 15.0  # without a new byte: a card that stalls takes half a second


class LogReader:
    """A reader of one log from `start` to `end` [bytes], in order."""

    def __init__(
        self,
        client: Client,
        index: int,
        start: int,
        end: int,
        clock: Callable[[], float],
    ) -> None:
        self._client, self._index, self._clock, self._limit = client, index, clock, WINDOW
        self._at, self._end = start, end  # next byte to return; end of the request
        self._asked = start  # end of all requests so far
        self._block, self._largest = FIRST_COUNT, 1  # bytes per request; most bytes in one answer so far
        self._again: list[
            tuple[int, int]
        ] = []  # a heap of (offset, count) that were lost, or asked too early
        self._under_way: deque[tuple[int, int]] = deque()
        self._arrived: dict[int, bytes] = {}  # by offset, behind a gap
        self._window, self._early = 1, 0  # the first answer shows the size of a block
        self._one_sector, self._prepared = (
            False,
            0,
        )  # at a time, as "ask again" has come; the last one asked so
        self._moved = self._heard = clock()  # when the last new bytes came, and any answer

    @property
    def at(self) -> int:
        """Offset of the next bytes in the log."""
        return self._at

    def limit(self, window: int) -> None:
        """Limit the number of pending requests, because answers to other requests wait behind theirs."""
        self._limit = window
        self._window = min(self._window, window)

    def read(self, timeout: float = SILENCE_S) -> bytes:
        """Read the bytes that have arrived; b"" at the end or if none came in `timeout` [s].

        Raises LinkError where nothing came for PATIENCE_S, RefusedError where the firmware refuses.
        """
        deadline = self._clock() + timeout
        while self._at < self._end:
            self._ask()
            until = min(deadline, self._heard + SILENCE_S)
            payload = self._client.collect(Msp.LOG_READ, max(until - self._clock(), SHORTEST_S))
            if payload is not None:
                self._heard = self._clock()
                self._take(payload)
            elif self._clock() - self._heard >= SILENCE_S:
                self._heard = self._clock()
                self._ask_again(self._under_way)
                self._under_way.clear()
                self._window = 1
            if parts := self._in_order():
                self._moved = self._clock()
                return parts
            if self._clock() - self._moved > PATIENCE_S:
                raise LinkError(
                    f"{self._client.name}: no byte of the log came for {PATIENCE_S:g} s, expected byte "
                    f"{self._at:,} of {self._end:,}; check cable and card, then fetch again: it goes on there"
                )
            if payload is None or self._clock() >= deadline:
                break
        return b""

    def _ask(self) -> None:
        """Keep as many requests under way as the window lets."""
        while len(self._under_way) < self._window:
            first = self._again[0][0] if self._again else self._asked
            if self._one_sector and first // SECTOR != self._at // SECTOR:
                return
            if self._again:
                wanted = heappop(self._again)
            elif self._asked < self._end:
                sector_left = SECTOR - self._asked % SECTOR
                wanted = (self._asked, min(self._block, sector_left, self._end - self._asked))
                self._asked += wanted[1]
            else:
                return
            self._under_way.append(wanted)
            self._client.post(Msp.LOG_READ, read_request(self._index, *wanted))

    def _take(self, payload: bytes) -> None:
        """Take a reply: requests sent before the one it answers were lost on the line."""
        block = log_block(payload)
        place = next((k for k, (offset, _) in enumerate(self._under_way) if offset == block.offset), None)
        if block.index != self._index or place is None:
            return  # of an earlier question
        lost = [self._under_way.popleft() for _ in range(place)]
        offset, count = self._under_way.popleft()
        if block.data is None:
            lost.append((offset, count))
            self._one_sector = True
            self._window = min(self._window, self._most)
            self._early += 1
            if self._early > self._window:  # the requests may hinder each other
                self._window, self._early = max(1, self._window // 2), 0
        elif not block.data:
            raise LinkError(
                f"{self._client.name}: the log ends at byte {offset:,}, expected {self._end:,} as it was "
                "listed; try again"
            )
        else:
            self._prepare(offset // SECTOR + 1)
            self._arrived[offset] = block.data[:count]
            self._largest = max(self._largest, len(block.data))
            self._early, self._window = 0, min(self._window + 1, self._most)
            missing = count - len(block.data)
            if missing > 0:
                self._block = -(-SECTOR // self._in_sector)
                lost.append((offset + len(block.data), missing))
        self._ask_again(lost)

    def _ask_again(self, wanted: Iterable[tuple[int, int]]) -> None:
        for one in wanted:
            heappush(self._again, one)

    def _prepare(self, sector: int) -> None:
        """Request a sector in advance while the bytes of the one before are on the line."""
        place = sector * SECTOR + 1  # no other request has this offset: the answer is ignored
        asked = not self._again and self._asked >= sector * SECTOR  # all of the sector before
        if self._one_sector and asked and sector > self._prepared and place < self._end:
            self._prepared = sector
            self._client.post(Msp.LOG_READ, read_request(self._index, place, 0))

    @property
    def _in_sector(self) -> int:
        """Answers that a sector takes."""
        return -(-SECTOR // self._largest)

    @property
    def _most(self) -> int:
        """Requests on their way."""
        return min(self._limit, self._in_sector) if self._one_sector else self._limit

    def _in_order(self) -> bytes:
        """Return the bytes that have arrived without a gap."""
        parts = []
        while (data := self._arrived.pop(self._at, None)) is not None:
            parts.append(data)
            self._at += len(data)
        return b"".join(parts)


def read_bytes(client: Client, index: int, offset: int, count: int, clock: Callable[[], float]) -> bytes:
    """Read `count` bytes of a log that is long enough. Raises LinkError."""
    reader = LogReader(client, index, offset, offset + count, clock)
    parts = []
    while reader.at < offset + count:
        parts.append(reader.read())
    return b"".join(parts)
