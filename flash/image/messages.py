"""The messages that an image is installed with: requests to bytes, replies to dataclasses."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from neuroflight.flash.link.payload import Reader
from neuroflight.flash.link.requests import WORD_BYTES
from neuroflight.toolchain.contract import IMAGE_BUILD_BYTES, MSP_PAYLOAD_MAX, Msp

OFFSET_BYTES = 4  # before the data in IMAGE_WRITE
DATA_BYTES_MAX = MSP_PAYLOAD_MAX - OFFSET_BYTES
HASH_BYTES = 32
_FITS, _NUMBERED, _CONFIRMED, _REJECTED, _INSTALLED = (1 << bit for bit in range(5))


@dataclass(frozen=True)
class Bank:
    """The state of the image in one of a board's banks."""

    fits: bool  # the header is one of an image for this board and bank; else the rest says nothing
    numbered: bool  # written completely and chosen
    confirmed: bool  # it has run well
    rejected: bool  # no longer started if there is another image
    installed: bool  # by the chip's ROM
    starts: int  # starts of an image that is not confirmed yet
    sequence: int
    image_bytes: int
    crc: int
    version: str  # major.minor.patch
    build: bytes


@dataclass(frozen=True)
class Banks:
    """All banks of a board, and which one runs."""

    running: int
    banks: tuple[Bank, ...]
    layout: int  # of images and flash map that the running firmware knows

    @property
    def spare(self) -> int:
        """The bank that an update goes to."""
        return 1 - self.running

    @property
    def now(self) -> Bank:
        """The running bank's image."""
        return self.banks[self.running]


def image_info(payload: bytes) -> Banks:
    """Decode IMAGE_INFO. Raises LinkError where it does not tell of two banks."""
    reader = Reader(Msp.IMAGE_INFO, payload)
    running, count = reader.fields("BB")
    banks = tuple(_bank(reader) for _ in range(count))
    reader.check(count == 2 and running < count, f"{count} banks, bank {running} running", "two banks")
    (layout,) = reader.fields("B") if reader.at < len(payload) else (1,)  # the first one told none
    return Banks(running, banks, layout)


def _bank(reader: Reader) -> Bank:
    flags, starts, sequence, image_bytes, crc = reader.fields("BBIII")
    version = reader.bytes(4)
    build = reader.bytes(IMAGE_BUILD_BYTES)
    return Bank(
        fits=bool(flags & _FITS),
        numbered=bool(flags & _NUMBERED),
        confirmed=bool(flags & _CONFIRMED),
        rejected=bool(flags & _REJECTED),
        installed=bool(flags & _INSTALLED),
        starts=starts,
        sequence=sequence,
        image_bytes=image_bytes,
        crc=crc,
        version=".".join(str(part) for part in version[:3]),
        build=build,
    )


def image_begun(payload: bytes) -> int:
    """Decode IMAGE_BEGIN: the offset at which writing continues [bytes]."""
    (offset,) = Reader(Msp.IMAGE_BEGIN, payload).fields("I")
    return int(offset)


def image_write(offset: int, data: bytes) -> bytes:
    """Encode IMAGE_WRITE of `data`, which stands at `offset` of the image."""
    if not 0 < len(data) <= DATA_BYTES_MAX or offset % WORD_BYTES or len(data) % WORD_BYTES:
        raise ValueError(f"{len(data)} bytes at {offset}, expected multiples of {WORD_BYTES}")
    return struct.pack("<I", offset) + data


def image_ended(payload: bytes) -> int:
    """Decode IMAGE_END: the CRC-32 that was read back from flash."""
    (crc,) = Reader(Msp.IMAGE_END, payload).fields("I")
    return int(crc)


def image_hash(bank: int) -> bytes:
    """Encode IMAGE_HASH."""
    return struct.pack("<B", bank)


def image_hashed(payload: bytes) -> bytes:
    """Decode IMAGE_HASH: the SHA-256 of the bank's image."""
    return Reader(Msp.IMAGE_HASH, payload).bytes(HASH_BYTES)


def image_switch(sha256: bytes) -> bytes:
    """Encode IMAGE_SWITCH to the spare bank's image of that hash."""
    if len(sha256) != HASH_BYTES:
        raise ValueError(f"a hash of {len(sha256)} bytes, expected {HASH_BYTES}")
    return sha256


def image_switched(payload: bytes) -> int:
    """Decode IMAGE_SWITCH: the number that the image has got."""
    (sequence,) = Reader(Msp.IMAGE_SWITCH, payload).fields("I")
    return int(sequence)
