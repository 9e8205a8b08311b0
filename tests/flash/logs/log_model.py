"""A board in memory that keeps logs: the model of the image tests, with the blackbox's messages beside."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable
from dataclasses import dataclass, field

from neuroflight.flash.link.client import Client
from neuroflight.flash.link.msp import Direction, Message, encode
from neuroflight.flash.logs.catalogue import Wait
from neuroflight.toolchain.contract import LOG_ERASE_MAGIC, LogError, LogState, Msp, Refusal
from neuroflight.toolchain.errors import LinkError
from tests.flash.image.board_model import Bank, BoardModel, ModelLine

REPLY_BYTES = 233  # of a log in one answer, as the firmware's buffer has room for
SECTOR = 512
SEND_BYTES = 2048  # of answers that the firmware keeps ready for the line


@dataclass
class LogBoard(BoardModel):
    """Logs, and a device that may be slow: `early` times it says "ask again" for each piece of 4 KB."""

    logs: list[bytes] = field(default_factory=list)
    early: int = 0
    has_logs: bool = True
    logging: bool = False
    looking: bool = False
    log_state: LogState = LogState.READY
    log_error: LogError = LogError.NONE
    dropped: int = 0
    whole_sectors: bool = False  # an answer never reaches into the next sector
    asked: dict[int, int] = field(default_factory=dict)  # times that a piece was asked for
    reads: list[int] = field(default_factory=list)  # offsets of LOG_READ
    at: float = 0.0  # when a request is answered [s]

    def answer(self, message: Message) -> Message:
        handler = LOG_HANDLERS.get(message.command)
        if handler is None:
            return super().answer(message)
        result = handler(self, message.payload) if self.has_logs else None
        if isinstance(result, bytes):
            return Message(message.version, Direction.REPLY, message.command, result)
        payload = b"" if result is None else struct.pack("<Bh", result, self.log_error)
        return Message(message.version, Direction.ERROR, message.command, payload)

    def log_info(self, _: bytes) -> bytes:
        size = len(self.logs[-1]) if self.logs else 0
        flags = self.logging | (self.dropped > 0) << 1 | self.looking << 2
        head = struct.pack("<BBBBHH", 2, self.log_state, self.log_error, flags, len(self.logs), 5)
        return head + struct.pack("<5I", 640 << 10, 320 << 10, size // 100, self.dropped, size)

    def refused(self, index: int) -> Refusal | None:
        if self.armed:
            return Refusal.ARMED
        if self.logging:
            return Refusal.ORDER
        return Refusal.INDEX if index >= len(self.logs) else None

    def later(self, place: int) -> bool:
        """Whether the device still looks for what is there."""
        self.asked[place] = self.asked.get(place, 0) + 1
        return self.asked[place] <= self.early

    def log_entry(self, payload: bytes) -> bytes | Refusal:
        (index,) = struct.unpack("<H", payload)
        if (why := self.refused(index)) is not None:
            return why
        if self.later(-1 - index):
            return struct.pack("<HB12sI", index, 1, b"", 0)
        name = f"LOG{index + 1:05d}.BBL".encode()
        return struct.pack("<HB12sI", index, 0, name, len(self.logs[index]))

    def log_read(self, payload: bytes) -> bytes | Refusal:
        index, offset, count = map(int, struct.unpack("<HIH", payload))
        if (why := self.refused(index)) is not None:
            return why
        self.reads.append(offset)
        if self.later(offset // 4096):
            return struct.pack("<HIB", index, offset, 1)
        count = min(count, REPLY_BYTES)
        if self.whole_sectors:
            count = min(count, SECTOR - offset % SECTOR)
        data = self.logs[index][offset : offset + count]
        return struct.pack("<HIB", index, offset, 0) + data

    def log_erase(self, payload: bytes) -> bytes | Refusal:
        if self.armed:
            return Refusal.ARMED
        if struct.unpack("<I", payload)[0] != LOG_ERASE_MAGIC:
            return Refusal.PAYLOAD
        if self.later(1 << 40):
            return b"\x01"
        self.logs.clear()
        if self.log_error is LogError.FOREIGN:
            self.log_state, self.log_error = LogState.READY, LogError.NONE
        return b"\x00"


LOG_HANDLERS: dict[int, Callable[[LogBoard, bytes], bytes | Refusal]] = {
    Msp.LOG_INFO: LogBoard.log_info,
    Msp.LOG_ENTRY: LogBoard.log_entry,
    Msp.LOG_READ: lambda board, payload: board.log_read(payload),
    Msp.LOG_ERASE: LogBoard.log_erase,
}


@dataclass
class CardBoard(LogBoard):
    """Its device holds one sector of a card, and reads the one that was asked for last."""

    read_s: float = 0.001
    held: int = -1
    ready: float = 0.0

    def later(self, place: int) -> bool:
        return False

    def log_read(self, payload: bytes) -> bytes | Refusal:
        index, offset, _ = map(int, struct.unpack("<HIH", payload))
        if self.held != offset // SECTOR:
            self.held, self.ready = offset // SECTOR, max(self.at, self.ready) + self.read_s
        if self.at < self.ready:
            self.reads.append(offset)
            return struct.pack("<HIB", index, offset, 1)
        return super().log_read(payload)


class Cable(ModelLine):
    """A line that may be pulled: after `bytes_left` more bytes from the board it is gone."""

    bytes_left: int | None = None

    def read(self, timeout: float) -> bytes:
        data = super().read(timeout)
        if self.bytes_left is not None:
            self.bytes_left -= len(data)
            if self.bytes_left < 0:
                raise LinkError(f"{self.name}: the line is gone")
        return data


def log_board(*logs: bytes, **facts: object) -> LogBoard:
    """A board that keeps these logs."""
    return LogBoard([Bank(confirmed=True), Bank()], logs=list(logs), **facts)  # type: ignore[arg-type]


def card_board(*logs: bytes, read_s: float) -> CardBoard:
    """A board with a card that reads a sector in so long."""
    return CardBoard([Bank(confirmed=True), Bank()], logs=list(logs), read_s=read_s, whole_sectors=True)


def log_of(size: int, seed: int = 1) -> bytes:
    """A log of that many bytes."""
    return b"H Product:Blackbox flight data recorder\n"[:size] + random.Random(seed).randbytes(
        max(size - 40, 0)
    )


def client_of(line: ModelLine) -> Client:
    return Client(line, line.clock)


def wait_of(line: ModelLine) -> Wait:
    return Wait(line.clock, line.board.advance)


def losing(share: float, seed: int = 3) -> Callable[[bytes], bytes]:
    """What happens to bytes on a line that spoils that share of the frames."""
    rng = random.Random(seed)

    def spoil(data: bytes) -> bytes:
        if rng.random() >= share:
            return data
        if rng.random() < 0.5:
            return b""
        at = rng.randrange(len(data))
        return data[:at] + bytes([data[at] ^ 0x55]) + data[at + 1 :]

    return spoil


class PacedLine(ModelLine):
    """A serial line: bytes take their time each way, and `latency` [s] passes before they are handed on."""

    def __init__(self, board: LogBoard, baud: int, latency: float) -> None:
        super().__init__(board)
        self._logs = board
        self._byte_s, self._latency = 10 / baud, latency
        self._down_free = self._up_free = 0.0  # when each direction has sent all that it was given
        self._queue: list[tuple[float, bytes]] = []
        self.up_bytes = 0

    def write(self, data: bytes) -> None:
        self._down_free = max(self._down_free, self.board.now) + len(data) * self._byte_s
        for event in self._decoder.feed(data):
            if isinstance(event, Message):
                arrives = self._down_free + self._latency
                self._logs.at = max(arrives, self._up_free - SEND_BYTES * self._byte_s)
                begins = max(self._up_free, arrives)
                answered = encode(self.board.answer(event))
                self._up_free = begins + len(answered) * self._byte_s
                self.up_bytes += len(answered)
                self._queue.append((self._up_free + self._latency, answered))

    def read(self, timeout: float) -> bytes:
        if self._queue and self._queue[0][0] <= self.board.now + timeout:
            at, data = self._queue.pop(0)
            self.board.now = max(self.board.now, at)
            return data
        self.board.now += timeout
        return b""
