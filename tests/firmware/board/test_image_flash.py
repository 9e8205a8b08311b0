"""The image's flash driver on a flash like the chip's: programming clears bits, a busy one has no code."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable
from typing import Any

import pytest
from unicorn import UC_HOOK_MEM_READ, UC_HOOK_MEM_WRITE
from unicorn.arm_const import UC_ARM_REG_PRIMASK

from neuroflight.sim.board.registers.core_registers import Register
from neuroflight.toolchain.contract import FLASH_BASE, FLASH_BYTES, FLASH_SECTORS, ITCM, SRAM1

BSY, PG, SER, STRT, LOCK = 1 << 16, 1, 2, 1 << 16, 1 << 31
KEYS = [0x45670123, 0xCDEF89AB]
STORES = (1, 2, 3, 4, 7)  # sectors without code
LOOKS = 5  # at the busy bit, until an operation is done


class Flash:
    """The controller and its sectors. Notes in `sins` what the chip would not forgive."""

    def __init__(self, sketch: Any, symbols: dict[str, int]) -> None:
        self.sketch, self.symbols = sketch, symbols
        self.sins: list[str] = []
        self.fed_while_busy = 0
        self.error = 0  # that the next operation ends in
        self.keys: list[int] = []
        self.busy = 0
        self.words: list[tuple[int, int]] = []
        self._after: Callable[[], None] = lambda: None
        sketch.on_write, sketch.on_read, sketch.on_code = self._on_write, self._on_read, self._on_code
        end = FLASH_BASE + FLASH_BYTES
        sketch.uc.hook_add(UC_HOOK_MEM_WRITE, self._program, begin=FLASH_BASE, end=end)
        sketch.uc.hook_add(UC_HOOK_MEM_READ, self._read_flash, begin=FLASH_BASE, end=end)

    def erase(self, sector: int) -> bool:
        return bool(self.sketch.call_with(self.symbols["flash_memory_erase"], 0, sector))

    def program(self, address: int, data: bytes, source: int = SRAM1.address + 0x8000) -> bool:
        self.sketch.uc.mem_write(source, data)
        return bool(
            self.sketch.call_with(self.symbols["flash_memory_program"], 0, address, source, len(data))
        )

    def contents(self, address: int, count: int) -> bytes:
        return bytes(self.sketch.uc.mem_read(address, count))

    @property
    def control(self) -> int:
        return int(self.sketch.peek(0x40023C10))

    def _on_write(self, register: Register, value: int) -> None:
        if register.name == "FLASH_KEYR":
            self.keys.append(value)
            if self.keys[-2:] == KEYS:
                self.sketch.poke(0x40023C10, self.control & ~LOCK)
        elif register.name == "FLASH_CR":
            if self.control & LOCK and not value & LOCK:
                self.sins.append("control written while locked")
            if value & STRT and value & SER:
                sector = FLASH_SECTORS[value >> 3 & 15]
                self._begin(lambda: self.sketch.uc.mem_write(sector.address, b"\xff" * sector.size))
        elif register.name == "IWDG_KR" and value == 0xAAAA and self.busy:
            self.fed_while_busy += 1

    def _on_read(self, register: Register) -> None:
        if register.name != "FLASH_SR":
            return
        if self.busy:
            self.busy -= 1
            if not self.busy:
                self._after()
                self.sketch.poke(register.address, self.error)
                self.error = 0
        elif not self.sketch.peek(register.address) & ~1:
            self.sketch.poke(register.address, 0)

    def _begin(self, after: Callable[[], None]) -> None:
        if self.busy:
            self.sins.append("an operation in the middle of another")
        if not self.sketch.uc.reg_read(UC_ARM_REG_PRIMASK) & 1:
            self.sins.append("interrupts are not masked")
        self.busy, self._after = LOOKS, after
        self.sketch.poke(0x40023C0C, BSY)

    def _program(self, uc: Any, access: int, address: int, size: int, value: int, data: object) -> None:
        value &= 0xFFFFFFFF
        self.words.append((address, value))
        if size != 4 or address % 4 or not self.control & PG or self.control >> 8 & 3 != 2:
            self.sins.append(f"a write of {size} bytes to flash, control 0x{self.control:08X}")
        if self.busy:
            self.sins.append("a word before the last was done")
        before = self.sketch.peek(address)
        self._begin(lambda: self.sketch.poke(address, before & value))

    def _read_flash(self, uc: Any, access: int, address: int, size: int, value: int, data: object) -> None:
        if self.busy:
            self.sins.append(f"a read of 0x{address:08X} while flash is busy")

    def _on_code(self, address: int) -> None:
        if self.busy and not ITCM.address <= address < ITCM.address + ITCM.size:
            self.sins.append(f"code at 0x{address:08X} while flash is busy")


@pytest.fixture
def flash(make_booted: Callable[[], Any], symbols: dict[str, int]) -> Flash:
    return Flash(make_booted(), symbols)


@pytest.mark.parametrize("sector", STORES)
def test_a_sector_of_ones_is_left_when_erased(sector: int, flash: Flash) -> None:
    home = FLASH_SECTORS[sector]
    flash.sketch.uc.mem_write(home.address, random.Random(sector).randbytes(home.size))
    around = [flash.contents(s.address, s.size) for s in FLASH_SECTORS if s != home]
    assert flash.erase(sector)
    assert flash.contents(home.address, home.size) == b"\xff" * home.size
    assert [flash.contents(s.address, s.size) for s in FLASH_SECTORS if s != home] == around
    assert flash.control & LOCK
    assert flash.fed_while_busy > 0
    assert flash.sins == [] and flash.sketch.sins == []


@pytest.mark.parametrize("sector", [0, 5, 8, 2**32 - 1])
def test_a_sector_with_code_is_refused_when_asked_to_erase(sector: int, flash: Flash) -> None:
    assert not flash.erase(sector)
    assert flash.keys == []


def test_words_are_stored_and_only_they_when_programmed(flash: Flash) -> None:
    home = FLASH_SECTORS[1]  # erased, as the settings are on a new board
    data = bytes(range(64))
    assert flash.program(home.address + 32, data)
    assert flash.contents(home.address, 128) == b"\xff" * 32 + data + b"\xff" * 32
    assert flash.keys == KEYS
    assert flash.control & LOCK
    assert flash.sins == [] and flash.sketch.sins == []


@pytest.mark.parametrize(
    ("address", "size"),
    [
        (FLASH_SECTORS[5].address, 4),
        (FLASH_SECTORS[0].address, 4),
        (FLASH_SECTORS[1].address - 4, 8),
        (FLASH_SECTORS[4].address + FLASH_SECTORS[4].size - 4, 8),
        (FLASH_SECTORS[7].address + FLASH_SECTORS[7].size, 4),
        (FLASH_SECTORS[4].address + 2, 4),
        (FLASH_SECTORS[4].address, 6),
        (SRAM1.address, 4),
        (0, 0),
    ],
)
def test_what_is_no_place_for_whole_words_is_refused_when_programming(
    address: int, size: int, flash: Flash
) -> None:
    assert not flash.program(address, b"\0" * size)
    assert flash.keys == [] and flash.words == []


def test_words_that_do_not_begin_at_one_are_refused_when_programming(flash: Flash) -> None:
    assert not flash.program(FLASH_SECTORS[4].address, b"\0" * 4, source=SRAM1.address + 0x8002)
    assert flash.words == []


def test_the_difference_is_told_when_bits_would_have_to_be_set(flash: Flash) -> None:
    address = FLASH_SECTORS[2].address
    assert flash.program(address, struct.pack("<I", 0x0F0F0F0F))
    assert flash.program(address, struct.pack("<I", 0x0E0E0E0E))
    assert not flash.program(address, struct.pack("<I", 0xFFFFFFFF))
    assert flash.contents(address, 4) == struct.pack("<I", 0x0E0E0E0E)


@pytest.mark.parametrize("error", [1 << 1, 1 << 4, 1 << 5, 1 << 6, 1 << 7])
def test_no_more_is_written_when_the_chip_reports_an_error(error: int, flash: Flash) -> None:
    flash.error = error
    assert not flash.program(FLASH_SECTORS[4].address, b"\0" * 16)
    assert len(flash.words) == 1
    assert flash.control & LOCK
    flash.error = error
    assert not flash.erase(4)
    assert flash.erase(4)


def test_interrupts_are_on_again_and_caches_empty_when_done(flash: Flash) -> None:
    cleaned: list[int] = []
    chain = flash.sketch.on_write

    def on_write(register: Register, value: int) -> None:
        chain(register, value)
        if register.name == "SCB_DCCISW":
            cleaned.append(value)

    flash.sketch.on_write = on_write
    assert flash.program(FLASH_SECTORS[4].address, b"\0" * 4)
    assert flash.sketch.uc.reg_read(UC_ARM_REG_PRIMASK) & 1 == 0
    assert sorted(cleaned) == sorted(way << 30 | line << 5 for way in range(4) for line in range(64))
    assert flash.sketch.field("FLASH_ACR", "ARTEN") == 1
    assert flash.sketch.field("FLASH_ACR", "ARTRST") == 0


def test_reading_is_memory_when_asked_where(flash: Flash, symbols: dict[str, int]) -> None:
    assert (
        flash.sketch.call_with(symbols["hal_flash_at"], 0, FLASH_SECTORS[4].address)
        == FLASH_SECTORS[4].address
    )


def test_nothing_is_written_when_flash_stays_busy(flash: Flash) -> None:
    flash.busy = 1 << 30
    flash.sketch.poke(0x40023C0C, BSY)
    assert not flash.program(FLASH_SECTORS[4].address, b"\0" * 4)
    assert flash.words == []
    assert flash.control & LOCK
    assert flash.fed_while_busy > 0
