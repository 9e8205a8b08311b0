"""The messages that an image is installed with: requests to bytes, replies to dataclasses."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from neuroflight.flash.link.layouts import Values, read
from neuroflight.flash.link.payload import Reader
from neuroflight.flash.link.requests import WORD_BYTES
from neuroflight.toolchain.contract import (
    MSP_IMAGE_CONFIRMED,
    MSP_IMAGE_FITS,
    MSP_IMAGE_INSTALLED,
    MSP_IMAGE_NUMBERED,
    MSP_IMAGE_REJECTED,
    MSP_PAYLOAD_MAX,
    Msp,
)

OFFSET_BYTES = 4  # before the data in IMAGE_WRITE
DATA_BYTES_MAX = MSP_PAYLOAD_MAX - OFFSET_BYTES
HASH_BYTES = 32


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
    told = read(Msp.IMAGE_INFO, payload)
    banks = tuple(map(_bank, told["banks"]))
    running = told["running"]
    Reader(Msp.IMAGE_INFO, payload).check(
        len(banks) == 2 and running < len(banks), f"{len(banks)} banks, bank {running} running", "two banks"
    )
    return Banks(running, banks, told.get("layout", 1))  # the first one told none


def _bank(told: Values) -> Bank:
    flags = told["flags"]
    return Bank(
        fits=bool(flags & MSP_IMAGE_FITS),
        numbered=bool(flags & MSP_IMAGE_NUMBERED),
        confirmed=bool(flags & MSP_IMAGE_CONFIRMED),
        rejected=bool(flags & MSP_IMAGE_REJECTED),
        installed=bool(flags & MSP_IMAGE_INSTALLED),
        starts=told["starts"],
        sequence=told["sequence"],
        image_bytes=told["image_bytes"],
        crc=told["crc"],
        version=".".join(str(part) for part in told["version"][:3]),
        build=told["build"],
    )


def number(message: Msp, payload: bytes) -> int:
    """Decode IMAGE_BEGIN (offset to go on from), IMAGE_END (CRC-32 that was read back), IMAGE_SWITCH (the
    number that the image has got)."""
    return int(Reader(message, payload).fields("I")[0])


def image_write(offset: int, data: bytes) -> bytes:
    """Encode IMAGE_WRITE of `data`, which stands at `offset` of the image."""
    if not 0 < len(data) <= DATA_BYTES_MAX or offset % WORD_BYTES or len(data) % WORD_BYTES:
        raise ValueError(f"{len(data)} bytes at {offset}, expected multiples of {WORD_BYTES}")
    return struct.pack("<I", offset) + data


def image_hashed(payload: bytes) -> bytes:
    """Decode IMAGE_HASH: the SHA-256 of the bank's image."""
    return Reader(Msp.IMAGE_HASH, payload).bytes(HASH_BYTES)
