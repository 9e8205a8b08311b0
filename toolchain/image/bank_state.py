"""What a board keeps of the image in a bank: the marks of firmware/src/storage/image_bank.h, as bytes."""

from __future__ import annotations

import struct

from neuroflight.toolchain.contract import (
    FLASH_BANK_A,
    FLASH_BASE,
    IMAGE_HEADER_OFFSET,
    IMAGE_MAGIC,
    IMAGE_NUMBER_ENTRIES,
    IMAGE_NUMBER_WORDS,
    IMAGE_STARTS_MAX,
    IMAGE_STATE_FORMAT,
    IMAGE_TAIL_BYTES,
)

_ERASED = 0xFFFFFFFF
_AT = FLASH_BANK_A.address - FLASH_BASE


def state(*, sequence: int, confirmed: bool, written: bool = False) -> bytes:
    """The state of a bank whose image has the number `sequence`: its first words, at the bank's tail."""
    number = struct.pack("<2I", sequence, sequence ^ _ERASED)
    return struct.pack(
        IMAGE_STATE_FORMAT,
        0 if written else _ERASED,
        number.ljust(4 * IMAGE_NUMBER_WORDS * IMAGE_NUMBER_ENTRIES, b"\xff"),
        struct.pack(f"<{IMAGE_STARTS_MAX}I", *(_ERASED,) * IMAGE_STARTS_MAX),
        _ERASED,
        0 if confirmed else _ERASED,
    )


def proven(flash: bytes) -> bytes:
    """The flash of a board on which the image of bank A has run well before.

    flash: bytes from its begin on, such as a .bin; without an image they stay as they are.
    """
    magic = flash[_AT + IMAGE_HEADER_OFFSET :][:4]
    tail = _AT + FLASH_BANK_A.size - IMAGE_TAIL_BYTES
    if magic != struct.pack("<I", IMAGE_MAGIC) or flash[tail : tail + IMAGE_TAIL_BYTES].strip(b"\xff"):
        return flash
    marks = state(sequence=1, confirmed=True)
    return flash[:tail].ljust(tail, b"\xff") + marks + flash[tail + len(marks) :]
