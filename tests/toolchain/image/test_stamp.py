"""The header of an image is completed after linking: its bank, its build, its checksum."""

from __future__ import annotations

import shutil
import struct
import zlib
from pathlib import Path

import pytest

from neuroflight.flash.rom.segments import read_segments
from neuroflight.toolchain.contract import (
    FLASH_BANKS,
    FLASH_BASE,
    FLASH_POLICY_SLOTS,
    IMAGE_FIELDS,
    IMAGE_HEADER_FORMAT,
    IMAGE_HEADER_OFFSET,
    IMAGE_MAGIC,
    policy_header,
)
from neuroflight.toolchain.errors import BuildError
from neuroflight.toolchain.image.stamp import stamp


def header(image: bytes) -> dict[str, object]:
    values = struct.unpack_from(IMAGE_HEADER_FORMAT, image, IMAGE_HEADER_OFFSET)
    return dict(zip((field.name for field in IMAGE_FIELDS), values, strict=True))


@pytest.fixture(scope="module")
def images(board_image: Path) -> tuple[bytes, bytes]:
    """Of bank A and of bank B."""
    content = board_image.with_suffix(".nfi").read_bytes()
    size = header(content)["image_bytes"]
    assert isinstance(size, int)
    return content[:size], content[size : 2 * size]


@pytest.mark.parametrize("bank", [0, 1])
def test_an_image_says_its_bank_board_size_and_checksum_when_built(
    bank: int, images: tuple[bytes, bytes], board_image: Path
) -> None:
    image, region = images[bank], FLASH_BANKS[bank]
    told = header(image)
    assert told["magic"] == IMAGE_MAGIC and told["bank"] == bank
    assert told["image_bytes"] == len(image)
    assert told["board"] == b"MATEKF722".ljust(16, b"\0")
    crc_at = IMAGE_HEADER_OFFSET + 12
    assert told["crc"] == zlib.crc32(image[:crc_at] + image[crc_at + 4 :])
    _, reset = struct.unpack_from("<II", image)
    assert region.address < reset < region.address + len(image)
    asked = {name: told[name] for name in ("architecture_hash", "weight_count", "action_count")}
    policy = policy_header(board_image.with_suffix(".nfi").read_bytes()[2 * len(image) :])
    assert policy is not None and asked == {name: getattr(policy, name) for name in asked}


def test_the_policy_is_bound_to_the_build_and_whole_when_it_comes_with_an_image(
    images: tuple[bytes, bytes], board_image: Path
) -> None:
    blob = board_image.with_suffix(".nfi").read_bytes()[2 * len(images[0]) :]
    policy = policy_header(blob)
    assert policy is not None and policy.total_bytes == len(blob)
    assert policy.build == header(images[0])["build"] and policy.sequence == 0
    assert zlib.crc32(blob[:-4]) == int.from_bytes(blob[-4:], "little")
    at = FLASH_POLICY_SLOTS[0].address - FLASH_BASE
    flash = board_image.with_suffix(".bin").read_bytes()
    assert flash[at : at + len(blob)] == blob
    assert not flash[at + len(blob) : FLASH_BANKS[0].address - FLASH_BASE].strip(b"\xff")


def test_the_build_is_another_when_the_policy_alone_is(board_image: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copy(board_image, tmp_path))
    content = bytearray(copy.read_bytes())
    at = content.find(b"NFPB\x05\0")
    content[at + 600] ^= 1  # a weight
    copy.write_bytes(content)
    stamp(copy)
    assert _build(copy) != _build(board_image)


def _build(elf: Path) -> object:
    (bank,) = (part.data for part in read_segments(elf) if part.address == FLASH_BANKS[0].address)
    return header(bank)["build"]


def test_both_banks_are_of_one_build_when_linked_from_the_same_objects(images: tuple[bytes, bytes]) -> None:
    a, b = (header(image) for image in images)
    assert a["build"] == b["build"] and a["build"] != bytes(8)
    assert a["crc"] != b["crc"]


def test_the_binary_holds_the_same_image_as_the_file_for_the_line(
    images: tuple[bytes, bytes], board_image: Path
) -> None:
    flash = board_image.with_suffix(".bin").read_bytes()
    at = FLASH_BANKS[0].address - FLASH_BASE
    assert flash[at:] == images[0]


def test_nothing_changes_when_an_image_is_stamped_again(board_image: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copy(board_image, tmp_path))
    stamp(copy)
    assert copy.read_bytes() == board_image.read_bytes()


def test_it_is_refused_when_nothing_lies_in_a_bank(tmp_path: Path) -> None:
    other = tmp_path / "other.elf"
    other.write_bytes(b"\x7fELF")
    with pytest.raises(BuildError, match="cannot stamp"):
        stamp(other)
