"""Keys, times, semantics and power cuts of the flash."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import pytest

from neuroflight.sim.board.core.context import BoardError
from neuroflight.sim.board.devices.esc import Frame
from neuroflight.sim.board.peripherals.flash import Cut

if TYPE_CHECKING:
    from tests.sim.board.conftest import Bench

SECTOR_1 = 0x08004000
PG, SER, STRT, LOCK = 1 << 0, 1 << 1, 1 << 16, 1 << 31
WORDS = 2 << 8  # PSIZE


def unlock(bench: Bench, control: int = LOCK) -> None:
    bench.write("FLASH_KEYR", 0x45670123)
    bench.write("FLASH_KEYR", 0xCDEF89AB)
    if control != LOCK:
        bench.write("FLASH_CR", control)


def store(bench: Bench, address: int, value: int) -> None:
    bench.hardware.flash.program(address, 4, value)
    bench.context.run(20)


def program_bytes(bench: Bench) -> None:
    unlock(bench, PG)


def begin_a_word(bench: Bench) -> None:
    unlock(bench, WORDS | PG)
    bench.hardware.flash.program(SECTOR_1, 4, 0)


def test_word_is_programmed_when_unlocked_and_its_time_has_passed(bench: Bench) -> None:
    unlock(bench, WORDS | PG)
    began = bench.context.cycle
    bench.hardware.flash.program(SECTOR_1, 4, 0x12345678)
    assert bench.get("FLASH_SR", "BSY") == 1
    assert bench.context.busy_until == began + 16 * 216
    bench.context.run(15)
    assert bench.get("FLASH_SR", "BSY") == 1
    bench.context.run(2)
    assert bench.get("FLASH_SR", "BSY") == 0
    assert bench.context.load(SECTOR_1, 4) == 0x12345678


def test_bits_can_be_cleared_but_not_set_when_a_word_is_not_erased(bench: Bench) -> None:
    unlock(bench, WORDS | PG)
    store(bench, SECTOR_1, 0xFFFF0F0F)
    store(bench, SECTOR_1, 0x0000000F)
    assert bench.context.load(SECTOR_1, 4) == 0x0000000F
    with pytest.raises(BoardError, match=r"0x08004000 is 0x0000000F .* 0x0000001F: programming a 1 over a 0"):
        store(bench, SECTOR_1, 0x0000001F)


def test_sector_is_erased_when_half_a_second_has_passed(bench: Bench) -> None:
    bench.context.set_memory(SECTOR_1 - 1, bytes(0x4002))
    unlock(bench, WORDS | SER | 1 << 3)
    bench.set("FLASH_CR", STRT=1)
    bench.context.run(249_000)
    assert bench.get("FLASH_SR", "BSY") == 1
    bench.context.run(2_000)
    assert bench.get("FLASH_SR", "BSY") == 0
    assert bench.context.memory(SECTOR_1, 0x4000) == b"\xff" * 0x4000
    assert bench.context.memory(SECTOR_1 - 1, 1) + bench.context.memory(SECTOR_1 + 0x4000, 1) == b"\0\0"


@pytest.mark.parametrize(
    ("prepare", "message"),
    [
        (lambda b: None, "FLASH_CR LOCK is 1"),
        (unlock, "PG 0"),
        (program_bytes, "by 32 bits, expected 8 by FLASH_CR PSIZE"),
        (begin_a_word, "while the controller is busy"),
    ],
)
def test_store_is_refused_when_the_controller_is_not_ready(
    bench: Bench, prepare: Callable[[Bench], None], message: str
) -> None:
    prepare(bench)
    with pytest.raises(BoardError, match=message):
        bench.hardware.flash.program(SECTOR_1 + 8, 4, 0)


def test_alias_is_refused_when_stored_to(bench: Bench) -> None:
    unlock(bench, WORDS | PG)
    with pytest.raises(BoardError, match="its alias is read-only"):
        bench.hardware.flash.program(0x00204000, 4, 0)


def test_controller_is_refused_when_locked_or_given_wrong_keys(bench: Bench) -> None:
    with pytest.raises(BoardError, match="FLASH_CR is written while it is locked"):
        bench.write("FLASH_CR", WORDS | PG)
    with pytest.raises(BoardError, match="FLASH_KEYR = 0xCDEF89AB, expected 0x45670123"):
        bench.write("FLASH_KEYR", 0xCDEF89AB)
    with pytest.raises(BoardError, match="FLASH_OPTCR is written while it is locked"):
        bench.write("FLASH_OPTCR", 0)


def test_accelerator_reset_is_refused_when_it_is_on(bench: Bench) -> None:
    bench.set("FLASH_ACR", ARTEN=1)
    with pytest.raises(BoardError, match="ARTRST is set while ARTEN is 1"):
        bench.set("FLASH_ACR", ARTRST=1)


def test_some_bits_are_left_when_power_goes_during_an_operation(bench: Bench) -> None:
    flash = bench.hardware.flash
    unlock(bench, WORDS | PG)
    store(bench, SECTOR_1, 0xFF00FF00)
    flash.cut_at = flash.operations
    bench.context.resets.clear()
    flash.program(SECTOR_1 + 4, 4, 0x00000000)
    bench.context.run(20)
    left = bench.context.load(SECTOR_1 + 4, 4)
    assert bench.context.resets == ["power"]
    assert left not in (0, 0xFFFFFFFF)
    assert bench.context.load(SECTOR_1, 4) == 0xFF00FF00
    assert flash.cut_at is None


def test_a_cut_erase_leaves_the_same_when_the_seed_is_the_same(bench: Bench, make_bench: type[Bench]) -> None:
    def erase(board: Bench) -> bytes:
        board.context.set_memory(SECTOR_1, bytes(0x4000))
        unlock(board)
        board.hardware.flash.cut_at = 0
        board.write("FLASH_CR", WORDS | SER | 1 << 3)
        board.set("FLASH_CR", STRT=1)
        board.context.run(300_000)
        return bytes(board.context.memory(SECTOR_1, 0x4000))

    first, again, other = erase(bench), erase(make_bench()), erase(make_bench(seed=1))
    assert first == again != other
    assert 0.4 < sum(byte.bit_count() for byte in first) / (8 * 0x4000) < 0.6


def test_options_outlive_a_reset_when_programmed(bench: Bench) -> None:
    bench.write("FLASH_OPTKEYR", 0x08192A3B)
    bench.write("FLASH_OPTKEYR", 0x4C5D6E7F)
    bench.set("FLASH_OPTCR", nWRP=0xFD)
    bench.set("FLASH_OPTCR", OPTSTRT=1)
    bench.context.run(300_000)
    bench.reset("software")
    assert bench.get("FLASH_OPTCR", "nWRP") == 0xFD
    assert bench.get("FLASH_OPTCR", "OPTLOCK") == 1
    unlock(bench, WORDS | PG)
    bench.hardware.flash.program(SECTOR_1, 4, 0)
    assert bench.get("FLASH_SR", "WRPERR") == 1
    assert bench.context.load(SECTOR_1, 4) == 0xFFFFFFFF


def test_options_are_refused_when_they_would_lock_the_chip(bench: Bench) -> None:
    bench.write("FLASH_OPTKEYR", 0x08192A3B)
    bench.write("FLASH_OPTKEYR", 0x4C5D6E7F)
    bench.set("FLASH_OPTCR", RDP=0xCC)
    with pytest.raises(BoardError, match="RDP 0xCC would lock the chip"):
        bench.set("FLASH_OPTCR", OPTSTRT=1)


@pytest.mark.parametrize(("value", "silent_ms"), [(48, 0), (47, 0), (2047, 101)])
def test_flash_is_left_alone_when_a_motor_turns(bench: Bench, value: int, silent_ms: int) -> None:
    unlock(bench, WORDS | SER | 1 << 3)
    bench.hardware.escs[2].protocol = 600
    bench.hardware.escs[2].accept(Frame(3, bench.context.cycle, value, False, 600))
    bench.context.run(1000 * silent_ms)
    if value == 48:
        with pytest.raises(BoardError, match=r"0x08004000 is erased while motor 3 turns \(DShot value 48\)"):
            bench.write("FLASH_CR", WORDS | SER | STRT | 1 << 3)
    else:
        bench.write("FLASH_CR", WORDS | SER | STRT | 1 << 3)
        assert bench.get("FLASH_SR", "BSY") == 1


@pytest.mark.parametrize(
    ("cut", "words"),
    [
        (Cut.BEFORE, {0x00FF00FF}),
        (Cut.AFTER, {0xFFFFFFFF}),
        (Cut.WORDS, {0x00FF00FF, 0xFFFFFFFF}),
    ],
)
def test_each_word_is_the_old_or_the_new_one_when_an_erase_is_cut_so(
    bench: Bench, cut: Cut, words: set[int]
) -> None:
    assert set(_cut_erase(bench, cut)) == words


def test_bits_are_as_before_or_erased_or_any_when_an_erase_is_cut_so(
    bench: Bench, make_bench: type[Bench]
) -> None:
    between, noise = _cut_erase(bench, Cut.BETWEEN), _cut_erase(make_bench(), Cut.NOISE)
    assert all(word & 0x00FF00FF == 0x00FF00FF for word in between)
    assert len(set(between)) > 1000
    assert any(word & 0x00FF00FF != 0x00FF00FF for word in noise)


def _cut_erase(board: Bench, cut: Cut) -> list[int]:
    """Words of a sector of 0x00FF00FF after power went while it was erased."""
    board.context.set_memory(SECTOR_1, bytes.fromhex("ff00ff00") * 0x1000)
    unlock(board)
    board.hardware.flash.cut_at, board.hardware.flash.cut = 0, cut
    board.write("FLASH_CR", WORDS | SER | 1 << 3)
    board.set("FLASH_CR", STRT=1)
    board.context.run(300_000)
    data = board.context.memory(SECTOR_1, 0x4000)
    return [int.from_bytes(data[i : i + 4], "little") for i in range(0, len(data), 4)]
