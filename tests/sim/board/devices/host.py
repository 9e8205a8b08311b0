"""A host of an SD card in SPI mode, written from the specification alone: bytes at the pins, and time."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from neuroflight.sim.board.devices.sd_card import SdCard

CYCLES_A_SECOND = 216_000_000
SLOW_HZ, FAST_HZ = 211_000, 13_500_000


def crc7(data: bytes) -> int:
    """Bit by bit, with the end bit."""
    value = 0
    for bit in (byte >> i & 1 for byte in data for i in range(7, -1, -1)):
        value = (value << 1 ^ (0x09 if (value >> 6 & 1) ^ bit else 0)) & 0x7F
    return value << 1 | 1


@cache
def crc16(data: bytes) -> bytes:
    """Bit by bit."""
    value = 0
    for bit in (byte >> i & 1 for byte in data for i in range(7, -1, -1)):
        value = (value << 1 ^ (0x1021 if (value >> 15 & 1) ^ bit else 0)) & 0xFFFF
    return value.to_bytes(2, "big")


class Host:
    """Clocks bytes through a card; `chunk` of them at a time at most."""

    def __init__(self, card: SdCard, *, chunk: int = 1 << 20) -> None:
        self.card, self.chunk = card, chunk
        self.cycle = CYCLES_A_SECOND // 100
        self.hz, self.mode = float(SLOW_HZ), 0
        self.selected, self.transaction = False, 0

    @property
    def length(self) -> int:
        """Of a byte [cycles]."""
        return round(8 * CYCLES_A_SECOND / self.hz)

    @property
    def seconds(self) -> float:
        return self.cycle / CYCLES_A_SECOND

    def select(self, on: bool) -> None:
        self.transaction += on != self.selected
        self.selected = on

    def send(self, sent: bytes) -> bytes:
        got = b""
        for place in range(0, len(sent), self.chunk):
            part = sent[place : place + self.chunk]
            got += self.card.exchange(
                part,
                self.cycle,
                self.length,
                self.hz,
                self.mode,
                selected=self.selected,
                transaction=self.transaction,
            )
            self.cycle += len(part) * self.length
        return got

    def rest(self, seconds: float) -> None:
        self.cycle += round(seconds * CYCLES_A_SECOND)

    def command(self, index: int, argument: int = 0, more: int = 0, *, crc: int | None = None) -> bytes:
        """R1 and `more` bytes; empty when nothing answers within 10 bytes."""
        frame = bytes([0x40 | index]) + argument.to_bytes(4, "big")
        self.select(True)
        self.send(frame + bytes([crc7(frame) if crc is None else crc]))
        if index == 12:
            self.send(b"\xff")  # what was under way
        for _ in range(10):
            first = self.send(b"\xff")
            if not first[0] & 0x80:
                return first + self.send(b"\xff" * more)
        return b""

    def application(self, index: int, argument: int = 0, more: int = 0) -> bytes:
        self.command(55)
        return self.command(index, argument, more)

    def start(self) -> None:
        """From power to the full clock."""
        self.hz = SLOW_HZ
        self.select(False)
        self.send(b"\xff" * 10)
        assert self.command(0) == b"\x01"
        assert self.command(8, 0x1AA, 4) == bytes((1, 0, 0, 1, 0xAA))
        for _ in range(1000):
            if self.application(41, 1 << 30) == b"\x00":
                break
            self.rest(0.001)
        assert self.command(58, 0, 4)[1] & 0xC0 == 0xC0
        assert self.command(59, 1) == b"\x00"
        self.select(False)
        self.send(b"\xff")
        self.hz = FAST_HZ

    def wait(self, limit_s: float = 1.0) -> float:
        """Until it is not busy; how long that took [s]."""
        begun = self.seconds
        while self.send(b"\xff" * 16)[-1] != 0xFF:
            assert self.seconds - begun < limit_s, "busy for too long"
        return self.seconds - begun

    def data(self, count: int = 512, limit_s: float = 0.5) -> bytes:
        """A data block; one byte for a data error token."""
        begun = self.seconds
        while (token := self.send(b"\xff")[0]) == 0xFF:
            assert self.seconds - begun < limit_s, "no data"
        if token != 0xFE:
            return bytes([token])
        block = self.send(b"\xff" * (count + 2))
        assert crc16(block[:count]) == block[count:], "checksum"
        return block[:count]

    def read(self, block: int, count: int = 1) -> bytes:
        assert self.command(18 if count > 1 else 17, block) == b"\x00"
        got = b"".join(self.data() for _ in range(count))
        if count > 1:
            self.command(12)
            self.wait()
        self.select(False)
        return got

    def put(self, token: int, block: bytes, crc: bytes | None = None) -> int:
        """The data response of a block, with its undefined bits off."""
        self.send(b"\xff" + bytes([token]) + block + (crc16(block) if crc is None else crc))
        return self.send(b"\xff")[0] & 0x1F

    def write(self, block: int, *data: bytes) -> list[int]:
        """The data response of each block."""
        several = len(data) > 1
        assert self.command(25 if several else 24, block) == b"\x00"
        responses = []
        for part in data:
            responses.append(self.put(0xFC if several else 0xFE, part))
            self.wait()
        if several:
            self.send(b"\xfd\xff")
            self.wait()
        self.select(False)
        return responses

    def erase(self, first: int, last: int) -> float:
        """How long it took [s]."""
        assert [self.command(32, first), self.command(33, last), self.command(38)] == [b"\x00"] * 3
        took = self.wait()
        self.select(False)
        return took


def blank(path: Path, blocks: int = 2048) -> Path:
    """An image of zeros."""
    path.write_bytes(bytes(512 * blocks))
    return path


def pattern(number: int) -> bytes:
    """A block unlike others."""
    return bytes((number * 7 + i * 13 + i // 256) & 0xFF for i in range(512))


def blocks_of(path: Path, first: int, count: int = 1) -> bytes:
    """What the file has."""
    with path.open("rb") as file:
        file.seek(512 * first)
        return file.read(512 * count)
