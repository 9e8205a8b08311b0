"""Images for a bank that nothing runs: a header that fits, noise behind it, a checksum that holds."""

from __future__ import annotations

import hashlib
import struct

import numpy as np

from neuroflight.toolchain import contract

HEADER_BYTES = struct.calcsize(contract.IMAGE_HEADER_FORMAT)
LEAST_BYTES = contract.IMAGE_HEADER_OFFSET + HEADER_BYTES
MOST_BYTES = contract.FLASH_BANK_A.size - contract.IMAGE_TAIL_BYTES


IDENTITY = (
    *("architecture_hash", "filters_hash", "control_rate_hz", "weight_count", "observation_count"),
    "action_count",
)


def build_of(seed: int) -> bytes:
    """The build of an image that make_image makes."""
    return hashlib.sha256(seed.to_bytes(4, "little")).digest()[: contract.IMAGE_BUILD_BYTES]


def make_image(
    seed: int,
    size: int = LEAST_BYTES + 64,
    *,
    bank: int = 1,
    board: str = "HOST",
    policy: contract.PolicyHeader | None = None,
) -> bytes:
    """An image of `size` bytes for that bank and board; another seed makes another one.

    policy: one of those that it flies; None: there is none.
    """
    image = bytearray(np.random.default_rng(seed).bytes(size))
    header = struct.pack(
        contract.IMAGE_HEADER_FORMAT,
        *(contract.IMAGE_MAGIC, contract.IMAGE_LAYOUT, bank, 0, size, 0, bytes(contract.VERSION) + b"\0"),
        *(build_of(seed), board.encode()),
        *(0 if policy is None else getattr(policy, name) for name in IDENTITY),
    )
    image[contract.IMAGE_HEADER_OFFSET : LEAST_BYTES] = header
    return stamped(image)


def changed(image: bytes, field: str, value: bytes) -> bytes:
    """The image with another value of a field of its header, and a checksum that holds."""
    other, at = bytearray(image), contract.image_field_offset(field)
    other[at : at + len(value)] = value
    return stamped(other)


def stamped(image: bytes | bytearray) -> bytes:
    """The image with a checksum that holds."""
    at = contract.image_field_offset("crc")
    return bytes(image[:at]) + struct.pack("<I", contract.image_checksum(image)) + bytes(image[at + 4 :])


def header_of(image: bytes) -> bytes:
    """Its header."""
    return image[contract.IMAGE_HEADER_OFFSET : LEAST_BYTES]


def crc_of(image: bytes) -> int:
    """The checksum in its header."""
    return int(struct.unpack_from("<I", image, contract.image_field_offset("crc"))[0])
