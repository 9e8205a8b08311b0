"""Damaged logs made of good ones, each by its number: the same number gives the same bytes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.random import Generator

COUNT = 2000
HOSTILE = (
    b"H I interval:0\n",
    b"H I interval:99999999999999999999\n",
    b"H P interval:0/0\n",
    b"H P interval:1/65536\n",
    b"H P interval:-3\n",
    b"H Data version:0xffffffffffffffffffff\n",
    b"H motorOutput:,\n",
    b"H vbatref:1e400\n",
    b"H gyro_scale:0xzz\n",
    b"H looptime:nan\n",
    b"H Field I predictor:\n",
    b"H Field P encoding:" + b"6," * 300 + b"6\n",
    b"H Field S encoding:10\n",
    b"H Field G name:" + b"," * 5000 + b"\n",
    b"H Field I decoderfun:__import__('os')\n",
    b"H nf_version:" + b"\xff\x00\x1b[2J" * 40 + b"\n",
    b"H " + b"x" * 20_000 + b"\n",
    b"H x:y\n" * 10_000,
    b"H \n",
    b"H Product:Blackbox flight data recorder by Nicholas Sherlock\n",
)


def cut(data: bytes, rng: Generator) -> bytes:
    """The end is lost."""
    return data[: int(rng.integers(0, len(data)))]


def cut_start(data: bytes, rng: Generator) -> bytes:
    """The beginning is lost."""
    return data[int(rng.integers(0, len(data))) :]


def bits(data: bytes, rng: Generator) -> bytes:
    """Some bits are wrong."""
    out = bytearray(data)
    for at in rng.integers(0, len(out), int(rng.integers(1, 30))):
        out[at] ^= 1 << int(rng.integers(8))
    return bytes(out)


def inserted(data: bytes, rng: Generator) -> bytes:
    """Bytes that belong to nothing."""
    at, count = int(rng.integers(0, len(data))), int(rng.integers(1, 600))
    return data[:at] + rng.bytes(count) + data[at:]


def deleted(data: bytes, rng: Generator) -> bytes:
    """Bytes that lack."""
    at, count = int(rng.integers(0, len(data))), int(rng.integers(1, 600))
    return data[:at] + data[at + count :]


def blanked(data: bytes, rng: Generator) -> bytes:
    """A block of zeros or ones, as a card gives instead of a sector."""
    at = int(rng.integers(0, len(data))) & ~511
    return data[:at] + (b"\0", b"\xff")[int(rng.integers(2))] * 512 + data[at + 512 :]


def twice(data: bytes, rng: Generator) -> bytes:
    """A block that comes twice."""
    at = int(rng.integers(0, len(data)))
    return data[: at + 512] + data[at:]


def headers(data: bytes, rng: Generator) -> bytes:
    """Wrong bits in the header lines."""
    out = bytearray(data)
    end = _body(data)
    for at in rng.integers(0, end, int(rng.integers(1, 12))):
        out[at] = int(rng.integers(256))
    return bytes(out)


def line_lost(data: bytes, rng: Generator) -> bytes:
    """A header line is lost."""
    lines = data[: _body(data)].splitlines(keepends=True)
    del lines[int(rng.integers(len(lines)))]
    return b"".join(lines) + data[_body(data) :]


def hostile(data: bytes, rng: Generator) -> bytes:
    """Header lines that no firmware writes, before all others of their name."""
    first = data.index(b"\n") + 1
    return data[:first] + bytes(rng.choice(np.array(HOSTILE, object))) + data[first:]


def noise(data: bytes, rng: Generator) -> bytes:
    """Frames that are noise, behind good header lines."""
    return data[: _body(data)] + rng.bytes(20_000)


def letters(data: bytes, rng: Generator) -> bytes:
    """Noise of the bytes that frames begin with."""
    return data[: _body(data)] + bytes(rng.choice(np.frombuffer(b"IPSGHE\0", np.uint8), 5_000))


DAMAGES: tuple[Callable[[bytes, Generator], bytes], ...] = (
    *(cut, cut_start, bits, inserted, deleted, blanked, twice),
    *(headers, line_lost, hostile, noise, letters),
)


def damaged(logs: list[bytes], number: int) -> tuple[str, bytes]:
    """What was done, and the damaged log of that number."""
    rng = np.random.default_rng((20, number))
    data = logs[number % len(logs)]
    made = [DAMAGES[int(rng.integers(len(DAMAGES)))] for _ in range(int(rng.integers(1, 3)))]
    for one in made:
        if data.count(b"\n") > 1:
            data = one(data, rng)
    return " ".join(one.__name__ for one in made), data


def _body(data: bytes) -> int:
    """Where the frames begin, of a log that is whole up to there."""
    at = 0
    while data.startswith(b"H ", at) and b"\n" in data[at : at + 30_000]:
        at = data.index(b"\n", at) + 1
    return max(at, 1)
