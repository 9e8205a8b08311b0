"""The converter's sequence and times, and the watchdog's."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from neuroflight.sim.board.core.context import BoardError
from neuroflight.sim.board.peripherals.option_bytes import OptionBytes

if TYPE_CHECKING:
    from tests.sim.board.conftest import Bench


BUFFER = 0x20006000
ADON, CONT, DMA, DDS, SWSTART = 1 << 0, 1 << 1, 1 << 8, 1 << 9, 1 << 30
CONVERSION = 492 / 27  # us: 480 sampling cycles and 12, at 27 MHz


def configure(bench: Bench) -> None:
    bench.set("GPIOC_MODER", MODER0=3, MODER4=3)
    bench.set("ADC_Common_CCR", ADCPRE=1)
    bench.write("ADC1_CR1", 1 << 8)
    bench.set("ADC1_SMPR1", SMP10=7, SMP14=7)
    bench.set("ADC1_SQR1", L=1)
    bench.set("ADC1_SQR3", SQ1=10, SQ2=14)
    bench.write("ADC1_CR2", ADON)


def start_dma(bench: Bench, circular: bool = True, count: int = 64) -> None:
    bench.stream("DMA2_S0", 0x4001204C, BUFFER, count, circular << 8 | 1 << 13 | 1 << 11 | 1 << 10)


def test_battery_is_measured_when_converted_round_by_round(fast: Bench) -> None:
    configure(fast)
    fast.context.run(5)
    fast.hardware.adc.set_battery(16.8, 20.0)
    start_dma(fast)
    fast.write("ADC1_CR2", ADON | CONT | DMA | DDS)
    fast.set("ADC1_CR2", SWSTART=1)
    assert fast.get("ADC1_CR2", "SWSTART") == 0
    fast.context.run(3 * CONVERSION + 0.1)
    assert fast.read("DMA2_S0NDTR") == 61
    fast.context.run(61 * CONVERSION)
    assert fast.get("DMA2_LISR", "TCIF0") == 1
    assert fast.get("DMA2_S0CR", "EN") == 1
    raw = fast.context.memory(BUFFER, 128)
    codes = [int.from_bytes(raw[i : i + 2], "little") for i in range(0, 128, 2)]
    volts, amps = round(16.8 / 11 / 3.3 * 4095), round(20 * 0.0179 / 3.3 * 4095)
    assert codes == [volts, amps] * 32
    assert fast.read("ADC1_SR") & 1 << 5 == 0


def test_buffer_follows_the_battery_when_nobody_looked_for_long(fast: Bench) -> None:
    configure(fast)
    fast.context.run(5)
    fast.hardware.adc.set_battery(16.8, 20.0)
    start_dma(fast)
    fast.write("ADC1_CR2", ADON | CONT | DMA | DDS)
    fast.set("ADC1_CR2", SWSTART=1)
    fast.context.run(200 * CONVERSION + 0.1)
    fast.write("DMA2_LIFCR", 0x3D)
    assert fast.read("DMA2_S0NDTR") == 64 - 200 % 64
    fast.context.run(5000 * CONVERSION)
    assert fast.read("DMA2_LISR") & 0x3D == 1 << 4 | 1 << 5  # half through, and through
    assert fast.read("DMA2_S0NDTR") == 64 - 5200 % 64
    fast.hardware.adc.set_battery(15.0, 20.0)
    fast.context.run(130 * CONVERSION)
    raw = fast.context.memory(BUFFER, 128)
    volts = {int.from_bytes(raw[i : i + 2], "little") for i in range(0, 128, 4)}
    assert volts == {round(15.0 / 11 / 3.3 * 4095)}


def test_interrupt_comes_in_time_when_a_quiet_stream_is_to_interrupt(fast: Bench) -> None:
    configure(fast)
    fast.context.run(5)
    start_dma(fast)
    fast.write("ADC1_CR2", ADON | CONT | DMA | DDS)
    fast.set("ADC1_CR2", SWSTART=1)
    fast.context.run(200 * CONVERSION + 0.1)
    fast.write("DMA2_LIFCR", 0x3D)
    fast.set("DMA2_S0CR", TCIE=1)  # 56 conversions before the end of the fourth round
    fast.context.run(55 * CONVERSION)
    assert not fast.context.asserted("DMA2_STREAM0")
    fast.context.run(2 * CONVERSION)
    assert fast.context.asserted("DMA2_STREAM0")


def test_converter_overruns_when_dma_takes_no_more(fast: Bench) -> None:
    configure(fast)
    fast.context.run(5)
    start_dma(fast, circular=False, count=4)
    fast.write("ADC1_CR2", ADON | CONT | DMA | DDS)
    fast.set("ADC1_CR2", SWSTART=1)
    fast.context.run(4 * CONVERSION + 1)
    assert fast.get("ADC1_SR", "OVR") == 0
    fast.context.run(CONVERSION)
    assert fast.get("ADC1_SR", "OVR") == 1
    assert fast.get("DMA2_LISR", "TCIF0") == 1


def test_one_round_is_converted_when_not_continuous(fast: Bench) -> None:
    configure(fast)
    fast.set("ADC1_SQR1", L=0)
    fast.context.run(5)
    fast.hardware.adc.set_battery(11.0, 0.0)
    fast.set("ADC1_CR2", SWSTART=1)
    fast.context.run(CONVERSION - 0.1)
    assert fast.get("ADC1_SR", "EOC") == 0
    fast.context.run(0.2)
    assert fast.get("ADC1_SR", "EOC") == 1
    assert fast.read("ADC1_DR") == round(1.0 / 3.3 * 4095)
    assert fast.get("ADC1_SR", "EOC") == 0


def test_converter_is_refused_when_it_is_not_ready(fast: Bench) -> None:
    configure(fast)
    with pytest.raises(BoardError, match=r"ADC1 is started 0\.00 us after CR2 ADON, expected 3 us"):
        fast.set("ADC1_CR2", SWSTART=1)
    fast.context.run(5)
    fast.set("ADC_Common_CCR", ADCPRE=0)
    with pytest.raises(BoardError, match="ADC1 is clocked at 54 MHz, expected 36 MHz at most"):
        fast.set("ADC1_CR2", SWSTART=1)
    fast.set("ADC_Common_CCR", ADCPRE=1)
    fast.set("GPIOC_MODER", MODER4=0)
    with pytest.raises(BoardError, match="ADC1 converts channel 14: PC4 is an input, expected analog"):
        fast.set("ADC1_CR2", SWSTART=1)


def start_watchdog(bench: Bench) -> None:
    bench.write("IWDG_KR", 0xCCCC)
    bench.write("IWDG_KR", 0x5555)
    bench.write("IWDG_PR", 3)
    bench.write("IWDG_RLR", 500)
    for _ in range(100):
        if bench.read("IWDG_SR") == 0:
            break
        bench.context.run(1000)
    assert bench.read("IWDG_SR") == 0
    bench.write("IWDG_KR", 0xAAAA)


def test_watchdog_is_content_when_fed(bench: Bench) -> None:
    start_watchdog(bench)
    for _ in range(5):
        bench.context.run(400_000)
        bench.write("IWDG_KR", 0xAAAA)
    left = bench.hardware.iwdg.closest
    assert left is not None
    assert abs(left - 101_000 * 216) < 10  # 501 ticks of 1 ms
    assert bench.hardware.iwdg.feeds == 7  # the start and what `start_watchdog` did
    touched = {touch.register: touch.writes for touch in bench.hardware.touched()}
    assert touched["IWDG_KR"] == 8


def test_watchdog_is_missed_when_not_fed(bench: Bench, make_bench: type[Bench]) -> None:
    start_watchdog(bench)
    with pytest.raises(BoardError, match="the watchdog was not fed for 501 ms"):
        bench.context.run(502_000)
    other = make_bench(watchdog_resets=True)
    start_watchdog(other)
    other.context.run(500_900)
    assert "iwdg" not in other.context.resets
    other.context.run(200)
    assert other.context.resets[-1] == "iwdg"


def test_watchdog_is_refused_when_locked(bench: Bench) -> None:
    with pytest.raises(BoardError, match="IWDG_PR is written while it is locked"):
        bench.write("IWDG_PR", 3)
    bench.write("IWDG_KR", 0x5555)
    bench.write("IWDG_PR", 3)
    with pytest.raises(BoardError, match="IWDG_PR is written while IWDG_SR PVU is 1"):
        bench.write("IWDG_PR", 4)


def test_watchdog_runs_from_reset_when_the_options_say_so(make_bench: type[Bench]) -> None:
    bench = make_bench(options=OptionBytes(optcr=0xC0FFAADC), watchdog_resets=True)
    bench.context.run(511_000)
    assert "iwdg" not in bench.context.resets
    bench.context.run(2000)
    assert bench.context.resets[-1] == "iwdg"
