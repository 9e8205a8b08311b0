"""One gyro sample through the image's own interrupt handlers: edge, SPI by DMA, control path, motor frame."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

import pytest
from unicorn.arm_const import UC_ARM_REG_R1

from neuroflight.toolchain.contract import (
    GYRO_BAD_MS,
    GYRO_EDGE_RATE_HZ,
    GYRO_FILES,
    Alignment,
    GyroChip,
)
from tests.sampling import sampled, sampled_rows

TRANSFER_BYTES = 15  # address byte, accelerometer, temperature, gyro in some order
ACCEL_XOUT_H, READ = 0x3B, 0x80
ZERO, BITS, FRAME_WORDS = 1, 16, 54  # thirds of a bit that a zero lasts; of a frame
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
        self.end_read()

    def end_read(self) -> None:
        """DMA ends, whatever it has moved."""
        for stream in (2, 3):
            self._end(stream)
        self.sketch.poke(DMA2, RX_DONE)

    def take_sample(self) -> None:
        """The interrupt of the finished read."""
        self.sketch.call(self.symbols["gyro_sample_handler"])
        self.sketch.poke(DMA2, 0)

    def finish_frame(self) -> None:
        """DMA has moved the motor frame."""
        self._end(6)

    def stream(self, stream: int, register: str) -> int:
        """A register of DMA2's stream."""
        offset = {"SCR": 0, "SNDTR": 4, "SPAR": 8, "SM0AR": 12}[register]
        return int(self.sketch.peek(DMA2 + 0x10 + 0x18 * stream + offset))

    def frames(self) -> list[list[int]]:
        """What motors 1 to 4 (PC6 to PC9) will hear: each bit's pulse, in thirds of a bit."""
        data = self.sketch.uc.mem_read(self.stream(6, "SM0AR"), 4 * FRAME_WORDS)
        words = struct.unpack(f"<{FRAME_WORDS}I", data)
        assert set(words[0 : 3 * BITS : 3]) == {0x3C0} and set(words[2::3]) == {0x3C0 << 16}
        return [[1 + (word >> 22 + motor & 1 ^ 1) for word in words[1 : 3 * BITS : 3]] for motor in range(4)]

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

    def make(identity: int, told_at: int = 0x75) -> Flight:
        sketch = make_sketch(cycles_a_read=2000)
        return Flight(sketch, symbols, make_chip(sketch, identity, told_at))

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
    assert flight.sketch.field("SYSCFG_EXTICR", "EXTI3", index="1") == 2  # port C
    # Interrupts 9 and 58 enabled, at priorities 1 and 3 of the upper four bits.
    assert [flight.sketch.peek(0xE000E100 + 4 * word) for word in range(4)] == [1 << 9, 1 << 26, 0, 0]
    assert (flight.sketch.peek(0xE000E408), flight.sketch.peek(0xE000E438)) == (0x1000, 0x300000)
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


@pytest.mark.parametrize(
    ("identity", "scale", "paths"),
    sampled_rows([(0xAC, 0x10, 3), (0xAF, 0x18, 3), (0x71, 0x18, 7)], (0x71, 0x18, 7)),
)
def test_kin_are_read_slowly_at_the_same_scale(
    identity: int, scale: int, paths: int, board_with: Callable[[int], Flight]
) -> None:
    flight = board_with(identity)
    kept = flight.chip.registers
    assert (kept[0x1B], kept[0x1C], kept[0x68], kept[0x6A]) == (scale, scale, paths, 0x10)
    assert 108e6 / (2 << flight.sketch.field("SPI_CR1", "BR", "SPI1")) == 6.75e6


@pytest.mark.parametrize(
    "known",
    sampled(
        [
            *(("MPU6500", 0x70, 0x75), ("ICM20689", 0x98, 0x75), ("ICM20602", 0x12, 0x75)),
            *(("ICM20601", 0xAC, 0x75), ("ICM20608G", 0xAF, 0x75), ("MPU9250", 0x71, 0x75)),
            *(("MPU6000", 0x68, 0x75), ("ICM42688P", 0x47, 0x75), ("ICM42605", 0x42, 0x75)),
            *(("LSM6DSV16X", 0x70, 0x0F), ("LSM6DSK320X", 0x75, 0x0F), ("BMI270", 0x24, 0x00)),
        ],
        ("ICM42605", 0x42, 0x75),
        ("LSM6DSK320X", 0x75, 0x0F),
    ),
)
def test_the_board_says_which_chip_it_has_and_how_it_is_turned_when_it_is_known(
    known: tuple[str, int, int], board_with: Callable[..., Flight], symbols: dict[str, int]
) -> None:
    chip, identity, told_at = known
    flight = board_with(identity, told_at)
    told = bytes(flight.sketch.uc.mem_read(symbols["info"] + 4, 10))  # struct hal_info; a pointer between
    assert (told[0], *told[8:]) == (Alignment.CW180, GyroChip[chip], identity)
    assert flight.sketch.field("EXTI_IMR", "IM3") == (GyroChip[chip] not in GYRO_FILES)
    assert flight.chip.broken_rules == []


def test_another_chip_is_not_flown_when_it_answers(board_with: Callable[..., Flight]) -> None:
    flight = board_with(0x19)
    assert flight.sketch.field("EXTI_IMR", "IM3") == 0
    assert flight.chip.written == []


class Banked(dict[int, int]):
    """Registers of a chip with banks, which tells what it is in the first of them only."""

    def get(self, address: int, default: int = 0) -> int:  # type: ignore[override]
        return default if address == 0x75 and self[0x76] else super().get(address, default)


@pytest.mark.parametrize(
    ("bank", "known"), sampled_rows([(1, True), (4, True), (5, False), (0xFF, False)], (4, True), (5, False))
)
def test_a_chip_that_a_reset_left_in_another_bank_is_found_and_none_else_is_written_to(
    bank: int,
    known: bool,
    make_sketch: Callable[..., Any],
    make_chip: Callable[..., Any],
    symbols: dict[str, int],
) -> None:
    sketch = make_sketch(cycles_a_read=2000)
    chip = make_chip(sketch, 0x47)
    chip.registers = Banked({0x75: 0x47, 0x76: bank})
    flight = Flight(sketch, symbols, chip)
    assert chip.written[:1] == ([(0x76, 0)] if known else [])
    assert (flight.sketch.field("EXTI_IMR", "IM3") == 1) is known


def test_a_sample_is_read_in_the_order_and_scale_of_the_chip(board_with: Callable[..., Flight]) -> None:
    second, st = board_with(0x47), board_with(0x70, 0x0F)
    for flight, address, layout in ((second, 0x1D, ">B7h"), (st, 0x20, "<B7h")):
        assert flight.edge()
        request = flight.sketch.uc.mem_read(flight.stream(3, "SM0AR"), TRANSFER_BYTES)
        assert request == bytes([address | READ]) + bytes(TRANSFER_BYTES - 1)
        words = (-7, 1, 2, 2048, 100, -32768, 25)  # temperature, then accelerometer and gyro, or gyro first
        flight.sketch.uc.mem_write(flight.stream(2, "SM0AR"), struct.pack(layout, 0, *words))
        flight.end_read()
        flight.take_sample()
    assert second.samples == [((100, -32768, 25), (1, 2, 2048), -7, 1)]
    assert st.samples == [((1, 2, 2349), (100, -32768, 25), -7, 1)]  # 2048 * 1.14688 = 2348.8


@pytest.mark.parametrize(
    ("counts", "told"),
    sampled_rows(
        [
            ((28570, -28570, 3), (32766, -32766, 3)),
            ((28571, -28571, 0), (32767, -32768, 0)),
            ((9, -9, -32768), (10, -10, -32768)),
        ],
        ((28571, -28571, 0), (32767, -32768, 0)),
    ),
)
def test_a_coarse_chip_saturates_at_the_end_of_the_common_range(
    counts: tuple[int, int, int], told: tuple[int, int, int], board_with: Callable[..., Flight]
) -> None:
    flight = board_with(0x75, 0x0F)
    assert flight.edge()
    flight.sketch.uc.mem_write(flight.stream(2, "SM0AR"), struct.pack("<B7h", 0, 0, *counts, 0, 0, 0))
    flight.end_read()
    flight.take_sample()
    assert flight.counts == [told]


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
    assert flight.frames() == [[ZERO] * BITS] * 4
    assert flight.stream(6, "SCR") & 1 and flight.stream(6, "SNDTR") == FRAME_WORDS
    assert flight.stream(6, "SPAR") == 0x40020818  # GPIOC BSRR
    assert flight.sketch.peek(0x4001000C) == 1 << 11, "TIM1's third channel asks"


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
    assert flight.sketch.field("SCB_SHPR3", "PRI_15") == sample == 0x30


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


def test_a_stuck_read_is_ended_and_begun_again_when_two_more_edges_are_due(flight: Flight) -> None:
    assert flight.edge()
    left = DMA2 + 0x14 + 0x18 * 2  # S2NDTR
    flight.sketch.poke(left, 3)
    for _ in range(2):
        flight.edge()
    assert flight.sketch.peek(left) == 3  # due, but the transfer may just have begun late
    for _ in range(2):
        flight.edge()
    assert flight.sketch.peek(left) == 15  # never complete, it gave way to a new one
    flight.finish_read((4, 5, 6))
    flight.take_sample()
    assert flight.counts == [(4, 5, 6)] and flight.lost == [2]
