"""Encodings of the format: from bytes to the stored numbers, to which the prediction is added later.

Each reader takes the data, where its bytes begin, and how many fields it fills; it returns their numbers and
where the next byte stands. 32-bit numbers are signed or unsigned as the encoding says. Readers raise
IndexError at the end of the data, ValueError on bytes that no firmware writes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

WORD = 1 << 32
UNSIGNED_VB, SIGNED_VB, NEG_14BIT, TAG8_8SVB, TAG2_3S32, TAG8_4S16, NOTHING = 1, 0, 3, 6, 7, 8, 9
FIELDS = {TAG8_8SVB: 8, TAG2_3S32: 3, TAG8_4S16: 4}  # most fields in a group; other encodings have one field

Reader = Callable[[bytes, int, int], tuple[Sequence[int], int]]


def unsigned(data: bytes, at: int) -> tuple[int, int]:
    """Read an integer of up to five bytes, 7 bits each, the lowest first."""
    byte = data[at]
    if byte < 0x80:
        return byte, at + 1
    result = byte & 0x7F
    for shift in (7, 14, 21, 28):
        at += 1
        byte = data[at]
        result |= (byte & 0x7F) << shift
        if byte < 0x80:
            return result % WORD, at + 1
    raise ValueError("an integer of more than five bytes")


def signed_of(word: int) -> int:
    """Return the number whose sign is the lowest bit of `word`."""
    return (word >> 1) ^ -(word & 1)


def _extended(value: int, bits: int) -> int:
    """Return `value` of `bits` bits in two's complement."""
    return value - (1 << bits) if value >> (bits - 1) else value


def _unsigned_vb(data: bytes, at: int, _: int) -> tuple[Sequence[int], int]:
    value, at = unsigned(data, at)
    return (value,), at


def _signed_vb(data: bytes, at: int, _: int) -> tuple[Sequence[int], int]:
    word, at = unsigned(data, at)
    return (signed_of(word),), at


def _neg_14bit(data: bytes, at: int, _: int) -> tuple[Sequence[int], int]:
    value, at = unsigned(data, at)
    return (-_extended(value & 0x3FFF, 14),), at


def _nothing(_: bytes, at: int, count: int) -> tuple[Sequence[int], int]:
    return (0,) * count, at


def _tag8_8svb(data: bytes, at: int, count: int) -> tuple[Sequence[int], int]:
    """Read a byte of bits that mark fields other than 0, then these; a single field has no such byte."""
    if count == 1:
        return _signed_vb(data, at, 1)
    tags = data[at]
    at += 1
    if not tags:
        return (0,) * count, at
    if tags >> count:
        raise ValueError("a tag of a field that is not in the group")
    values = []
    for _ in range(count):
        word = 0
        if tags & 1:
            word, at = unsigned(data, at)
        values.append(signed_of(word))
        tags >>= 1
    return values, at


def _tag2_3s32(data: bytes, at: int, _: int) -> tuple[Sequence[int], int]:
    """Read three fields of 2, 4 or 6 bits, or of 1 to 4 bytes each."""
    lead = data[at]
    kind = lead >> 6
    if kind == 0:
        return (_extended(lead >> 4 & 3, 2), _extended(lead >> 2 & 3, 2), _extended(lead & 3, 2)), at + 1
    if kind == 1:
        byte = data[at + 1]
        return (_extended(lead & 15, 4), _extended(byte >> 4, 4), _extended(byte & 15, 4)), at + 2
    if kind == 2:
        return tuple(_extended(byte & 63, 6) for byte in (lead, data[at + 1], data[at + 2])), at + 3
    at += 1
    values = []
    for field in range(3):
        size = (lead >> 2 * field & 3) + 1
        if at + size > len(data):
            raise IndexError
        values.append(int.from_bytes(data[at : at + size], "little", signed=True))
        at += size
    return values, at


def _tag8_4s16(data: bytes, at: int, _: int) -> tuple[Sequence[int], int]:
    """Read four fields of 0, 4, 8 or 16 bits, packed, the upper half of a byte first."""
    tags = data[at]
    at += 1
    values = []
    held, bits = 0, 0  # what is left of the last byte
    for field in range(4):
        size = (0, 4, 8, 16)[tags >> 2 * field & 3]
        while bits < size:
            held = held << 8 | data[at]
            bits += 8
            at += 1
        bits -= size
        values.append(_extended(held >> bits, size) if size else 0)
        held &= (1 << bits) - 1
    return values, at


def read_tag8_4s16_1(data: bytes, at: int, _: int) -> tuple[Sequence[int], int]:
    """Read four fields of data version 1: two of 4 bits share a byte, the lower half first."""
    tags = data[at]
    at += 1
    values: list[int] = []
    while len(values) < 4:
        size = tags >> 2 * len(values) & 3
        if size == 0:
            values.append(0)
        elif size == 1:
            values += (_extended(data[at] & 15, 4), _extended(data[at] >> 4, 4))
            at += 1
        else:
            if at + size > len(data) + 1:
                raise IndexError
            values.append(int.from_bytes(data[at : at + size - 1], "little", signed=True))
            at += size - 1
    return values[:4], at


READERS: dict[int, Reader] = {
    SIGNED_VB: _signed_vb,
    UNSIGNED_VB: _unsigned_vb,
    NEG_14BIT: _neg_14bit,
    TAG8_8SVB: _tag8_8svb,
    TAG2_3S32: _tag2_3s32,
    TAG8_4S16: _tag8_4s16,
    NOTHING: _nothing,
}
