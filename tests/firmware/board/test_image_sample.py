"""One gyro sample through the image's own interrupt handlers: edge, SPI by DMA, control path, motor frame."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

import pytest
from unicorn.arm_const import UC_ARM_REG_R1

from toolchain.registers import Register

TRANSFER_BYTES = 7  # address byte and three axes
GYRO_XOUT_H, READ = 0x43, 0x80
ZERO, ONE = 135, 270  # ticks that a DShot bit is high, of 360
DMA2 = 0x40026400
RX_DONE = 1 << 21  # DMA_LISR TCIF2
CHIP_SELECT = 2  # of port C, active low


class Mpu6500:
    """The chip at the other end of SPI1: registers, byte by byte. Notes what breaks its rules."""

    def __init__(self, sketch: Any, identity: int = 0x70) -> None:
        self.sketch = sketch
        self.registers = {0x75: identity}
        self.written: list[tuple[int, int]] = []
        self.broken_rules: list[str] = []
        self._bytes: list[int] = []
        self._selected = self._full = False
        self._answer = 0
        sketch.on_write, sketch.on_read = self._on_write, self._on_read

    def _on_write(self, register: Register, value: int) -> None:
        if register.name == "GPIO_BSRR" and register.instance == "GPIOC":
            if value >> 16 >> CHIP_SELECT & 1:
                self._selected, self._bytes = True, []
            elif value >> CHIP_SELECT & 1:
                self._selected = False
        if register.name != "SPI_DR":
            return
        if not self._selected:
            self.broken_rules.append("a byte without chip select")
        if 108e6 / (2 << self.sketch.field("SPI_CR1", "BR", "SPI1")) > 1e6:
            self.broken_rules.append("a register faster than 1 MHz")
        self._bytes.append(value)
        if len(self._bytes) > 1:
            address = self._bytes[0] & ~READ
            self._answer = self.registers.get(address, 0)
            if not self._bytes[0] & READ:
                self.written.append((address, value))
                self.registers[address] = value
        self._full = True

    def _on_read(self, register: Register) -> None:
        if register.name == "SPI_SR":
            self.sketch.poke(register.address, 2 | self._full)  # TXE, RXNE
        if register.name == "SPI_DR":
            self.sketch.poke(register.address, self._answer)
            self._full = False


class Flight:
    """The image in its background loop, with the gyro's and the DMA's part played by hand."""

    def __init__(self, sketch: Any, symbols: dict[str, int]) -> None:
        self.sketch, self.symbols = sketch, symbols
        self.chip = Mpu6500(sketch)
        sketch.run(symbols["msp_uart_serve"])
        self.counts: list[tuple[int, ...]] = []
        sketch.on_code = self._on_code

    def edge(self) -> bool:
        """The data-ready line rises. Returns whether a read is under way."""
        self.sketch.call(self.symbols["gyro_edge_handler"])
        return bool(self.stream(2, "SCR") & 1)

    def finish_read(self, counts: tuple[int, int, int]) -> None:
        """DMA has moved the seven bytes."""
        self.sketch.uc.mem_write(self.stream(2, "SM0AR"), struct.pack(">B3h", 0, *counts))
        for stream in (2, 3):
            self._end(stream)
        self.sketch.poke(DMA2, RX_DONE)

    def take_sample(self) -> None:
        """The interrupt of the finished read."""
        self.sketch.call(self.symbols["gyro_sample_handler"])
        self.sketch.poke(DMA2, 0)

    def finish_frame(self) -> None:
        """DMA has moved the motor frame."""
        self._end(1)

    def stream(self, stream: int, register: str) -> int:
        """A register of DMA2's stream."""
        offset = {"SCR": 0, "SNDTR": 4, "SPAR": 8, "SM0AR": 12}[register]
        return int(self.sketch.peek(DMA2 + 0x10 + 0x18 * stream + offset))

    def frames(self) -> list[list[int]]:
        """Compare values of each motor's frame, bit by bit, as DMA will find them."""
        words = struct.unpack("<72I", self.sketch.uc.mem_read(self.stream(1, "SM0AR"), 288))
        return [list(words[motor::4]) for motor in range(4)]

    def _end(self, stream: int) -> None:
        self.sketch.poke(DMA2 + 0x10 + 0x18 * stream, self.stream(stream, "SCR") & ~1)

    def _on_code(self, address: int) -> None:
        if address == self.symbols["on_sample"] & ~1:
            at = self.sketch.uc.reg_read(UC_ARM_REG_R1)
            self.counts.append(struct.unpack("<3h", self.sketch.uc.mem_read(at, 6)))


@pytest.fixture
def flight(make_sketch: Callable[..., Any], symbols: dict[str, int]) -> Flight:
    return Flight(make_sketch(cycles_a_read=2000), symbols)


def test_the_gyro_is_set_up_slowly_and_runs_fast_when_it_answers(flight: Flight) -> None:
    kept = flight.chip.registers
    assert flight.chip.written[0] == (0x6B, 0x80)  # reset first
    assert kept[0x1B] == 0x18 and kept[0x1A] == 0  # 2000 deg/s, 8 kHz
    assert kept[0x6B] == 1 and kept[0x6C] == 0 and kept[0x6A] == 0x10 and kept[0x38] == 1
    assert flight.chip.broken_rules == []
    assert 108e6 / (2 << flight.sketch.field("SPI_CR1", "BR", "SPI1")) == 13.5e6
    assert flight.sketch.field("EXTI_IMR", "IM3") == flight.sketch.field("EXTI_RTSR", "TR3") == 1
    assert flight.sketch.field("SYSCFG_EXTICR1", "EXTI3") == 2  # port C
    # Interrupts 9 and 58 enabled, at priorities 1 and 2 of the upper four bits.
    assert [flight.sketch.peek(0xE000E100 + 4 * word) for word in range(4)] == [1 << 9, 1 << 26, 0, 0]
    assert (flight.sketch.peek(0xE000E408), flight.sketch.peek(0xE000E438)) == (0x1000, 0x200000)
    assert flight.sketch.sins == []


def test_another_chip_is_not_flown_when_it_answers(
    make_sketch: Callable[..., Any], symbols: dict[str, int]
) -> None:
    sketch = make_sketch(cycles_a_read=2000)
    Mpu6500(sketch, identity=0x98)  # an ICM20689
    sketch.run(symbols["msp_uart_serve"])
    assert symbols["gyro_run"] & ~1 not in sketch.seen
    assert sketch.field("EXTI_IMR", "IM3") == 0


def test_every_second_edge_is_read_when_the_gyro_runs_at_4_khz(flight: Flight) -> None:
    reads = []
    for _ in range(6):
        reads.append(flight.edge())
        if reads[-1]:
            flight.finish_read((0, 0, 0))
            flight.take_sample()
    assert reads == [True, False] * 3
    assert flight.sketch.sins == []


def test_counts_reach_the_core_and_a_stop_frame_the_motors_when_a_sample_is_read(flight: Flight) -> None:
    assert flight.edge()
    assert flight.stream(2, "SNDTR") == flight.stream(3, "SNDTR") == TRANSFER_BYTES
    assert flight.stream(2, "SPAR") == flight.stream(3, "SPAR") == 0x4001300C
    assert flight.sketch.uc.mem_read(flight.stream(3, "SM0AR"), 1)[0] == GYRO_XOUT_H | READ
    flight.finish_read((1, -2, -32768))
    flight.take_sample()
    assert flight.counts == [(1, -2, -32768)]
    assert flight.frames() == [[ZERO] * 16 + [0, 0]] * 4
    assert flight.stream(1, "SCR") & 1 and flight.stream(1, "SNDTR") == 18 * 4
    assert flight.stream(1, "SPAR") == 0x4001044C  # TIM8 DMAR
    assert flight.sketch.field("TIM_DIER", "UDE", "TIM8") == 1
    assert flight.sketch.field("TIM_DCR", "DBA", "TIM8") * 4 == 0x34  # CCR1
    assert flight.sketch.field("TIM_DCR", "DBL", "TIM8") == 3  # four transfers
    assert flight.sketch.sins == []


def test_a_frame_carries_value_and_checksum_bit_by_bit_when_motors_are_written(flight: Flight) -> None:
    values = (48, 1046, 2047, 0)
    flight.sketch.uc.mem_write(0x2000F000, struct.pack("<4H", *values))
    flight.sketch.call_with(flight.symbols["motors_write"], 0x2000F000, 4)
    for value, ticks in zip(values, flight.frames(), strict=True):
        data = value << 1
        frame = data << 4 | (data ^ data >> 4 ^ data >> 8) & 15
        assert ticks == [ONE if frame >> bit & 1 else ZERO for bit in reversed(range(16))] + [0, 0]


def test_a_new_frame_is_dropped_when_the_last_is_on_the_wire(flight: Flight) -> None:
    flight.sketch.uc.mem_write(0x2000F000, struct.pack("<8H", 2047, 2047, 2047, 2047, 0, 0, 0, 0))
    flight.sketch.call_with(flight.symbols["motors_write"], 0x2000F000, 4)
    first = flight.frames()
    flight.sketch.call_with(flight.symbols["motors_write"], 0x2000F008, 4)
    assert flight.frames() == first
    flight.finish_frame()
    flight.sketch.call_with(flight.symbols["motors_write"], 0x2000F008, 4)
    assert flight.frames() == [[ZERO] * 16 + [0, 0]] * 4


def test_a_read_not_yet_taken_is_left_alone_when_the_control_path_is_late(flight: Flight) -> None:
    flight.edge()
    flight.finish_read((7, 8, 9))
    assert not flight.edge() and not flight.edge()  # the second would have been due
    flight.take_sample()
    assert flight.counts == [(7, 8, 9)]


def test_a_stuck_read_is_ended_and_begun_again_when_the_next_edge_is_due(flight: Flight) -> None:
    assert flight.edge()
    flight.edge()
    assert flight.edge()  # due: the old transfer, never complete, gave way to a new one
    flight.finish_read((4, 5, 6))
    flight.take_sample()
    assert flight.counts == [(4, 5, 6)]
