"""What a strict bus refuses, and that it says what."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from neuroflight.sim.board.core.context import BoardError

if TYPE_CHECKING:
    from tests.sim.board.conftest import Bench


def test_access_is_refused_when_the_register_is_not_modelled(bench: Bench) -> None:
    with pytest.raises(BoardError, match=r"read at 0x40005404: I2C1 is not modelled"):
        bench.load(0x40005404, 4)
    with pytest.raises(BoardError, match=r"write at 0x40023870: RCC_BDCR is not modelled"):
        bench.store(0x40023870, 4, 0)
    with pytest.raises(BoardError, match=r"read at 0x400238F0: RCC has no register there"):
        bench.load(0x400238F0, 4)


def test_access_is_refused_when_it_is_of_the_wrong_kind(fast: Bench) -> None:
    with pytest.raises(BoardError, match="DMA2_LISR is written, but it is read-only"):
        fast.write("DMA2_LISR", 0)
    with pytest.raises(BoardError, match="FLASH_KEYR is read, but it is write-only"):
        fast.read("FLASH_KEYR")
    with pytest.raises(BoardError, match="RCC_CR has a read of 8 bits, but takes 32"):
        fast.read("RCC_CR", 1)


def test_write_is_refused_when_bits_are_reserved_or_not_modelled(fast: Bench) -> None:
    with pytest.raises(BoardError, match=r"RCC_CR = 0x\w+ changes reserved bits 0x80000000"):
        fast.write("RCC_CR", fast.read("RCC_CR") | 1 << 31)
    with pytest.raises(
        BoardError, match=r"TIM8_CR1 = 0x00000060 sets CMS, which the emulator does not model"
    ):
        fast.write("TIM8_CR1", 0x60)
    # PLLCFGR's bit 29 is reserved and reads 1 after reset: it must be kept.
    with pytest.raises(BoardError, match="changes reserved bits 0x20000000"):
        fast.write("RCC_PLLCFGR", 0x04003010)


def test_peripheral_is_refused_when_its_clock_is_off(bench: Bench) -> None:
    with pytest.raises(BoardError, match="GPIOA_MODER is read without its clock: RCC_AHB1ENR GPIOAEN is 0"):
        bench.read("GPIOA_MODER")
    bench.set("RCC_AHB1ENR", GPIOAEN=1)
    assert bench.read("GPIOA_MODER") == 0xA8000000
    bench.set("RCC_AHB1ENR", GPIOAEN=0)
    with pytest.raises(BoardError, match="ADC1_CR1 is written without its clock: RCC_APB2ENR ADC1EN is 0"):
        bench.write("ADC1_CR1", 0)
    with pytest.raises(BoardError, match="ADC_Common_CCR is read without its clock"):
        bench.read("ADC_Common_CCR")


def test_part_of_a_register_changes_when_the_access_is_narrow(fast: Bench) -> None:
    fast.write("GPIOB_ODR", 0x1234)
    address = fast.address("GPIOB_ODR")
    fast.store(address + 1, 1, 0x56)
    assert fast.read("GPIOB_ODR") == 0x5634
    assert fast.load(address, 1) == 0x34
    assert fast.load(address + 1, 1) == 0x56
    fast.store(fast.address("GPIOB_BSRR") + 2, 2, 0x5600)  # the upper half clears
    assert fast.read("GPIOB_ODR") == 0x0034


def test_report_counts_registers_when_the_image_touches_them(bench: Bench) -> None:
    assert bench.hardware.touched() == ()
    bench.read("RCC_CR")
    bench.write("RCC_CR", bench.read("RCC_CR"))
    bench.read("PWR_CSR1") if bench.hardware.pwr.clocked else None
    assert [(t.register, t.reads, t.writes) for t in bench.hardware.touched()] == [("RCC_CR", 2, 1)]


def test_state_brings_registers_back_when_restored(fast: Bench) -> None:
    saved = fast.hardware.registers.state()
    before = {name: dict(d.words) for name, d in fast.hardware.registers.devices.items()}
    touched = fast.hardware.touched()
    fast.write("GPIOB_ODR", 0xFFFF)
    fast.set("RCC_AHB1ENR", GPIOBEN=0)
    fast.hardware.registers.restore(saved)
    assert {name: dict(d.words) for name, d in fast.hardware.registers.devices.items()} == before
    assert fast.hardware.touched() == touched
    assert fast.read("GPIOB_ODR") == 0
