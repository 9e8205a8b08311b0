"""DfuSe files, field by field, and from an ELF of the build."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import pytest

from neuroflight.toolchain.contract import FLASH_BANK_A, FLASH_BASE, FLASH_POLICY_SLOTS
from neuroflight.toolchain.image.dfu import Loaded, dfu_file, loaded_parts, main

PARTS = (Loaded(FLASH_BASE, b"boot" * 3), Loaded(FLASH_BANK_A.address, b"bank" * 70))


def test_each_field_stands_where_the_format_has_it() -> None:
    file = dfu_file(PARTS)
    behind = len(file) - 16
    assert file[:11] == b"DfuSe\x01" + len(file).to_bytes(4, "little") + b"\x01"
    target = file[11 : 11 + 274]
    assert target[:11] == b"Target\x00" + b"\x01\x00\x00\x00"
    assert target[11:266].rstrip(b"\0") == b"Neuroflight"
    elements = file[11 + 274 : behind]
    assert target[266:] == struct.pack("<II", len(elements), 2)
    assert elements == (
        struct.pack("<II", 0x08000000, 12) + b"boot" * 3 + struct.pack("<II", 0x08020000, 280) + b"bank" * 70
    )
    assert file[behind:-4] == struct.pack("<HHHH", 0xFFFF, 0xDF11, 0x0483, 0x011A) + b"UFD\x10"
    assert int.from_bytes(file[-4:], "little") == zlib.crc32(file[:-4]) ^ 0xFFFFFFFF


def test_the_build_s_file_holds_boot_part_policy_and_bank_as_its_binary_does_and_clears_slot_b(
    board_image: Path,
) -> None:
    *parts, slot_b = everything = loaded_parts(board_image)
    slots = [slot.address for slot in FLASH_POLICY_SLOTS]
    assert [part.address for part in parts] == [FLASH_BASE, slots[0], FLASH_BANK_A.address]
    assert slot_b == Loaded(slots[1], bytes(4))
    flash = board_image.with_suffix(".bin").read_bytes()
    for part in parts:
        start = part.address - FLASH_BASE
        stored = flash[start : start + len(part.data)]
        assert part.data[: len(stored)] == stored
        assert len(part.data) % 4 == 0 and part.data[len(stored) :] in (
            b"",
            b"\xff",
            b"\xff\xff",
            b"\xff" * 3,
        )
    assert board_image.with_suffix(".dfu").read_bytes() == dfu_file(everything)


def test_one_line_says_it_when_the_elf_is_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "no.elf").write_bytes(b"\x7fELF, but no more")
    for name in ("no.elf", "missing.elf"):
        assert main([str(tmp_path / name), str(tmp_path / "out.dfu")]) == 1
        line = capsys.readouterr().err
        assert line.startswith("cannot make a .dfu of ") and line.count("\n") == 1
    assert not (tmp_path / "out.dfu").exists()
