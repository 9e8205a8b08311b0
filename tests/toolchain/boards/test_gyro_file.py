"""The configuration of a BMI270 out of its maker's file, and into an image."""

from __future__ import annotations

from pathlib import Path

import pytest

from neuroflight.flash.rom.segments import read_segments
from neuroflight.toolchain.boards.allocation import allocate
from neuroflight.toolchain.boards.description import pack, unpack
from neuroflight.toolchain.boards.gyro_file import TEXT_MAX, read_gyro_file
from neuroflight.toolchain.boards.table import find_board
from neuroflight.toolchain.contract import FLASH_BANKS, GyroChip
from neuroflight.toolchain.errors import BuildError, WiringError
from neuroflight.toolchain.image.build import find_target
from neuroflight.toolchain.image.stamp import GYRO_FILE_OFFSET, stamp
from tests.toolchain.boards.gyro_file import C_FILE, CONFIGURATION


def test_its_bytes_are_the_arrays(tmp_path: Path) -> None:
    path = tmp_path / "maker.c"
    path.write_text(C_FILE)
    assert read_gyro_file(path) == CONFIGURATION


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "got 0 arrays of hexadecimal bytes"),
        (C_FILE + "uint8_t more[] = { 0x01 };", "got 2 arrays"),
        (C_FILE.replace("0xc8, ", ""), "its array has 327 bytes, expected the 328 of the short"),
        (C_FILE.replace("0xc8", "0xc9"), "it begins with c92e002e, a BMI270's with c82e002e"),
        (C_FILE.replace("0xc8", "SIZE"), "got 0 arrays"),
        (C_FILE.replace("0xc8", "0x1c8"), "got 0 arrays"),
        (" " * (TEXT_MAX + 1), "it has more than 1,048,576 bytes"),
    ],
)
def test_what_is_no_such_file_is_refused_in_one_line(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "maker.c"
    path.write_text(text)
    with pytest.raises(BuildError) as refused:
        read_gyro_file(path)
    assert words in str(refused.value) and "bmi270_maximum_fifo.c of github.com/" in str(refused.value)
    assert "\n" not in str(refused.value)
    with pytest.raises(BuildError, match="No such file"):
        read_gyro_file(tmp_path / "nothing.c")


def test_a_board_with_nothing_else_is_built_with_it_alone() -> None:
    with pytest.raises(WiringError, match=r"its gyro, a BMI270, .*: give --gyro-file FILE, bmi270_"):
        find_target("SPEEDYBEEF7V3")
    target = find_target("SPEEDYBEEF7V3", gyro_file=CONFIGURATION)
    assert target.board is not None and not any("BMI270" in line for line in target.board.left)
    mixed = find_target("AIKONF7").board
    assert mixed is not None and any("BMI270: flown with --gyro-file" in line for line in mixed.left)
    with pytest.raises(BuildError, match="HOST has no gyro chip"):
        find_target("HOST", gyro_file=CONFIGURATION)


def test_the_turn_of_one_among_others_is_the_pilots_to_say() -> None:
    bit = 1 << GyroChip.BMI270
    told = {
        name: unpack(pack(allocate(find_board(name))))["gyro_kinds"] for name in ("AIKONF7", "SPEEDYBEEF7V3")
    }
    assert told["AIKONF7"] and not told["AIKONF7"] & bit and told["SPEEDYBEEF7V3"] == bit


def test_an_image_holds_it_behind_the_description(board_image: Path, tmp_path: Path) -> None:
    table, elf = pack(allocate(find_board("SPEEDYBEEF7V3"))), tmp_path / "stamped.elf"
    for gyro_file, told in ((CONFIGURATION, CONFIGURATION), (b"", bytes(len(CONFIGURATION)))):
        stamp(board_image, table + gyro_file, elf)
        (bank,) = (part.data for part in read_segments(elf) if part.address == FLASH_BANKS[0].address)
        assert bank[GYRO_FILE_OFFSET : GYRO_FILE_OFFSET + len(told)] == told
    with pytest.raises(WiringError, match="1 bytes behind the description, expected 0 or 328"):
        stamp(board_image, table + b"\1", elf)
