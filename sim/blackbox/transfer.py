"""Detect logs whose bytes a transfer as text has changed or removed, which makes values wrong unnoticed.

Frames hold every byte. One that does not occur while those beside it do, each in EXPECTED places or more, is
not missing by chance: a count of 20 comes out as 0 once in 5e8 times. Short logs have too few bytes for that.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

EXPECTED = 20
BYTES_MAX = 16 << 20  # bytes that are examined
TEXT_BYTES_MIN = 512  # so many bytes of UTF-8 are not frames, whose numbers above 63 have bytes above 0x7F
_CUT = 3  # bytes of a character whose rest is cut off
_LF, _CR = 0x0A, 0x0D
_REPLACED = "\ufffd".encode()
# Bytes that are lost together, and what loses them.
_EATEN = (
    ((_CR,), "0x0D: line ends were changed"),
    ((_LF,), "0x0A: line ends were changed"),
    ((0x11, 0x13), "0x11 or 0x13: a line with XON/XOFF took them"),
    ((0x00,), "0x00: it went as a text that ends at them"),
)
_SPECIAL = frozenset(byte for eaten, _ in _EATEN for byte in eaten)


def text_transfer(body: bytes) -> str:
    """Return a note if the frames were damaged by a transfer as text, and how; else ""."""
    if len(body) >= TEXT_BYTES_MIN and _is_utf_8(body):
        what = "bytes above 0x7F are replaced" if _REPLACED in body else "they are UTF-8"
        return f"the frames went through a transfer as text ({what}): nothing of them can be relied on"
    data = np.frombuffer(body[:BYTES_MAX], np.uint8).astype(np.int32)
    counts = np.bincount(data, minlength=256)
    words = next((f"no byte {told}" for eaten, told in _EATEN if _missing(data, counts, eaten)), "")
    before = data[:-1][data[1:] == _LF]
    if len(before) >= EXPECTED and (before == _CR).all():
        words = "each byte 0x0A has 0x0D before it"
    if not words:
        return ""
    return f"the frames went through a transfer as text ({words}): some values are wrong, unseen"


def _missing(data: NDArray[np.int32], counts: NDArray[np.int64], eaten: tuple[int, ...]) -> bool:
    """Return True if these bytes never occur though the values next to theirs do, in EXPECTED places."""
    if len(data) < EXPECTED or counts[list(eaten)].any():
        return False
    beside = [byte for byte in range(eaten[0] - 4, eaten[-1] + 5) if byte >= 0 and byte not in _SPECIAL]
    # Identical frames count once: repetition is no further evidence.
    places = np.unique(data[1:-1] << 16 | data[:-2] << 8 | data[2:])
    return bool((np.bincount(places >> 16, minlength=256)[beside] >= EXPECTED).all())


def _is_utf_8(body: bytes) -> bool:
    """Return True if `body`, which may begin and end within a character, is UTF-8."""
    start = next((at for at in range(_CUT + 1) if body[at] & 0xC0 != 0x80), 0)
    try:
        body[start:].decode()
    except UnicodeDecodeError as error:
        return error.reason == "unexpected end of data" and error.start + start >= len(body) - _CUT
    return True
