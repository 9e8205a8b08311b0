"""A check that an image would start on its board and fly: vectors, header, checksum, policy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NoReturn

from neuroflight.flash.rom.segments import Segment, content_of
from neuroflight.toolchain.contract import (
    DTCM,
    FLASH_BANKS,
    FLASH_BASE,
    FLASH_BYTES,
    FLASH_POLICY_SLOTS,
    IMAGE_HEADER_OFFSET,
    IMAGE_LAYOUT,
    POLICY_BLOB_CRC_BYTES,
    POLICY_BLOB_LAYOUT,
    ImageHeader,
    PolicyHeader,
    image_checksum,
    image_header,
    policy_checksum,
    policy_header,
)
from neuroflight.toolchain.errors import LinkError

FLASH_ALIAS = 0x00200000  # the same flash as the core fetches it
_RAM_BYTES = 256 * 1024  # from DTCM on, without a gap
_WORD = 4
SHA_SHOWN = 12  # digits of a SHA-256 that are shown


@dataclass(frozen=True)
class ImageFacts:
    """The properties of an image, from its header."""

    board: str
    bank: int  # 0: A, 1: B
    version: str
    build: bytes  # the same in both banks of a build
    policy: PolicyHeader  # which it brings

    def __str__(self) -> str:
        build = f"build {self.build.hex()}, bank {'AB'[self.bank]}"
        policy = f"policy of aircraft {self.policy.aircraft}, sha256 {self.policy.policy_sha256[:SHA_SHOWN]}"
        return f"{self.board} {self.version}, {build}, {policy}"


def check_image(segments: Sequence[Segment]) -> ImageFacts:
    """Check an image of boot part and bank and return its properties. Raises LinkError if it cannot start."""
    _check_boot_part(segments)
    for number, bank in enumerate(FLASH_BANKS):
        content = content_of(segments, bank)
        if content:
            return _check_bank(number, content, content_of(segments, FLASH_POLICY_SLOTS[0]))
    raise LinkError(
        "the image is a boot part without a bank, expected both; nothing was written; take neuroflight.hex, "
        ".bin or .elf of a build"
    )


def _check_boot_part(segments: Sequence[Segment]) -> None:
    first = segments[0]
    if first.address != FLASH_BASE or len(first.data) < 2 * _WORD:
        raise LinkError(
            f"the image begins at 0x{first.address:08X}, expected a boot part at 0x{FLASH_BASE:08X}: it "
            f"would not start; nothing was written; take neuroflight.hex, .bin or .elf of a build"
        )
    stack, reset = (int.from_bytes(first.data[i : i + _WORD], "little") for i in (0, _WORD))
    in_flash = any(0 < reset - base < FLASH_BYTES for base in (FLASH_BASE, FLASH_ALIAS))
    if not (DTCM.address < stack <= DTCM.address + _RAM_BYTES and stack % 8 == 0 and in_flash and reset & 1):
        raise LinkError(
            f"the image begins with stack 0x{stack:08X} and reset 0x{reset:08X}, expected vectors of an "
            f"STM32F722's program; nothing was written; it is no image of this board"
        )


def _check_bank(number: int, content: bytes, slot: bytes) -> ImageFacts:
    header = image_header(content)
    if header is None:
        _refuse(number, "has no header of Neuroflight; stm32flash and dfu-util write other firmware")
    if (header.layout, header.bank) != (IMAGE_LAYOUT, number):
        _refuse(
            number,
            f"has layout {header.layout} and bank {header.bank}, expected {IMAGE_LAYOUT} and {number}",
        )
    if not header.board:
        _refuse(number, "names no board, expected the target that it was built for")
    if not IMAGE_HEADER_OFFSET < header.image_bytes <= len(content):
        _refuse(number, f"has {len(content)} bytes, expected the {header.image_bytes} that its header says")
    found = image_checksum(content[: header.image_bytes])
    if found != header.crc:
        _refuse(number, f"has CRC-32 {found:08x}, expected its header's {header.crc:08x}: it is damaged")
    policy = _check_policy(number, header, slot)
    return ImageFacts(header.board, header.bank, header.version, header.build, policy)


def _check_policy(number: int, image: ImageHeader, slot: bytes) -> PolicyHeader:
    """Check the policy that the image will fly; raises LinkError without a policy that fits."""
    try:
        return policy_for(image, slot)[0]
    except ValueError as error:
        _refuse(number, f"cannot fly what lies in policy slot A: {error}")


def policy_for(image: ImageHeader, content: bytes) -> tuple[PolicyHeader, bytes]:
    """Return header and bytes of the policy at the start of `content`, which must belong to that image.

    Raises ValueError that says what it is otherwise.
    """
    header = policy_header(content)
    if header is None:
        raise ValueError("got no policy, expected one")
    if header.layout != POLICY_BLOB_LAYOUT:
        raise ValueError(f"got a policy of layout {header.layout}, expected {POLICY_BLOB_LAYOUT}")
    data = content[: header.total_bytes]
    told = int.from_bytes(data[-POLICY_BLOB_CRC_BYTES:], "little")
    if len(data) != header.total_bytes or policy_checksum(data) != told:
        raise ValueError(f"got a policy that is damaged, expected {header.total_bytes} bytes with their CRC")
    if header.build != image.build:
        raise ValueError(f"got the policy of build {header.build.hex()}, expected {image.build.hex()}")
    if (why := image.misfit(header)) is not None:
        raise ValueError(f"got a policy that does not fit the image: {why}")
    return header, data


def _refuse(number: int, why: str) -> NoReturn:
    raise LinkError(f"the image for bank {'AB'[number]} {why}; nothing was written")
