"""The header of an image is completed after linking: its bank, its build, its checksum."""

from __future__ import annotations

import shutil
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

from neuroflight.flash.rom.segments import read_segments
from neuroflight.toolchain.boards.allocation import allocate
from neuroflight.toolchain.boards.description import BOARD_BYTES, pack
from neuroflight.toolchain.boards.table import boards, find_board
from neuroflight.toolchain.contract import (
    FLASH_BANKS,
    FLASH_BASE,
    FLASH_POLICY_SLOTS,
    IMAGE_FIELDS,
    IMAGE_HEADER_FORMAT,
    IMAGE_HEADER_OFFSET,
    IMAGE_MAGIC,
    IMAGE_TABLE_OFFSET,
    POLICY_BLOB_FIELDS,
    image_field_offset,
    policy_header,
    struct_format,
)
from neuroflight.toolchain.errors import BuildError, WiringError
from neuroflight.toolchain.image.build import BOARD_FAMILY
from neuroflight.toolchain.image.elf import read_image
from neuroflight.toolchain.image.stamp import stamp

NAMED = {"board": 24, "build": 8, "crc": 4}  # fields of the header that depend on the board, and their bytes
TABLE = pack(allocate(find_board("MATEKF722")))


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
    assert told["board"] == b"MATEKF722".ljust(24, b"\0")
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
    stamp(copy, TABLE, copy)
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
    stamp(copy, TABLE, copy)
    assert copy.read_bytes() == board_image.read_bytes()


def test_it_is_refused_when_nothing_lies_in_a_bank(tmp_path: Path) -> None:
    other = tmp_path / "other.elf"
    other.write_bytes(b"\x7fELF")
    with pytest.raises(BuildError, match="cannot stamp"):
        stamp(other, TABLE, tmp_path / "stamped.elf")


def test_images_of_all_boards_differ_in_what_is_stamped_alone(board_image: Path, tmp_path: Path) -> None:
    """What is proven of one is proven of all but for the description: the rest is one link."""
    linked = board_image.parents[1] / BOARD_FAMILY / "make" / "obj" / "bank_a.elf"
    (boot,) = (part.address for part in read_image(linked).sections if part.name == ".boot_board")
    bank, slot = FLASH_BANKS[0].address, FLASH_POLICY_SLOTS[0].address
    policy = policy_header(next(part.data for part in read_segments(board_image) if part.address == slot))
    assert policy is not None
    names = [field.name for field in POLICY_BLOB_FIELDS]
    bound = struct.calcsize(struct_format(POLICY_BLOB_FIELDS[: names.index("build")]))
    stamped = [(boot, BOARD_BYTES), (bank + IMAGE_TABLE_OFFSET, BOARD_BYTES)]
    stamped += [(bank + image_field_offset(name), size) for name, size in NAMED.items()]
    stamped += [
        (slot + bound, 8),
        (slot + policy.total_bytes - 4, 4),
    ]  # of which build the policy is; its CRC
    may = {at + place for at, size in stamped for place in range(size)}
    seen: dict[int, bytes] = {}
    builds = set()
    for board in boards().values():
        try:
            table = pack(allocate(board))
        except WiringError:
            continue
        path = tmp_path / "stamped.elf"
        stamp(linked, table, path)
        content = {part.address: part.data for part in read_segments(path)}
        seen = seen or content
        assert content.keys() == seen.keys()
        for address, data in content.items():
            first = np.frombuffer(seen[address], np.uint8)
            other = np.flatnonzero(first != np.frombuffer(data, np.uint8)) + address
            assert {int(at) for at in other} <= may, board.name
        assert bytes(content[bank][IMAGE_TABLE_OFFSET:][:BOARD_BYTES]) == table
        told = header(content[bank])
        assert told["board"] == board.name.encode().ljust(24, b"\0")
        builds.add(told["build"])
    assert len(builds) > 150, "each is a build of its own"
