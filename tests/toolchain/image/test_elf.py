"""Facts of the real board image, and of small images made to be wrong."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from neuroflight.flash.rom.segments import read_segments
from neuroflight.toolchain.contract import DTCM, FLASH_BANK_A, FLASH_BASE, FLASH_POLICY_SLOTS
from neuroflight.toolchain.errors import BuildError
from neuroflight.toolchain.image.elf import BANK, RAM, image_budgets, memory_use, read_image

CORTEX_M7 = ("-mcpu=cortex-m7", "-mthumb", "-mfpu=fpv5-sp-d16")
HEAP = {"malloc", "calloc", "realloc", "free", "_sbrk", "_sbrk_r", "_malloc_r"}


def linked(directory: Path, source: str, *flags: str) -> Path:
    """`source` linked without a linker script for the Cortex-M7."""
    image = directory / "image.elf"
    command = ["arm-none-eabi-gcc", *CORTEX_M7, *flags, "-nostdlib", "-Wl,-e,start", "-x", "c", "-"]
    subprocess.run([*command, "-o", str(image)], input=source, text=True, check=True)
    return image


def test_board_image_stays_in_its_budget_when_built(board_image: Path) -> None:
    image = read_image(board_image)
    use = {part.region: part for part in memory_use(image)}
    budgets = {part.region: part for part in image_budgets(image)}
    parts = [budgets[name].used for name in ("boot part", "bank", "policy slot")]
    assert sum(parts) + 4 == use["flash"].used, "and a word that empties the other slot"
    assert all(0 < part.used <= part.size for part in budgets.values())
    assert (budgets["boot part"].size, budgets["bank"].size) == (16 * 1024, 128 * 1024 - 128)
    apart = sum(section.size for section in image.sections if section.name in (".weights", ".sram_noinit"))
    used = sum(part.used for name, part in use.items() if name != "flash")
    assert budgets["RAM beside weights and log"].used == used - apart
    assert use["ITCM"].used > 0
    assert use["DTCM"].used > 4 * 4868  # the policy's weights among others


def test_regions_are_the_linkers_when_a_report_tells_them(board_image: Path) -> None:
    told = (board_image.with_suffix(".map")).read_text()
    configuration = told.partition("Memory Configuration")[2].partition("Linker script")[0]
    linkers = {}
    for line in configuration.splitlines():
        match line.split():
            case [name, origin, length, *_] if origin.startswith("0x") and name != "*default*":
                linkers[name] = (int(origin, 16), int(length, 16))
    assert linkers["BANK"] == (BANK.address, BANK.size)
    assert {region.name: (region.address, region.size) for region in RAM}.items() <= linkers.items()


def test_an_image_is_refused_when_it_does_not_tell_its_ram(tmp_path: Path) -> None:
    source = "void start(void) { }"
    image = read_image(linked(tmp_path, source, f"-Wl,-Ttext={FLASH_BANK_A.address:#x}"))
    with pytest.raises(BuildError, match=r"the image does not tell (ram_bytes|RAM_LIMIT), expected one that"):
        image_budgets(image)


def test_board_image_has_no_heap_and_no_double_helper_when_built(board_image: Path) -> None:
    symbols = set(read_image(board_image).symbols)
    assert {"policy_step", "policy_weights"} <= symbols
    assert not symbols & HEAP
    assert not [name for name in symbols if name.startswith(("__aeabi_d", "__aeabi_f2d"))]


def test_code_of_the_policy_lies_in_fast_memory_when_built(board_image: Path) -> None:
    assert read_image(board_image).symbols["policy_step"] < 16 * 1024  # ITCM


def test_loaded_bytes_lie_in_the_boot_sector_bank_a_and_the_slots_when_built(board_image: Path) -> None:
    for segment in read_image(board_image).segments:
        end = segment.address + segment.size
        boot = segment.address >= FLASH_BASE and end <= FLASH_BASE + 0x4000
        others = (FLASH_BANK_A, *FLASH_POLICY_SLOTS)
        assert boot or any(
            region.address <= segment.address and end <= region.address + region.size for region in others
        )


def test_an_image_has_no_policy_of_its_own_when_built(board_image: Path) -> None:
    assert "policy_weights" not in read_image(board_image.with_name("neuroflight-b.elf")).symbols
    parts = read_segments(board_image)
    (blob,) = (part.data for part in parts if part.address == FLASH_POLICY_SLOTS[0].address)
    for part in parts:
        assert (blob[600:800] in part.data) == (part.address == FLASH_POLICY_SLOTS[0].address)


def test_use_is_counted_when_flash_and_ram_are_known(tmp_path: Path) -> None:
    source = "int zeroed[100]; void start(void) { zeroed[1] = 2; }"
    where = (f"-Wl,-Ttext={FLASH_BASE:#x}", f"-Wl,-Tbss={DTCM.address:#x}")
    image = read_image(linked(tmp_path, source, "-mfloat-abi=hard", *where))
    use = {part.region: part.used for part in memory_use(image)}
    assert use["DTCM"] == 400
    assert 8 <= use["flash"] < 100
    assert (use["ITCM"], use["SRAM1"]) == (0, 0)


def test_image_is_refused_when_a_byte_lies_outside_the_board(tmp_path: Path) -> None:
    source = "int zeroed[100]; void start(void) { zeroed[1] = 2; }"
    where = (f"-Wl,-Ttext={FLASH_BASE:#x}", "-Wl,-Tbss=0x2003ff00")
    image = read_image(linked(tmp_path, source, "-mfloat-abi=hard", *where))
    with pytest.raises(BuildError, match=r"\.bss of 400 bytes at 0x2003FF00 lies outside ITCM, DTCM"):
        memory_use(image)


@pytest.mark.parametrize("data", [b"", b"\x7fELF", b"#!/bin/sh\n" * 20])
def test_image_is_refused_when_it_is_no_elf(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "image.elf"
    path.write_bytes(data)
    with pytest.raises(BuildError, match="cannot read the image"):
        read_image(path)
