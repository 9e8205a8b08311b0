"""Clock start-up, its rules, resets and their causes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from neuroflight.sim.board.core.context import BoardError
from neuroflight.sim.board.peripherals.rcc import wait_states

if TYPE_CHECKING:
    from tests.sim.board.conftest import Bench


def test_core_runs_at_216_mhz_when_started_as_the_manual_says(fast: Bench) -> None:
    clocks = fast.hardware.rcc.clocks
    assert (clocks.core, clocks.apb1, clocks.apb2) == (216_000_000, 54_000_000, 108_000_000)
    assert (clocks.timer1, clocks.timer2) == (108_000_000, 216_000_000)
    assert fast.context.core_hz == 216_000_000
    assert fast.get("RCC_CFGR", "SWS") == 2


def test_oscillators_take_their_time_when_switched_on(bench: Bench) -> None:
    bench.set("RCC_CR", HSEON=1)
    bench.context.run(1990)
    assert bench.get("RCC_CR", "HSERDY") == 0
    bench.context.run(20)
    assert bench.get("RCC_CR", "HSERDY") == 1
    bench.set("RCC_CR", PLLON=1)
    bench.context.run(190)
    assert bench.get("RCC_CR", "PLLRDY") == 0
    bench.context.run(20)
    assert bench.get("RCC_CR", "PLLRDY") == 1


@pytest.mark.parametrize(
    ("hz", "states"),
    [(16_000_000, 0), (30_000_000, 0), (30_000_001, 1), (180_000_000, 5), (210_000_000, 6), (216_000_000, 7)],
)
def test_wait_states_follow_the_manuals_table_when_the_core_is_faster(hz: int, states: int) -> None:
    assert wait_states(hz) == states


@pytest.mark.parametrize(
    ("register", "field", "value", "message"),
    [
        (
            "FLASH_ACR",
            "LATENCY",
            6,
            "flash wait states too few: FLASH_ACR LATENCY is 6 at 216 MHz, expected 7",
        ),
        ("RCC_CFGR", "PPRE1", 4, "APB1 runs at 108 MHz, expected 54 MHz at most"),
    ],
)
def test_full_speed_is_refused_when_flash_or_a_bus_cannot_follow(
    fast: Bench, register: str, field: str, value: int, message: str
) -> None:
    with pytest.raises(BoardError, match=message):
        fast.set(register, **{field: value})


def test_switch_is_refused_when_the_source_is_not_ready(bench: Bench) -> None:
    with pytest.raises(BoardError, match="switched to PLL, which is not ready"):
        bench.set("RCC_CFGR", SW=2)
    with pytest.raises(BoardError, match="PLL is switched on before its source HSE is ready"):
        bench.set("RCC_PLLCFGR", PLLSRC=1)
        bench.set("RCC_CR", PLLON=1)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"PLLM": 2, "PLLN": 100}, "VCO input is 4 MHz"),
        ({"PLLM": 4, "PLLN": 432}, "VCO output is 864 MHz"),
        ({"PLLM": 1}, "PLLM is 1"),
    ],
)
def test_pll_is_refused_when_out_of_its_range(bench: Bench, fields: dict[str, int], message: str) -> None:
    bench.set("RCC_CR", HSEON=1)
    bench.context.run(2500)
    bench.set("RCC_PLLCFGR", PLLSRC=1, **fields)
    with pytest.raises(BoardError, match=message):
        bench.set("RCC_CR", PLLON=1)


def test_full_speed_is_refused_when_over_drive_is_off(bench: Bench) -> None:
    bench.set("RCC_CR", HSEON=1)
    bench.context.run(2500)
    bench.set("RCC_PLLCFGR", PLLSRC=1, PLLM=4, PLLN=216)
    bench.set("RCC_CR", PLLON=1)
    bench.context.run(400)
    bench.set("FLASH_ACR", LATENCY=7)
    bench.set("RCC_CFGR", PPRE1=5, PPRE2=4)
    with pytest.raises(BoardError, match="the core runs at 216 MHz, expected 180 MHz at most"):
        bench.set("RCC_CFGR", SW=2)


def test_over_drive_is_refused_when_its_steps_are_skipped(bench: Bench) -> None:
    bench.set("RCC_APB1ENR", PWREN=1)
    with pytest.raises(BoardError, match="ODSWEN is set before PWR_CSR1 ODRDY"):
        bench.set("PWR_CR1", ODEN=1, ODSWEN=1)


def test_crystal_failure_falls_back_to_hsi_when_it_is_watched(fast: Bench) -> None:
    fast.set("RCC_CR", CSSON=1)
    fast.hardware.rcc.fail_crystal()
    assert fast.context.nmis == 1
    assert fast.get("RCC_CIR", "CSSF") == 1
    assert fast.get("RCC_CFGR", "SWS") == 0
    assert fast.get("RCC_CR", "PLLRDY") == 0
    assert fast.context.core_hz == 16_000_000 // 1
    fast.set("RCC_CIR", CSSC=1)
    assert fast.get("RCC_CIR", "CSSF") == 0
    fast.set("RCC_CR", HSEON=1)
    fast.context.run(10_000)
    assert fast.get("RCC_CR", "HSERDY") == 0


def test_crystal_failure_stops_the_core_when_nobody_watches(fast: Bench) -> None:
    with pytest.raises(BoardError, match="CSSON is 0: the core stands still"):
        fast.hardware.rcc.fail_crystal()


def test_cause_is_told_when_the_chip_was_reset(bench: Bench) -> None:
    assert bench.read("RCC_CSR") == 0x0E000000  # power, as the description says
    bench.reset("software")
    assert bench.get("RCC_CSR", "SFTRSTF") == 1
    assert bench.get("RCC_CSR", "WDGRSTF") == 0
    bench.set("RCC_CSR", RMVF=1)
    assert bench.read("RCC_CSR") & 0xFE000000 == 0
    bench.reset("iwdg")
    assert bench.get("RCC_CSR", "WDGRSTF") == 1
    assert bench.get("RCC_CSR", "PORRSTF") == 0


def test_clocks_are_those_of_power_up_when_the_chip_was_reset(fast: Bench) -> None:
    fast.reset("software")
    assert fast.hardware.rcc.clocks.core == 16_000_000
    assert fast.context.core_hz == 16_000_000
    with pytest.raises(BoardError, match="without its clock"):
        fast.read("SPI1_CR1")


def test_peripheral_starts_anew_when_its_reset_bit_is_set(fast: Bench) -> None:
    fast.write("TIM8_ARR", 359)
    fast.set("RCC_APB2RSTR", TIM8RST=1)
    fast.set("RCC_APB2RSTR", TIM8RST=0)
    assert fast.read("TIM8_ARR") == 0
