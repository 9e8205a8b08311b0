"""One gyro sample through the image's own interrupt handlers: edge, SPI by DMA, control path, motor frame."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

import pytest
from unicorn.arm_const import UC_ARM_REG_R1

from neuroflight.toolchain.contract import GYRO_BAD_MS, GYRO_EDGE_RATE_HZ

TRANSFER_BYTES = 15  # address byte, accelerometer, temperature, gyro
ACCEL_XOUT_H, READ = 0x3B, 0x80
ZERO, ONE = 135, 270  # ticks that a DShot bit is high, of 360
DMA2 = 0x40026400
RX_DONE = 1 << 21  # DMA_LISR TCIF2


class Flight:
    """The image in its background loop, with the gyro's and the DMA's part played by hand."""

    def __init__(self, sketch: Any, symbols: dict[str, int], chip: Any) -> None:
        self.sketch, self.symbols, self.chip = sketch, symbols, chip
        sketch.run(symbols["msp_lines_serve"])
        self.samples: list[tuple[Any, ...]] = []
        self.lost: list[int] = []  # before each sample
        self.silences = 0
        sketch.on_code = self._on_code

    def edge(self) -> bool:
        """The data-ready line rises. Returns whether a read is under way."""
        self.sketch.call(self.symbols["gyro_edge_handler"])
        return bool(self.stream(2, "SCR") & 1)

    def finish_read(
        self, gyro: tuple[int, int, int], accel: tuple[int, int, int] = (0, 0, 0), temperature: int = 0
    ) -> None:
        """DMA has moved the bytes."""
        self.sketch.uc.mem_write(self.stream(2, "SM0AR"), struct.pack(">B7h", 0, *accel, temperature, *gyro))
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
        if address == self.symbols["runtime_sample"] & ~1:
            at = self.sketch.uc.reg_read(UC_ARM_REG_R1)
            words = struct.unpack("<7h?xH", self.sketch.uc.mem_read(at, 18))  # struct imu_sample
            self.samples.append((words[:3], words[3:6], words[6], words[7]))
            self.lost.append(words[8])
        if address == self.symbols["runtime_gyro_silent"] & ~1:
            self.silences += 1

    @property
    def counts(self) -> list[tuple[int, ...]]:
        """The gyro's of each sample."""
        return [gyro for gyro, *_ in self.samples]


@pytest.fixture
def board_with(
    make_sketch: Callable[..., Any], make_chip: Callable[..., Any], symbols: dict[str, int]
) -> Callable[[int], Flight]:
    """Makes flights of a board whose gyro chip has some identity."""

    def make(identity: int) -> Flight:
        sketch = make_sketch(cycles_a_read=2000)
        return Flight(sketch, symbols, make_chip(sketch, identity))

    return make


@pytest.fixture
def flight(board_with: Callable[[int], Flight]) -> Flight:
    return board_with(0x70)


def test_the_gyro_is_set_up_slowly_and_runs_fast_when_it_answers(flight: Flight) -> None:
    kept = flight.chip.registers
    assert flight.chip.written[0] == (0x6B, 0x80)  # reset first
    assert kept[0x1B] == 0x18 and kept[0x1A] == 0  # 2000 deg/s, 8 kHz
    assert kept[0x1C] == 0x18 and kept[0x1D] == 2  # 16 g, about 95 Hz
    assert kept[0x6B] == 1 and kept[0x6C] == 0 and kept[0x6A] == 0x10 and kept[0x38] == 1
    assert flight.chip.broken_rules == []
    assert 108e6 / (2 << flight.sketch.field("SPI_CR1", "BR", "SPI1")) == 13.5e6
    assert flight.sketch.field("EXTI_IMR", "IM3") == flight.sketch.field("EXTI_RTSR", "TR3") == 1
    assert flight.sketch.field("SYSCFG_EXTICR1", "EXTI3") == 2  # port C
    # Interrupts 9 and 58 enabled, at priorities 1 and 2 of the upper four bits.
    assert [flight.sketch.peek(0xE000E100 + 4 * word) for word in range(4)] == [1 << 9, 1 << 26, 0, 0]
    assert (flight.sketch.peek(0xE000E408), flight.sketch.peek(0xE000E438)) == (0x1000, 0x200000)
    assert flight.sketch.sins == []


def test_an_icm20689_is_read_more_slowly_when_it_answers(board_with: Callable[[int], Flight]) -> None:
    flight = board_with(0x98)
    assert flight.chip.registers[0x68] == 3  # SIGNAL_PATH_RESET: it has no bit for the gyro
    assert flight.chip.broken_rules == []
    assert 108e6 / (2 << flight.sketch.field("SPI_CR1", "BR", "SPI1")) == 6.75e6
    assert flight.edge()
    flight.finish_read((1, 2, 3))
    flight.take_sample()
    assert flight.counts == [(1, 2, 3)]


def test_an_icm20602_is_kept_off_i2c_by_a_register_of_its_own(board_with: Callable[[int], Flight]) -> None:
    flight = board_with(0x12)
    written = flight.chip.written
    assert written[1] == (0x70, 0x40)  # I2C_IF, before all else
    assert 0x6A not in flight.chip.registers  # USER_CTRL has nothing for it
    assert written.index((0x6B, 0x01)) < written.index((0x68, 0x03))  # awake when its paths are reset
    assert flight.chip.registers[0x1A] == 0 and flight.chip.registers[0x1B] == 0x18
    assert flight.chip.broken_rules == []
    assert 108e6 / (2 << flight.sketch.field("SPI_CR1", "BR", "SPI1")) == 6.75e6


@pytest.mark.parametrize(("identity", "scale", "paths"), [(0xAC, 0x10, 3), (0xAF, 0x18, 3), (0x71, 0x18, 7)])
def test_kin_are_read_slowly_at_the_same_scale(
    identity: int, scale: int, paths: int, board_with: Callable[[int], Flight]
) -> None:
    flight = board_with(identity)
    kept = flight.chip.registers
    assert (kept[0x1B], kept[0x1C], kept[0x68], kept[0x6A]) == (scale, scale, paths, 0x10)
    assert 108e6 / (2 << flight.sketch.field("SPI_CR1", "BR", "SPI1")) == 6.75e6


@pytest.mark.parametrize(
    ("identity", "alignment", "chip"),  # 2: CW180, 1: CW90
    [(0x70, 2, 0), (0x98, 1, 1), (0x12, 2, 2), (0xAC, 2, 3), (0xAF, 2, 4), (0x71, 2, 5), (0x68, 2, 2)],
)
def test_the_board_says_which_chip_it_has_and_how_it_is_turned_when_it_is_known(
    identity: int, alignment: int, chip: int, board_with: Callable[[int], Flight], symbols: dict[str, int]
) -> None:
    sketch = board_with(identity).sketch
    told = bytes(sketch.uc.mem_read(symbols["info"] + 4, 3))  # struct hal_info
    assert told == bytes([alignment, chip, identity])


def test_another_chip_is_not_flown_when_it_answers(board_with: Callable[[int], Flight]) -> None:
    flight = board_with(0x68)  # an MPU6000
    assert flight.sketch.field("EXTI_IMR", "IM3") == 0
    assert 0x1B not in flight.chip.registers


def test_a_chip_that_does_not_keep_a_setting_is_not_flown_when_configured(
    make_sketch: Callable[..., Any], make_chip: Callable[..., Any], symbols: dict[str, int]
) -> None:
    class Forgetful(dict[int, int]):
        def __setitem__(self, address: int, value: int) -> None:
            super().__setitem__(address, 0 if address == 0x1B else value)

    sketch = make_sketch(cycles_a_read=2000)
    chip = make_chip(sketch, 0x70)
    chip.registers = Forgetful(chip.registers)
    sketch.run(symbols["msp_lines_serve"])
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
    assert flight.sketch.uc.mem_read(flight.stream(3, "SM0AR"), 1)[0] == ACCEL_XOUT_H | READ
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


def test_all_that_the_chip_says_reaches_the_core_when_a_sample_is_read(flight: Flight) -> None:
    flight.edge()
    flight.finish_read((1, -2, 3), (-2048, 5, 32767), -700)
    flight.take_sample()
    assert flight.samples == [((1, -2, 3), (-2048, 5, 32767), -700, True)]


def test_a_sample_is_marked_invalid_when_the_bus_fails(flight: Flight) -> None:
    flight.edge()
    for stream in (2, 3):
        flight._end(stream)  # by an error: the transfer-complete flag stays down
    flight.take_sample()
    assert [valid for *_, valid in flight.samples] == [False]


def test_the_core_hears_of_silence_each_time_it_lasts_10_ms(flight: Flight) -> None:
    def ticks(count: int) -> int:
        for _ in range(count):
            flight.sketch.call(flight.symbols["tick_handler"])
        return flight.silences

    assert ticks(9) == 0
    flight.edge()
    flight.finish_read((0, 0, 0))
    flight.take_sample()
    assert ticks(9) == 0
    assert ticks(1) == 1
    assert ticks(9) == 1
    assert ticks(11) == 3
    assert flight.sketch.sins == []


def test_silence_is_told_when_there_never_was_a_chip(board_with: Callable[[int], Flight]) -> None:
    flight = board_with(0)
    for _ in range(10):
        flight.sketch.call(flight.symbols["tick_handler"])
    assert flight.silences == 1


def test_tick_and_sample_cannot_interrupt_each_other_when_set_up(flight: Flight) -> None:
    sample = flight.sketch.peek(0xE000E400 + 4 * (58 // 4)) >> 8 * (58 % 4) & 0xFF
    assert flight.sketch.field("SCB_SHPR3", "PRI_15") == sample == 0x20


def test_a_read_not_yet_taken_is_left_alone_when_the_control_path_is_late(flight: Flight) -> None:
    flight.edge()
    flight.finish_read((7, 8, 9))
    assert not flight.edge() and not flight.edge()  # the second would have been due
    flight.take_sample()
    assert flight.counts == [(7, 8, 9)]


def test_samples_that_were_due_and_not_read_are_told_with_the_next_one(flight: Flight) -> None:
    for lost in (0, 1, 0, 5, 0):
        while not flight.edge():
            pass
        flight.finish_read((1, 1, 1))
        for _ in range(2 * lost):  # the control path is late meanwhile; every second edge is due
            assert not flight.edge()
        flight.take_sample()
    assert flight.lost == [0, 0, 1, 0, 5]


def test_a_silence_has_counted_the_reads_that_failed_in_it(flight: Flight) -> None:
    assert flight.edge()
    for _ in range(2 * GYRO_BAD_MS):
        for _ in range(GYRO_EDGE_RATE_HZ // 1000):
            flight.edge()  # due ones begin reads that never end
        flight.sketch.call(flight.symbols["tick_handler"])
    assert flight.silences == 2
    flight.finish_read((2, 2, 2))
    flight.take_sample()
    assert flight.lost == [0]


def test_a_stuck_read_is_ended_and_begun_again_when_the_next_edge_is_due(flight: Flight) -> None:
    assert flight.edge()
    flight.edge()
    assert flight.edge()  # due: the old transfer, never complete, gave way to a new one
    flight.finish_read((4, 5, 6))
    flight.take_sample()
    assert flight.counts == [(4, 5, 6)]
