"""The header of an image is completed after linking: its bank, its build, its checksum."""

from __future__ import annotations

import shutil
import struct
import zlib
from pathlib import Path

import pytest

from toolchain.contract import (
    FLASH_BANKS,
    FLASH_BASE,
    IMAGE_FIELDS,
    IMAGE_HEADER_FORMAT,
    IMAGE_HEADER_OFFSET,
    IMAGE_MAGIC,
    POLICY_BLOB_MAGIC,
)
from toolchain.errors import BuildError
from toolchain.image.stamp import stamp


def header(image: bytes) -> dict[str, object]:
    values = struct.unpack_from(IMAGE_HEADER_FORMAT, image, IMAGE_HEADER_OFFSET)
    return dict(zip((field.name for field in IMAGE_FIELDS), values, strict=True))


@pytest.fixture(scope="module")
def images(board_image: Path) -> tuple[bytes, bytes]:
    """Of bank A and of bank B."""
    both = board_image.with_suffix(".nfi").read_bytes()
    size = header(both)["image_bytes"]
    assert isinstance(size, int)
    return both[:size], both[size:]


@pytest.mark.parametrize("bank", [0, 1])
def test_an_image_says_its_bank_board_size_and_checksum_when_built(
    bank: int, images: tuple[bytes, bytes]
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
    policy = int(str(told["policy_address"])) - region.address
    assert struct.unpack_from("<I", image, policy) == (POLICY_BLOB_MAGIC,)


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
