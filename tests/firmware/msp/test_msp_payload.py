"""msp_payload.c: numbers and texts into a payload and out of it, and not past its end."""

from __future__ import annotations

import math
import struct
from typing import Any

import pytest

GUARD = b"\xa5" * 8


class Writer:
    """A payload of `size` bytes with a guard behind it."""

    def __init__(self, core: Any, size: int) -> None:
        self.core, self.size = core, size
        self._bytes = core.new("uint8_t[]", bytes(size) + GUARD)
        self.writer = core.new("struct msp_writer *", (self._bytes, self._bytes + size))

    @property
    def written(self) -> bytes:
        content = bytes(self._bytes)
        assert content[self.size : self.size + len(GUARD)] == GUARD
        return content[: self.writer.at - self._bytes]


def test_numbers_are_little_endian_when_put(scripted: Any) -> None:
    w = Writer(scripted, 40)
    scripted.lib.msp_put_u8(w.writer, 0x1FF)
    scripted.lib.msp_put_u16(w.writer, 0x12345)
    scripted.lib.msp_put_u32(w.writer, 0x89ABCDEF)
    scripted.lib.msp_put_float(w.writer, 0.1)
    scripted.lib.msp_put_bytes(w.writer, b"abc", 3)
    scripted.lib.msp_put_zeros(w.writer, 2)
    assert w.written == struct.pack("<BHIf", 0xFF, 0x2345, 0x89ABCDEF, 0.1) + b"abc\0\0"


@pytest.mark.parametrize("size", range(12))
def test_nothing_is_put_past_the_end_when_a_payload_is_full(scripted: Any, size: int) -> None:
    w = Writer(scripted, size)
    scripted.lib.msp_put_u32(w.writer, 0x04030201)
    scripted.lib.msp_put_bytes(w.writer, bytes(range(5, 20)), 15)
    assert w.written == bytes(range(1, 20))[:size]


@pytest.mark.parametrize(
    ("value", "put"),
    [
        *((0.0, 0), (0.49, 0), (0.5, 1), (-0.49, 0), (-0.5, -1), (1233.7, 1234), (-1233.7, -1234)),
        *((32767.0, 32767), (32767.4, 32767), (1e9, 32767), (math.inf, 32767)),
        *((-32768.0, -32768), (-1e9, -32768), (-math.inf, -32768), (math.nan, 0)),
    ],
)
def test_a_fraction_is_rounded_and_held_when_put_in_16_bits(scripted: Any, value: float, put: int) -> None:
    w = Writer(scripted, 2)
    scripted.lib.msp_put_rounded(w.writer, value)
    assert w.written == struct.pack("<h", put)


@pytest.mark.parametrize(
    ("text", "most", "put"),
    [
        *((b"", 9, b""), (b"nf1", 9, b"nf1"), (b"nf1", 3, b"nf1"), (b"nf1", 2, b"nf"), (b"nf1", 0, b"")),
        (b"x" * 40, 100, b"x" * 32),
    ],
)
def test_a_text_is_counted_and_cut_when_it_is_too_long(
    scripted: Any, text: bytes, most: int, put: bytes
) -> None:
    w = Writer(scripted, 60)
    scripted.lib.msp_put_counted_text(w.writer, text, most)
    assert w.written == bytes([len(put)]) + put
    w = Writer(scripted, 60)
    scripted.lib.msp_put_text(w.writer, text, most)
    assert w.written == text[:most]


def test_numbers_come_back_and_then_zeros_when_taken(scripted: Any) -> None:
    data = scripted.new("uint8_t[]", struct.pack("<BHIB", 0xFE, 0xABCD, 0x89ABCDEF, 0x77))
    reader = scripted.new("struct msp_reader *", (data, 8))
    lib = scripted.lib
    assert (lib.msp_take_u8(reader), lib.msp_take_u16(reader)) == (0xFE, 0xABCD)
    assert lib.msp_take_u32(reader) == 0x89ABCDEF
    assert lib.msp_take_u16(reader) == 0x77, "half of it is there"
    assert (lib.msp_take_u8(reader), lib.msp_take_u16(reader), lib.msp_take_u32(reader)) == (0, 0, 0)
    assert reader.left == 0
