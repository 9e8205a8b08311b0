"""A transfer as text changes or loses some bytes of a log, and values are wrong unseen: the traces it leaves.

Frames hold every byte. One that does not occur while those beside it do, each EXPECTED times or more, is not
missing by chance: a count of 20 comes out as 0 once in 5e8 times. Shorter logs tell too little.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

EXPECTED = 20
TEXT_BYTES_MIN = 512  # that are no frames if they are UTF-8: each number above 63 has a byte above 0x7F
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
    """How the frames of a log show that they were transferred as text, in words; "" where they do not."""
    if len(body) >= TEXT_BYTES_MIN and _is_utf_8(body):
        what = "bytes above 0x7F are replaced" if _REPLACED in body else "they are UTF-8"
        return f"the frames went through a transfer as text ({what}): nothing of them can be relied on"
    data = np.frombuffer(body, np.uint8)
    counts = np.bincount(data, minlength=256)
    words = next((f"no byte {told}" for eaten, told in _EATEN if _missing(counts, eaten)), "")
    behind_cr = np.bincount(data[1:][data[:-1] == _CR], minlength=256)
    before_lf = np.bincount(data[:-1][data[1:] == _LF], minlength=256)
    if counts[_LF] >= EXPECTED and before_lf[_CR] == counts[_LF]:
        words = "each byte 0x0A has 0x0D before it"
    elif not words and _missing(behind_cr, (_LF,)) and _missing(before_lf, (_CR,)):
        words = "no byte 0x0A behind 0x0D: line ends were changed"
    return (
        f"the frames went through a transfer as text ({words}): some values are wrong, unseen"
        if words
        else ""
    )


def _missing(counts: NDArray[np.int64], eaten: tuple[int, ...]) -> bool:
    """Whether these bytes do not occur though those beside them do."""
    if counts[list(eaten)].any():
        return False
    beside = [byte for byte in range(eaten[0] - 4, eaten[-1] + 5) if byte >= 0 and byte not in _SPECIAL]
    return bool((counts[beside] >= EXPECTED).all())


def _is_utf_8(body: bytes) -> bool:
    """Whether `body`, which may begin and end within a character, is UTF-8."""
    start = next((at for at in range(_CUT + 1) if body[at] & 0xC0 != 0x80), 0)
    try:
        body[start:].decode()
    except UnicodeDecodeError as error:
        return error.reason == "unexpected end of data" and error.start + start >= len(body) - _CUT
    return True
