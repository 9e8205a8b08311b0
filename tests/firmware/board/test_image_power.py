"""The image's battery measurement, beeper and LED."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

import pytest

SCRATCH = 0x2000F000  # DTCM that the image does not use
DMA2_LISR, DMA2_S0CR, DMA2_S0NDTR = 0x40026400, 0x40026410, 0x40026414
FULL = 1 << 5  # TCIF0
ROUNDS = 32


class Power:
    """ADC1 and its DMA, played by hand."""

    def __init__(self, sketch: Any, symbols: dict[str, int]) -> None:
        self.sketch, self.symbols = sketch, symbols
        self.read()  # the first call begins

    def read(self) -> tuple[int, int, bool]:
        """struct power_sample."""
        self.sketch.call_with(self.symbols["power_read"], 0, SCRATCH)
        volts, amps, valid = struct.unpack("<HH?", self.sketch.uc.mem_read(SCRATCH, 5))
        return volts, amps, valid

    def convert(self, volts: list[int], amps: list[int]) -> None:
        pairs = [count for pair in zip(volts, amps, strict=True) for count in pair]
        data = struct.pack(f"<{2 * ROUNDS}H", *pairs)
        self.sketch.uc.mem_write(self.symbols["power_conversions"], data)
        self.sketch.poke(DMA2_LISR, FULL)


@pytest.fixture
def power(make_booted: Callable[[], Any], symbols: dict[str, int]) -> Power:
    return Power(make_booted(), symbols)


def test_both_pins_are_converted_for_ever_when_set_up(power: Power) -> None:
    field = power.sketch.field
    assert [field("ADC1_SQR3", name) for name in ("SQ1", "SQ2")] == [10, 14]
    assert field("ADC1_SQR1", "L") == 1  # two conversions
    assert field("ADC1_CR1", "SCAN") == 1
    for name in ("ADON", "CONT", "DMA", "DDS", "SWSTART"):
        assert field("ADC1_CR2", name) == 1
    assert 108e6 / (2 * field("ADC_CCR", "ADCPRE") + 2) <= 36e6
    assert power.sketch.peek(0x40020800) & 3 == power.sketch.peek(0x40020800) >> 8 & 3 == 3  # PC0, PC4 analog
    control = power.sketch.peek(DMA2_S0CR)
    assert control & 1 and control >> 8 & 1  # running, circular
    assert control >> 11 & 3 == control >> 13 & 3 == 1  # half-words
    assert power.sketch.peek(DMA2_S0NDTR) == 2 * ROUNDS
    assert power.sketch.sins == []


def test_the_mean_in_millivolts_is_told_when_conversions_filled_the_buffer(power: Power) -> None:
    power.convert([1000, 1002] * 16, [4095] * 32)
    volts, amps, valid = power.read()
    assert valid
    assert volts == pytest.approx(1001 / 4095 * 3300, abs=1)
    assert amps == 3300


def test_it_is_not_valid_when_nothing_came_since_the_last_call(power: Power) -> None:
    power.convert([1] * 32, [1] * 32)
    assert power.read()[2]
    power.sketch.poke(DMA2_LISR, 0)  # the driver has cleared the flag
    assert not power.read()[2]


@pytest.mark.parametrize("failure", ["overrun", "bus"])
def test_conversions_begin_again_when_they_stopped(failure: str, power: Power) -> None:
    if failure == "overrun":
        power.sketch.poke(0x40012000, 1 << 5)  # ADC1_SR OVR
    else:
        power.sketch.poke(DMA2_S0CR, power.sketch.peek(DMA2_S0CR) & ~1)
    power.sketch.poke(DMA2_S0NDTR, 7)
    power.read()
    assert power.sketch.peek(DMA2_S0NDTR) == 2 * ROUNDS
    assert power.sketch.peek(DMA2_S0CR) & 1
    assert power.sketch.field("ADC1_SR", "OVR") == 0
    assert power.sketch.field("ADC1_CR2", "SWSTART") == 1


@pytest.mark.parametrize(
    ("function", "port", "pin", "active_high"),
    [("hal_beeper", "GPIOC", 13, True), ("hal_led", "GPIOB", 9, False)],
)
def test_a_pin_follows_when_told(
    function: str, port: str, pin: int, active_high: bool, power: Power, symbols: dict[str, int]
) -> None:
    written: list[tuple[str, int]] = []
    power.sketch.on_write = lambda register, value: written.append((register.instance, value))
    for on in (True, False):
        power.sketch.call_with(symbols[function], 0, on)
    high, low = (port, 1 << pin), (port, 1 << 16 + pin)
    assert written == ([high, low] if active_high else [low, high])
