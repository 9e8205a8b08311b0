"""An image in its bank: the header behind its vectors, and the state that the board keeps at the bank's end.

A bank is a sector of flash: vectors | header | board's description (board_format.py) | code and constants |
erased | state. The same code flies on every board. The header's CRC-32 covers the image from the bank's first
byte to `image_bytes`, its own four bytes left out. The state's words are erased with the bank and written one
by one; each is of use only as a whole, so that a loss of power leaves the old state or the new one.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

from neuroflight.toolchain.contract.policy_format import IMAGE_BUILD_BYTES, HeaderField, PolicyHeader

__all__ = [
    "IMAGE_BOARD_BYTES",
    "IMAGE_BUILD_BYTES",
    "IMAGE_FIELDS",
    "IMAGE_FILE_BYTES_MAX",
    "IMAGE_HEADER_FORMAT",
    "IMAGE_HEADER_OFFSET",
    "IMAGE_LAYOUT",
    "IMAGE_MAGIC",
    "IMAGE_NUMBER_ENTRIES",
    "IMAGE_NUMBER_WORDS",
    "IMAGE_PROBATION_MAX_MS",
    "IMAGE_PROBATION_MS",
    "IMAGE_STARTS_MAX",
    "IMAGE_STATE_FIELDS",
    "IMAGE_STATE_FORMAT",
    "IMAGE_TABLE_OFFSET",
    "IMAGE_TAIL_BYTES",
    "ImageHeader",
    "image_checksum",
    "image_field_offset",
    "image_header",
]
IMAGE_MAGIC = 0x4D49464E  # "NFIM"
IMAGE_LAYOUT = 3  # of header, state and flash map; boot part and image must have the same
IMAGE_HEADER_OFFSET = 512  # bytes from the bank's begin: behind the vectors
IMAGE_BOARD_BYTES = 24  # BOARD_NAME_BYTES
IMAGE_STARTS_MAX = 2  # of an image that was not confirmed; then the other bank's is started
# An image on probation is confirmed after its control steps and policy have run well for the first time. It
# gives up if that has not happened within the second time, silences of the gyro not counted.
IMAGE_PROBATION_MS, IMAGE_PROBATION_MAX_MS = 2000, 10000
IMAGE_FILE_BYTES_MAX = 4 << 20  # of any file that an image is read from; an ELF brings its names and lines

IMAGE_FIELDS = (
    HeaderField("uint32_t", "magic", "", "NFIM, in that order in memory"),
    HeaderField("uint16_t", "layout", "", "version of this layout and of the flash map"),
    HeaderField("uint8_t", "bank", "", "that it is linked for: 0 bank A, 1 bank B"),
    HeaderField("uint8_t", "reserved", "", "0"),
    HeaderField("uint32_t", "image_bytes", "bytes", "from the bank's begin, a multiple of 4"),
    HeaderField("uint32_t", "crc", "", "CRC-32 of these bytes without this field"),
    HeaderField("uint8_t", "version", "", "major, minor, patch, 0", 4),
    HeaderField(
        "uint8_t", "build", "", "the same in both banks of a build, other in any other", IMAGE_BUILD_BYTES
    ),
    HeaderField("char", "board", "", "ASCII, then 0: the target it is built for", IMAGE_BOARD_BYTES),
    # Properties that a policy must have for this image to fly it: the blob's fields of these names.
    HeaderField("uint32_t", "architecture_hash", "", "of the policies that it can fly, as all that follow"),
    HeaderField("uint32_t", "filters_hash", "", "CRC-32 of the gyro filters' JSON list"),
    HeaderField("uint32_t", "control_rate_hz", "Hz", ""),
    HeaderField("uint32_t", "weight_count", "floats", ""),
    HeaderField("uint16_t", "observation_count", "floats", ""),
    HeaderField("uint16_t", "action_count", "floats", ""),
)
IMAGE_HEADER_FORMAT = "<" + "".join(field.format for field in IMAGE_FIELDS)
IMAGE_TABLE_OFFSET = IMAGE_HEADER_OFFSET + struct.calcsize(IMAGE_HEADER_FORMAT)  # of the board's description

# At the end of the bank. A flag is set by a word of zeros. The bank's number stands in the first entry of
# `numbers` whose second word is the first one's complement. A loss of power may spoil an entry: what it
# leaves has a bit that is 1 in both words, for programming only clears bits. Then the next entry is used.
IMAGE_NUMBER_ENTRIES = 4
IMAGE_NUMBER_WORDS = 2
IMAGE_STATE_FIELDS = (
    HeaderField("uint32_t", "written", "", "0: by the firmware; erased: by the chip's ROM"),
    HeaderField(
        "uint32_t",
        "numbers",
        "",
        "of two images the newer one is started",
        IMAGE_NUMBER_ENTRIES * IMAGE_NUMBER_WORDS,
    ),
    HeaderField(
        "uint32_t", "starts", "", "0 each: one more start of an image not confirmed", IMAGE_STARTS_MAX
    ),
    HeaderField("uint32_t", "rejected", "", "0: it is not started any more where there is another one"),
    HeaderField("uint32_t", "confirmed", "", "0: it has run well"),
)
IMAGE_STATE_FORMAT = "<" + "".join(field.format for field in IMAGE_STATE_FIELDS)
IMAGE_TAIL_BYTES = 128  # of the bank, its last: they begin with the state


def image_field_offset(name: str) -> int:
    """Return the offset of a header field from the bank's start [bytes]."""
    names = [field.name for field in IMAGE_FIELDS]
    before = "<" + "".join(field.format for field in IMAGE_FIELDS[: names.index(name)])
    return IMAGE_HEADER_OFFSET + struct.calcsize(before)


def image_checksum(image: bytes | bytearray) -> int:
    """Compute the CRC-32 of an image, from the bank's start to the image's end, as in its header."""
    at = image_field_offset("crc")
    return zlib.crc32(image[at + 4 :], zlib.crc32(image[:at]))


@dataclass(frozen=True)
class ImageHeader:
    """The header of an image, unchecked except for its magic number."""

    layout: int
    bank: int
    image_bytes: int
    crc: int
    version: str  # major.minor.patch
    build: bytes
    board: str  # whatever is not printable shows as ?
    architecture_hash: int  # of the policies that it flies, as all that follow
    filters_hash: int
    control_rate_hz: int
    weight_count: int
    observation_count: int
    action_count: int
    raw: bytes  # as it lies in flash

    def misfit(self, policy: PolicyHeader) -> str | None:
        """Return a text about the first misfit between this image and that policy; None if it can fly it."""
        for name in (
            *("control_rate_hz", "filters_hash", "weight_count", "observation_count", "action_count"),
            "architecture_hash",
        ):
            has, asks = getattr(policy, name), getattr(self, name)
            if has != asks:
                return f"its {name} is {has}, the image asks for {asks}"
        return None


def image_header(image: bytes | bytearray) -> ImageHeader | None:
    """Decode the header of an image that starts at the bank's first byte; None if there is none."""
    end = IMAGE_HEADER_OFFSET + struct.calcsize(IMAGE_HEADER_FORMAT)
    if len(image) < end:
        return None
    values = struct.unpack_from(IMAGE_HEADER_FORMAT, image, IMAGE_HEADER_OFFSET)
    told = dict(zip((field.name for field in IMAGE_FIELDS), values, strict=True))
    if told["magic"] != IMAGE_MAGIC:
        return None
    board = told["board"].partition(b"\0")[0].decode("latin-1")
    told["board"] = "".join(c if " " <= c <= "~" else "?" for c in board)
    told["version"] = ".".join(str(part) for part in told["version"][:3])
    told["raw"] = bytes(image[IMAGE_HEADER_OFFSET:end])
    return ImageHeader(**{name: told[name] for name in ImageHeader.__dataclass_fields__})
