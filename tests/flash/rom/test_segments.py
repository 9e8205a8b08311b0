"""Image files as segments: three forms of one image, and what is refused with one line."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from neuroflight.flash.rom.segments import (
    ELF_BYTES_MAX,
    GAP_BYTES,
    HEX_BYTES_MAX,
    Segment,
    bin_segments,
    elf_segments,
    hex_segments,
    joined,
    read_segments,
    touched_sectors,
)
from neuroflight.toolchain.contract import (
    FLASH_BANK_A,
    FLASH_BASE,
    FLASH_BOOT,
    FLASH_BYTES,
    FLASH_POLICY_SLOTS,
)
from neuroflight.toolchain.errors import LinkError

END = b":00000001FF\n"
HIGH = b":020000040800F2\n"  # data from 0x08000000 on


def record(kind: int, offset: int, data: bytes) -> bytes:
    """A line of Intel HEX."""
    body = bytes([len(data), offset >> 8, offset & 0xFF, kind]) + data
    return b":" + (body + bytes([-sum(body) & 0xFF])).hex().upper().encode() + b"\n"


def refusal(path: Path) -> str:
    """The one line that reading `path` ends in."""
    with pytest.raises(LinkError) as caught:
        read_segments(path)
    line = str(caught.value)
    assert "\n" not in line and str(path) in line
    return line


# --- What the build makes ------------------------------------------------------------------------
def test_three_forms_hold_the_same_parts_when_of_one_image(board_image: Path) -> None:
    elf = read_segments(board_image)
    assert read_segments(board_image.with_suffix(".hex")) == elf
    flash = bytearray(b"\xff" * FLASH_BYTES)
    for segment in elf:
        start = segment.address - FLASH_BASE
        flash[start : start + len(segment.data)] = segment.data
    slot_b = FLASH_POLICY_SLOTS[1].address - FLASH_BASE
    assert flash[slot_b : slot_b + 4] == bytes(4), "cleared, but by a .bin, which ends before it"
    flash[slot_b : slot_b + 4] = b"\xff" * 4
    content = board_image.with_suffix(".bin").read_bytes()
    assert bytes(flash[: len(content)]) == content
    from_bin = read_segments(board_image.with_suffix(".bin"))
    again = bytearray(b"\xff" * FLASH_BYTES)
    for segment in from_bin:
        again[segment.address - FLASH_BASE : segment.end - FLASH_BASE] = segment.data
    assert again == flash


@pytest.mark.parametrize(
    ("suffix", "sectors"), [(".elf", (0, 4, 5, 7)), (".hex", (0, 4, 5, 7)), (".bin", (0, 4, 5))]
)
def test_only_boot_part_bank_and_slots_are_touched_when_the_image_is_the_build_s(
    board_image: Path, suffix: str, sectors: tuple[int, ...]
) -> None:
    segments = read_segments(board_image.with_suffix(suffix))
    assert touched_sectors(segments) == sectors
    assert segments[0].address == FLASH_BOOT.address
    places = (FLASH_BOOT, FLASH_BANK_A, *FLASH_POLICY_SLOTS)
    assert all(any(p.address <= s.address and s.end <= p.address + p.size for p in places) for s in segments)


# --- Intel HEX -----------------------------------------------------------------------------------
def test_records_become_one_segment_when_they_touch() -> None:
    content = HIGH + record(0, 0, b"abcd") + record(0, 4, b"ef") + record(0, 0x4000, b"g") + END
    assert joined(hex_segments(content)) == (
        Segment(FLASH_BASE, b"abcdef"),
        Segment(FLASH_BASE + 0x4000, b"g"),
    )


def test_segment_addresses_are_understood_when_they_are_of_8086_kind() -> None:
    assert hex_segments(record(2, 0, b"\x12\x34") + record(0, 2, b"x") + END) == (Segment(0x12342, b"x"),)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (HIGH + record(0, 0, b"abcd"), "without an end record"),
        (HIGH + record(0, 0, b"abcd")[:-3] + b"00\n" + END, "line 2: got a wrong checksum"),
        (HIGH + record(0, 0, b"abcd")[:-4] + b"\n" + END, "line 2: got"),
        (HIGH + b"0400000061626364\n" + END, "line 2: got no record"),
        (HIGH + b":zz\n" + END, "line 2: got characters"),
        (HIGH + b":\n" + END, "line 2: got a record of 0 bytes"),
        (HIGH + record(9, 0, b"") + END, "line 2: got a record of kind 9"),
        (HIGH + record(4, 0, b"a") + END, "line 2: got a record of kind 4 with 1 bytes"),
        (END + END, "line 2: got a record behind the end"),
        (HIGH + END, "without content"),
        (record(0, 0, b"a") + END, "0x00000000, expected all of them within"),
        (HIGH + record(0, 0, b"ab") + record(0, 1, b"c") + END, "two contents for address 0x08000001"),
        (b":" + b"0" * 600 + b"\n" + END, "line 1: got no record"),
    ],
)
def test_hex_file_is_refused_by_line_when_damaged(tmp_path: Path, content: bytes, said: str) -> None:
    path = tmp_path / "image.hex"
    path.write_bytes(content)
    assert said in refusal(path)


# --- .bin ----------------------------------------------------------------------------------------
def test_erased_stretch_is_left_out_when_it_is_long() -> None:
    short, long = b"\xff" * (GAP_BYTES - 1), b"\xff" * GAP_BYTES
    assert bin_segments(b"a" + long + b"b" + short + b"c" + long) == (
        Segment(FLASH_BASE, b"a"),
        Segment(FLASH_BASE + 1 + GAP_BYTES, b"b" + short + b"c"),
    )


# --- What is no image ----------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("name", "size", "said"),
    [
        ("a.bin", 0, "got 0 bytes"),
        ("a.bin", FLASH_BYTES + 1, f"expected an image of 1 to {FLASH_BYTES}"),
        ("a.hex", HEX_BYTES_MAX + 1, f"1 to {HEX_BYTES_MAX}"),
        ("a.elf", ELF_BYTES_MAX + 1, f"1 to {ELF_BYTES_MAX}"),
        ("a.elf", 1000, "no whole ELF file"),
        ("a.onnx", 10, "expected an image: .elf, .hex or .bin"),
    ],
)
def test_file_is_refused_when_its_size_or_kind_is_none_of_an_image(
    tmp_path: Path, name: str, size: int, said: str
) -> None:
    path = tmp_path / name
    with path.open("wb") as file:
        file.truncate(size)
    assert said in refusal(path)


def test_file_is_refused_when_missing_or_a_folder_or_erased(tmp_path: Path) -> None:
    assert "No such file" in refusal(tmp_path / "none.bin")
    (tmp_path / "folder.hex").mkdir()
    assert "directory" in refusal(tmp_path / "folder.hex")
    erased = tmp_path / "erased.bin"
    erased.write_bytes(b"\xff" * 5000)
    assert "without content" in refusal(erased)


def test_elf_is_refused_when_of_another_machine_or_named_otherwise(
    tmp_path: Path, board_image: Path, host_program: Path
) -> None:
    of_host = tmp_path / "host.elf"
    of_host.write_bytes(host_program.read_bytes()[:ELF_BYTES_MAX])
    assert "expected one of 32 bits for ARM" in refusal(of_host)
    misnamed = tmp_path / "image.bin"
    misnamed.write_bytes(board_image.read_bytes()[:1000])
    assert "rename it to .elf" in refusal(misnamed)


@pytest.mark.parametrize("size", [4, 20, 52, 60, 200, 1000, 20_000])
def test_elf_is_refused_when_truncated(board_image: Path, size: int) -> None:
    with pytest.raises(ValueError, match="got "):
        elf_segments(board_image.read_bytes()[:size])


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 399), st.integers(0, 255)), min_size=1, max_size=12))
def test_elf_gives_segments_or_a_reason_when_its_head_is_changed(
    board_image: Path, changes: list[tuple[int, int]]
) -> None:
    content = bytearray(board_image.read_bytes())
    for at, value in changes:
        content[at] = value
    try:
        found = joined(elf_segments(bytes(content)))
    except ValueError:
        return
    assert sum(len(s.data) for s in found) <= FLASH_BYTES
