"""The state that a board keeps of a bank's image, as bytes: firmware/src/storage/image_bank.h."""

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
    """Encode the state of a bank whose image has the number `sequence`, for the bank's tail."""
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
    """Return the flash of a board on which the image of bank A has run successfully before.

    flash: bytes from its start on, such as a .bin; without an image they are returned unchanged.
    """
    magic = flash[_AT + IMAGE_HEADER_OFFSET :][:4]
    tail = _AT + FLASH_BANK_A.size - IMAGE_TAIL_BYTES
    if magic != struct.pack("<I", IMAGE_MAGIC) or flash[tail : tail + IMAGE_TAIL_BYTES].strip(b"\xff"):
        return flash
    marks = state(sequence=1, confirmed=True)
    return flash[:tail].ljust(tail, b"\xff") + marks + flash[tail + len(marks) :]
