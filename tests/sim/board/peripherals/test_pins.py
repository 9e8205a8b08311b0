"""GPIO, SYSCFG and EXTI: levels, edges, interrupts, and pins in the wrong mode."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from neuroflight.sim.board.core.context import BoardError
from neuroflight.sim.board.devices.gyro_mpu import ICM20602
from neuroflight.sim.board.fitted import MATEKF722
from neuroflight.toolchain.boards.facts import Bus, Chip, GyroPlace, Pin, Uart

if TYPE_CHECKING:
    from tests.sim.board.conftest import Bench


def listen(bench: Bench, **fields: int) -> None:
    bench.set("SYSCFG_EXTICR1", EXTI3=2)
    bench.set("EXTI_RTSR", TR3=1)
    bench.set("EXTI_IMR", IM3=1, **fields)


def test_pin_changes_when_its_bit_is_set_and_it_is_an_output(fast: Bench) -> None:
    seen: list[bool] = []
    fast.hardware.pins.watch("PB9", seen.append)
    fast.write("GPIOB_BSRR", 1 << 9)
    assert seen == []  # an input still
    fast.set("GPIOB_MODER", MODER9=1)
    fast.write("GPIOB_BSRR", 1 << 25)
    fast.write("GPIOB_BSRR", 1 << 25)
    assert seen == [True, False]
    assert fast.get("GPIOB_ODR", "ODR9") == 0


def test_level_is_read_when_the_board_drives_or_a_pull_holds(fast: Bench) -> None:
    fast.hardware.pins.drive("PC3", True)
    assert fast.get("GPIOC_IDR", "IDR3") == 1
    fast.hardware.pins.drive("PC3", False)
    fast.set("GPIOC_PUPDR", PUPDR5=1)
    assert fast.read("GPIOC_IDR") & 0x28 == 0x20


def test_interrupt_is_raised_when_a_selected_edge_comes(fast: Bench) -> None:
    listen(fast)
    fast.hardware.pins.drive("PC3", True)
    assert fast.context.asserted("EXTI3")
    assert fast.read("EXTI_PR") == 8
    fast.write("EXTI_PR", 8)
    assert not fast.context.asserted("EXTI3")
    fast.hardware.pins.drive("PC3", False)
    assert fast.read("EXTI_PR") == 0


def test_edge_is_ignored_when_it_is_of_another_port_or_masked(fast: Bench) -> None:
    listen(fast)
    fast.hardware.pins.drive("PA3", True)
    assert fast.read("EXTI_PR") == 0
    fast.write("EXTI_IMR", 0)
    fast.hardware.pins.drive("PC3", True)
    assert fast.read("EXTI_PR") == 8
    assert not fast.context.asserted("EXTI3")
    fast.write("EXTI_IMR", 8)
    assert fast.context.asserted("EXTI3")


def test_lines_share_an_interrupt_when_their_numbers_are_high(fast: Bench) -> None:
    fast.write("EXTI_IMR", 0x60)
    fast.write("EXTI_SWIER", 0x60)
    assert fast.context.asserted("EXTI9_5")
    fast.write("EXTI_PR", 0x20)
    assert fast.context.asserted("EXTI9_5")
    fast.write("EXTI_PR", 0x40)
    assert not fast.context.asserted("EXTI9_5")


def test_signal_is_refused_when_the_board_leads_it_nowhere(fast: Bench) -> None:
    with pytest.raises(BoardError, match="USART6 receives, but the board leads USART6_RX to no pin"):
        fast.hardware.pins.expect("USART6_RX", "USART6 receives")


def test_signals_are_where_another_board_has_them(make_bench: type[Bench]) -> None:
    other = replace(
        MATEKF722,
        buses={1: MATEKF722.buses[1], 2: Bus(Pin("A", 9), Pin("C", 2), Pin("A", 0))},
        uarts={1: Uart(None, Pin("B", 7))},
        usb_supply=None,
        volts=Pin("C", 5),
    )
    signals = make_bench(board=other).hardware.pins.signals
    assert signals["SPI2_SCK"] == (Pin("A", 9), 5)
    assert "SPI2_MOSI" not in signals  # PA0 has no such function
    assert signals["USART1_RX"] == (Pin("B", 7), 7) and "USART1_TX" not in signals
    assert "ADC1_IN15" in signals and "ADC1_IN10" not in signals


def test_byte_is_refused_when_two_chips_are_selected(make_bench: type[Bench]) -> None:
    """The OSD's select is low, as a program leaves it that takes its pin for another's."""
    bench = make_bench(board=replace(MATEKF722, osd=Chip(1, Pin("B", 10))))
    bench.full_speed()
    for pin in ("PA5", "PA6", "PA7"):
        bench.alternate(pin, 5)
    bench.write("GPIOC_BSRR", 1 << 18)
    bench.set("GPIOC_MODER", MODER2=1)
    bench.set("GPIOB_MODER", MODER10=1)
    bench.write("SPI1_CR2", 7 << 8 | 1 << 12)
    bench.write("SPI1_CR1", 0x304 | 5 << 3 | 1 << 6)
    bench.write("SPI1_DR", 0xF5, 1)
    with pytest.raises(BoardError, match="SPI1 moves a byte with two chips selected, by PC2 and PB10"):
        bench.context.run(100)
        bench.read("SPI1_SR")


def test_gyro_is_found_where_another_board_has_it(make_bench: type[Bench]) -> None:
    place = GyroPlace(spi=3, select=Pin("A", 15), ready=Pin("B", 12), alignment=0)
    bench = make_bench(board=replace(MATEKF722, gyros=(place,)), chip=ICM20602)
    bench.full_speed()
    bench.context.run(100_000)
    for pin in ("PB3", "PB4", "PB5"):
        bench.alternate(pin, 6)
    bench.set("GPIOA_MODER", MODER15=1)  # low: selected
    bench.write("SPI3_CR2", 7 << 8 | 1 << 12)
    bench.write("SPI3_CR1", 0x304 | 5 << 3 | 1 << 6)
    got = []
    for byte in (0xF5, 0):
        bench.write("SPI3_DR", byte, 1)
        bench.context.run(20)
        got.append(bench.read("SPI3_DR", 1))
    assert got == [0, ICM20602.who_am_i]
    assert bench.hardware.gyro_line == 12


def test_pin_is_refused_when_it_has_another_function(fast: Bench) -> None:
    expect = fast.hardware.pins.expect
    with pytest.raises(
        BoardError, match=r"SPI1 sends: PA5 is an input, expected alternate function 5 \(SPI1_SCK"
    ):
        expect("SPI1_SCK", "SPI1 sends")
    fast.alternate("PA5", 6)
    with pytest.raises(BoardError, match="PA5 is alternate function 6, expected alternate function 5"):
        expect("SPI1_SCK", "SPI1 sends")
    fast.alternate("PA5", 5)
    expect("SPI1_SCK", "SPI1 sends")
    fast.set("GPIOA_MODER", MODER5=1)
    with pytest.raises(BoardError, match="PA5 is an output"):
        expect("SPI1_SCK", "SPI1 sends")
    with pytest.raises(BoardError, match="PC0 is an input, expected analog"):
        expect("ADC1_IN10", "ADC1 converts")
