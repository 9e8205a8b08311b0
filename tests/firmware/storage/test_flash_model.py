"""hal/host/flash_model.c: sectors, bits that are only cleared, and power cuts at any operation."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from neuroflight.toolchain.contract import (
    FLASH_BANKS,
    FLASH_BASE,
    FLASH_BYTES,
    FLASH_SECTORS,
    IMAGE_TAIL_BYTES,
)

MakeChip = Callable[..., Any]
SECTOR = FLASH_SECTORS[1]
BEFORE, AFTER, BETWEEN, WORDS, NOISE = range(5)


def erase(chip: Any, sector: int) -> bool:
    return bool(chip.core.lib.flash_erase(chip.flash, sector))


def program(chip: Any, address: int, data: bytes) -> bool:
    return bool(chip.core.lib.flash_program(chip.flash, address, data, len(data)))


@pytest.mark.parametrize("number", range(8))
def test_a_sector_alone_is_erased_when_asked(chip: MakeChip, number: int) -> None:
    c, region = chip(), FLASH_SECTORS[number]
    c.content = bytes(FLASH_BYTES)
    assert erase(c, number)
    start = region.address - FLASH_BASE
    assert c.content == bytes(start) + b"\xff" * region.size + bytes(FLASH_BYTES - start - region.size)
    assert c.operations == 1


def test_bits_are_only_cleared_when_words_are_programmed(chip: MakeChip) -> None:
    c = chip()
    assert program(c, SECTOR.address, b"\xf0\xff\x0f\x12")
    assert program(c, SECTOR.address, b"\xf0\xf0\x00\x12")
    assert not program(c, SECTOR.address, b"\xff\xff\xff\xff")
    assert c.region(SECTOR)[:8] == b"\xf0\xf0\x00\x12\xff\xff\xff\xff"
    assert c.operations == 3


def test_the_rest_is_programmed_when_one_word_cannot_be(chip: MakeChip) -> None:
    c = chip()
    c.fill(SECTOR.address, bytes(4))
    assert not program(c, SECTOR.address, b"\x01\0\0\0\x02\0\0\0")
    assert c.region(SECTOR)[:8] == b"\0\0\0\0\x02\0\0\0"


@pytest.mark.parametrize(
    ("address", "count"),
    [
        *((SECTOR.address + 1, 4), (SECTOR.address + 2, 4), (SECTOR.address, 3), (SECTOR.address, 6)),
        *((FLASH_BASE - 4, 4), (FLASH_BASE + FLASH_BYTES, 4), (FLASH_BASE + FLASH_BYTES - 4, 8)),
        (FLASH_BASE, FLASH_BYTES + 4),
    ],
)
def test_nothing_is_programmed_when_it_is_no_word_or_not_of_flash(
    chip: MakeChip, address: int, count: int
) -> None:
    c = chip()
    assert not program(c, address, bytes(count))
    assert c.content == b"\xff" * FLASH_BYTES
    assert c.operations == 0


def test_nothing_is_erased_or_read_when_it_is_not_of_flash(chip: MakeChip) -> None:
    c = chip()
    assert not erase(c, 8)
    at = c.core.lib.flash_at
    assert at(c.flash, FLASH_BASE - 1) == at(c.flash, FLASH_BASE + FLASH_BYTES) == c.core.ffi.NULL
    assert at(c.flash, FLASH_BASE + FLASH_BYTES - 1)[0] == 0xFF


@pytest.mark.parametrize("at", range(4))
@pytest.mark.parametrize("kind", range(5))
def test_nothing_comes_behind_the_operation_that_power_goes_at(chip: MakeChip, at: int, kind: int) -> None:
    c, data = chip(), bytes(range(1, 17))
    c.cut(at, kind, seed=7)
    assert not program(c, SECTOR.address, data)
    written = c.region(SECTOR)[:16]
    assert written[: 4 * at] == data[: 4 * at]
    assert written[4 * at + 4 :] == b"\xff" * (12 - 4 * at)
    before = c.content
    assert not erase(c, 1)
    assert not program(c, SECTOR.address + 64, data)
    assert c.content == before
    c.power_on()
    assert erase(c, 1)
    assert program(c, SECTOR.address, data)


@pytest.mark.parametrize("running", [0, 1])
def test_what_runs_is_left_alone_when_a_bank_runs(chip: MakeChip, running: int) -> None:
    c, bank, spare = chip(), FLASH_BANKS[running], FLASH_BANKS[1 - running]
    marks = bank.address + bank.size - IMAGE_TAIL_BYTES
    c.model.running = running
    assert not erase(c, 5 + running)
    assert not erase(c, 0)
    for address in (bank.address, marks - 4, FLASH_BASE, FLASH_BASE + 0x3FFC):
        assert not program(c, address, bytes(4)), hex(address)
    for address in (bank.address - 4, marks - 4):
        assert not program(c, address, bytes(8)), "a word of it is enough"
    assert c.content == b"\xff" * FLASH_BYTES
    assert c.operations == 0
    assert program(c, marks, bytes(IMAGE_TAIL_BYTES))
    assert program(c, spare.address, bytes(8))
    assert erase(c, 6 - running)
    assert all(erase(c, sector) for sector in (1, 2, 3, 4, 7))
    assert c.region(bank) == b"\xff" * (bank.size - IMAGE_TAIL_BYTES) + bytes(IMAGE_TAIL_BYTES)


def left_of_a_word(chip: MakeChip, kind: int, seeds: range) -> set[int]:
    found = set()
    for seed in seeds:
        c = chip()
        c.fill(SECTOR.address, b"\xff\xff\x00\x00")
        c.cut(0, kind, seed)
        assert not program(c, SECTOR.address, b"\x0f\x0f\x00\x00")
        found.add(int.from_bytes(c.region(SECTOR)[:4], "little"))
    return found


def test_each_kind_of_cut_leaves_its_own_bits_when_a_word_is_interrupted(chip: MakeChip) -> None:
    seeds = range(40)
    assert left_of_a_word(chip, BEFORE, seeds) == {0xFFFF}
    assert left_of_a_word(chip, AFTER, seeds) == {0x0F0F}
    assert left_of_a_word(chip, WORDS, seeds) == {0xFFFF, 0x0F0F}
    between = left_of_a_word(chip, BETWEEN, seeds)
    assert len(between) > 10
    assert all(word & 0x0F0F == 0x0F0F and word >> 16 == 0 for word in between)
    noise = left_of_a_word(chip, NOISE, seeds)
    assert len(noise) > 30
    assert any(word >> 16 for word in noise)


def test_an_interrupted_erase_touches_its_sector_alone_when_power_goes(chip: MakeChip) -> None:
    c = chip()
    c.content = bytes(FLASH_BYTES)
    c.cut(0, NOISE, seed=3)
    assert not erase(c, 1)
    start, end = SECTOR.address - FLASH_BASE, SECTOR.address - FLASH_BASE + SECTOR.size
    content = c.content
    assert content[:start] == bytes(start)
    assert content[end:] == bytes(FLASH_BYTES - end)
    assert len(set(content[start:end])) == 256


def test_a_cut_repeats_when_its_seed_does(chip: MakeChip) -> None:
    def content(seed: int) -> bytes:
        c = chip()
        c.cut(0, NOISE, seed)
        erase(c, 2)
        return bytes(c.content)

    assert content(5) == content(5) != content(6)
    assert content(2**32 - 1) == content(0), "the only two seeds that are alike"
