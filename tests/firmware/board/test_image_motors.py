"""The image's motor outputs: frames as DMA will find them, bit by bit, and the timers that send them."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

import pytest

SCRATCH = 0x2000F000  # DTCM that the image does not use
DSHOT300, DSHOT600 = 0, 1  # the setting motor_protocol
SLOTS = 18  # 16 bits, then two that keep the line low

# Controller, stream, its first motor, how many motors, the register that DMA writes, ticks of a DShot600 bit.
BANKS = (
    (0x40026400, 1, 0, 4, 0x4001044C, 360),  # TIM8 DMAR, 216 MHz
    (0x40026000, 2, 4, 1, 0x40000440, 180),  # TIM3 CCR4, 108 MHz
    (0x40026400, 6, 5, 1, 0x40010034, 360),  # TIM1 CCR1, 216 MHz
)
MODER, ODR_RESET = 0x00, 16
PINS = ((0x40020800, 6), (0x40020800, 7), (0x40020800, 8), (0x40020800, 9), (0x40020400, 1), (0x40020000, 8))


class Motors:
    """The driver in a booted image, set up anew."""

    def __init__(self, sketch: Any, symbols: dict[str, int], protocol: int, count: int) -> None:
        self.sketch, self.symbols = sketch, symbols
        sketch.call_with(symbols["motor_pins_start"])
        sketch.call_with(symbols["motors_run"], protocol, count)

    def write(self, *values: int, telemetry: bool = False) -> None:
        self.sketch.uc.mem_write(SCRATCH, struct.pack(f"<{len(values)}H", *values))
        self.sketch.call_with(self.symbols["motors_write"], 0, SCRATCH, len(values), telemetry)

    def register(self, bank: int, offset: int) -> int:
        controller, stream, *_ = BANKS[bank]
        return int(self.sketch.peek(controller + 0x10 + 0x18 * stream + offset))

    def sending(self) -> list[bool]:
        return [bool(self.register(bank, 0) & 1) for bank in range(len(BANKS))]

    def finish(self) -> None:
        """DMA has moved all."""
        for controller, stream, *_ in BANKS:
            address = controller + 0x10 + 0x18 * stream
            self.sketch.poke(address, self.sketch.peek(address) & ~1)

    def ticks(self, motor: int) -> list[int]:
        """How long the line of a motor will be high, bit by bit."""
        bank = next(i for i, (_, _, first, width, *_) in enumerate(BANKS) if first <= motor < first + width)
        _, _, first, width, *_ = BANKS[bank]
        data = self.sketch.uc.mem_read(self.register(bank, 12), 4 * SLOTS * width)
        return list(struct.unpack(f"<{SLOTS * width}I", data)[motor - first :: width])

    def modes(self) -> list[int]:
        """Of each motor's pin: 1 output, 2 alternate function."""
        return [self.sketch.peek(port) >> 2 * number & 3 for port, number in PINS]


def frame_of(value: int, telemetry: bool = False) -> list[bool]:
    """The bits of a DShot frame, first sent first."""
    data = value << 1 | telemetry
    frame = data << 4 | (data ^ data >> 4 ^ data >> 8) & 15
    return [bool(frame >> bit & 1) for bit in reversed(range(16))]


@pytest.fixture
def motors(make_booted: Callable[[], Any], symbols: dict[str, int]) -> Callable[..., Motors]:
    return lambda protocol=DSHOT600, count=4: Motors(make_booted(), symbols, protocol, count)


@pytest.mark.parametrize(("protocol", "longer"), [(DSHOT600, 1), (DSHOT300, 2)])
def test_a_frame_carries_value_and_checksum_bit_by_bit_when_six_motors_are_written(
    protocol: int, longer: int, motors: Callable[..., Motors]
) -> None:
    board = motors(protocol, 6)
    values = (48, 1046, 2047, 0, 1000, 47)
    board.write(*values)
    assert board.sending() == [True] * 3
    for bank, (_, _, first, width, target, bit) in enumerate(BANKS):
        assert board.register(bank, 8) == target
        assert board.register(bank, 4) == SLOTS * width
        for motor in range(first, first + width):
            one, zero = (longer * bit * 3 // part for part in (4, 8))
            expected = [one if high else zero for high in frame_of(values[motor])]
            assert board.ticks(motor) == [*expected, 0, 0], motor
    assert board.sketch.sins == []


def test_timers_ask_for_a_bit_at_each_update_when_running(motors: Callable[..., Motors]) -> None:
    board = motors(DSHOT600, 6)
    board.write(0, 0, 0, 0, 0, 0)
    field = board.sketch.field
    assert [board.sketch.peek(timer + 0x2C) for timer in (0x40010400, 0x40000400, 0x40010000)] == [
        359,
        179,
        359,
    ]
    assert field("TIM_DIER", "UDE", "TIM8") == field("TIM_DIER", "UDE", "TIM3") == 1
    # TIM1's channel asks in its update's place (CCDS), by a stream that nobody else uses.
    assert field("TIM_CR2", "CCDS", "TIM1") == field("TIM_DIER", "CC1DE", "TIM1") == 1
    for timer, register, channel in (
        ("TIM8", "TIM_CCMR1", 1),
        ("TIM8", "TIM_CCMR2", 4),
        ("TIM3", "TIM_CCMR2", 4),
        ("TIM1", "TIM_CCMR1", 1),
    ):
        assert field(register, f"OC{channel}M", timer) == 6
        assert field(register, f"OC{channel}PE", timer) == field("TIM_CCER", f"CC{channel}E", timer) == 1
    assert field("TIM_BDTR", "MOE", "TIM8") == field("TIM_BDTR", "MOE", "TIM1") == 1
    assert board.modes() == [2] * 6
    # AF3 for PC6..PC9, AF2 for PB1, AF1 for PA8.
    assert board.sketch.peek(0x40020820) >> 24 == 0x33 and board.sketch.peek(0x40020824) & 0xFF == 0x33
    assert board.sketch.peek(0x40020420) >> 4 & 15 == 2 and board.sketch.peek(0x40020024) & 15 == 1


def test_lines_without_a_motor_are_held_low_when_four_are_in_use(motors: Callable[..., Motors]) -> None:
    board = motors(DSHOT600, 4)
    board.write(48, 48, 48, 48)
    assert board.modes() == [2, 2, 2, 2, 1, 1]
    assert board.sending() == [True, False, False]


def test_the_telemetry_bit_is_in_every_frame_when_asked_for(motors: Callable[..., Motors]) -> None:
    board = motors()
    board.write(5, 5, 5, 5, telemetry=True)
    for motor in range(4):
        assert [ticks > 180 for ticks in board.ticks(motor)[:16]] == frame_of(5, telemetry=True)


def test_a_motor_is_stopped_when_its_value_is_missing(motors: Callable[..., Motors]) -> None:
    board = motors()
    board.write(2047, 2047)
    assert [ticks > 180 for ticks in board.ticks(1)[:16]] == frame_of(2047)
    assert [ticks > 180 for ticks in board.ticks(2)[:16]] == frame_of(0)


def test_a_new_frame_is_dropped_when_the_last_is_on_the_wire(motors: Callable[..., Motors]) -> None:
    board = motors()
    board.write(2047, 2047, 0, 0)
    first = [board.ticks(motor) for motor in range(4)]
    board.write(0, 0, 0, 0)
    assert [board.ticks(motor) for motor in range(4)] == first
    board.finish()
    board.write(0, 0, 0, 0)
    assert [board.ticks(motor) for motor in range(4)] == [[135] * 16 + [0, 0]] * 4


def test_an_output_that_is_stuck_is_set_up_anew_and_gets_a_whole_frame_at_the_next_write(
    motors: Callable[..., Motors],
) -> None:
    board = motors(DSHOT600, 6)
    board.write(*[2047] * 6)
    board.finish()
    board.write(*[2047] * 6)
    sketch, tim3 = board.sketch, 0x40000400
    for bank in (0, 2):  # the frames of TIM8 and TIM1 have ended, that of TIM3 does not
        controller, stream, *_ = BANKS[bank]
        sketch.poke(controller + 0x10 + 0x18 * stream, board.register(bank, 0) & ~1)
    sketch.poke(tim3, 0)  # CR1: the timer stands
    for _ in range(3):
        board.write(*[0] * 6)
        assert board.sending() == [False, True, False] and sketch.peek(tim3) == 0
    written: list[str] = []
    sketch.on_write = lambda register, value: written.append(register.instance)
    board.write(*[0] * 6)
    sketch.on_write = lambda register, value: None
    assert set(written) == {"TIM3", "DMA1"}, "the others are left alone"
    assert board.sending() == [False] * 3, "the lines rest until the next write"
    assert sketch.field("TIM_CR1", "CEN", "TIM3") == 1 and sketch.field("TIM_DIER", "UDE", "TIM3") == 0
    assert sketch.peek(tim3 + 0x40) == 0, "CCR4: low"
    assert sketch.call_with(board.symbols["motors_restarts"], 0) == 1
    board.write(*[0] * 6)
    assert board.sending() == [True] * 3 and sketch.field("TIM_DIER", "UDE", "TIM3") == 1
    assert board.ticks(4) == [67] * 16 + [0, 0]
    assert board.sketch.sins == []


def test_every_line_is_driven_low_when_forced(motors: Callable[..., Motors]) -> None:
    board = motors(DSHOT600, 6)
    written: list[tuple[str, int]] = []
    board.sketch.on_write = lambda register, value: (
        written.append((register.instance, value)) if register.name == "GPIO_BSRR" else None
    )
    board.sketch.call_with(board.symbols["motor_pins_force_low"])
    assert board.modes() == [1] * 6
    low = [("GPIOC", 1 << 16 + pin) for pin in (6, 7, 8, 9)] + [("GPIOB", 1 << 17), ("GPIOA", 1 << 24)]
    assert written == low
