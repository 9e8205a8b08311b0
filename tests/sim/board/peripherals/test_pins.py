"""GPIO, SYSCFG and EXTI: levels, edges, interrupts, and pins in the wrong mode."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from neuroflight.sim.board.core.context import BoardError

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
