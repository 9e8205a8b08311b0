"""What the image does when it must stop: motors low, a record that outlives the reset, the reset."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest

from neuroflight.sim.board.registers.core_registers import Register
from neuroflight.toolchain.contract import DTCM
from tests.sampling import sampled

SCRATCH = 0x2000F000  # DTCM that the image does not use
HARD, ASSERT, WATCHDOG, BROWN_OUT, CLOCK, RESET = range(1, 7)
RECORD = "<15I24sI"
FRAME = (0xA0, 0xA1, 0xA2, 0xA3, 0xA12, 0xA14, 0x08021234, 0x61000000)  # r0..r3, r12, lr, pc, psr
STEPS_TO_STOP = 200_000
BOR_LEVEL = 3  # of the option bytes as they leave the factory
# RCC_CSR: BORRSTF 25, PADRSTF 26, PORRSTF 27, SFTRSTF 28, WDGRSTF 29.
POWER_ON, BROWNED_OUT, SOFTWARE, BITTEN, PULLED = (
    *(0x0E000000, 0x06000000, 0x14000000, 0x24000000, 0x04000000),
)


@dataclass(frozen=True)
class Record:
    """struct fault_record."""

    kind: int
    frame: tuple[int, ...]
    status: tuple[int, ...]  # CFSR, HFSR, MMFAR, BFAR
    sp: int
    line: int
    file: str
    uptime_steps: int


class Board:
    """A booted image that may fault."""

    def __init__(self, sketch: Any, symbols: dict[str, int]) -> None:
        self.sketch, self.symbols = sketch, symbols

    def boot(self, reset_flags: int) -> None:
        """Reset, until the board asks what was."""
        self.sketch.reset_registers()
        self.sketch.poke(0x40023874, reset_flags)
        self.sketch.run(self.symbols["power_start"])

    def fault(self, stack: int = DTCM.address + 0x1000) -> None:
        """A processor fault that stacked FRAME where `stack` points."""
        if DTCM.address <= stack:
            self.sketch.uc.mem_write(stack, struct.pack("<8I", *FRAME))
        self.sketch.call_to_reset(self.symbols["fault_handler"], stack=stack)

    def take(self) -> Record | None:
        if not self.sketch.call_with(self.symbols["hal_fault_take"], SCRATCH):
            return None
        words = struct.unpack(RECORD, self.sketch.uc.mem_read(SCRATCH, struct.calcsize(RECORD)))
        kind, *frame = words[:9]
        file = words[15].split(b"\0")[0].decode()
        return Record(kind, tuple(frame), words[9:13], words[13], words[14], file, words[16])


@pytest.fixture
def board(make_booted: Callable[[], Any], symbols: dict[str, int]) -> Board:
    return Board(make_booted(), symbols)


def test_nothing_is_told_when_the_board_was_switched_on(board: Board) -> None:
    board.boot(POWER_ON)
    assert board.take() is None
    board.boot(SOFTWARE)
    assert board.take() is None


def test_motors_are_low_before_anything_else_when_a_fault_comes(board: Board) -> None:
    written: list[tuple[str, int]] = []

    def on_write(register: Register, value: int) -> None:
        written.append((f"{register.name} {register.instance}", value))

    board.sketch.on_write = on_write
    board.fault()
    assert written[0][0] == "RCC_AHB1ENR RCC"
    low = {("GPIO_BSRR GPIOC", 1 << 16 + pin) for pin in (6, 7, 8, 9)}
    low |= {("GPIO_BSRR GPIOB", 1 << 17), ("GPIO_BSRR GPIOA", 1 << 24)}
    assert low <= set(written)
    assert written[-1] == ("SCB_AIRCR SCB", 0x05FA0004)
    assert written.index(("TIM_DIER TIM1", 0)) < min(map(written.index, low)), "no word of a frame follows"
    assert {name.split("_")[0] for name, _ in written[1:-1]} == {"RCC", "TIM", "GPIO"}


def test_registers_and_status_are_kept_across_the_reset_when_a_fault_comes(board: Board) -> None:
    for address, value in zip(
        (0xE000ED28, 0xE000ED2C, 0xE000ED34, 0xE000ED38), (0x8200, 0x40000000, 1, 2), strict=True
    ):
        board.sketch.poke(address, value)
    board.sketch.poke(0xE000ED04, 5)  # VECTACTIVE: bus fault
    board.fault(DTCM.address + 0x1000)
    board.boot(SOFTWARE)
    record = board.take()
    assert record is not None
    assert record.kind == HARD
    assert record.frame == FRAME
    assert record.status == (0x8200, 0x40000000, 1, 2)
    assert (record.sp, record.line, record.file) == (DTCM.address + 0x1000, 5, "")
    assert board.take() == record  # until it is cleared
    board.sketch.call_with(board.symbols["hal_fault_clear"])
    assert board.take() is None


@pytest.mark.parametrize("deep", [DTCM.address - 32, DTCM.address + 8, DTCM.address + DTCM.size, 0])
def test_a_record_is_kept_when_the_stack_is_gone(deep: int, board: Board) -> None:
    board.fault(deep)
    board.boot(SOFTWARE)
    record = board.take()
    assert record is not None and record.kind == HARD and record.sp == deep
    assert record.frame == (FRAME if deep == DTCM.address + 8 else (0,) * 8)


@pytest.mark.parametrize("words", [1, 7])
def test_no_frame_is_read_that_reaches_beyond_the_stack(
    words: int, board: Board, symbols: dict[str, int]
) -> None:
    deep = symbols["stack_top"] - 4 * words
    board.fault(deep)
    board.boot(SOFTWARE)
    record = board.take()
    assert record is not None and (record.sp, record.frame) == (deep, (0,) * 8)


def test_a_frame_at_the_bottom_of_the_stack_is_read(board: Board) -> None:
    board.fault(DTCM.address)
    board.boot(SOFTWARE)
    record = board.take()
    assert record is not None and record.frame == FRAME


def test_a_frame_at_the_top_of_the_stack_is_read_before_it_is_overwritten(
    board: Board, symbols: dict[str, int]
) -> None:
    board.fault(symbols["stack_top"] - 32)
    board.boot(SOFTWARE)
    record = board.take()
    assert record is not None and record.frame == FRAME


def test_the_clock_is_blamed_when_its_interrupt_comes(board: Board) -> None:
    board.sketch.poke(0xE000ED04, 2)  # NMI
    board.fault()
    board.boot(SOFTWARE)
    record = board.take()
    assert record is not None and record.kind == CLOCK


def test_file_and_line_are_kept_when_an_assertion_fails(board: Board) -> None:
    board.sketch.call_to_reset(board.symbols["motors_run"], 1, 0, 9)  # nine motors
    board.boot(SOFTWARE)
    record = board.take()
    assert record is not None
    assert (record.kind, record.file) == (ASSERT, "devices/motors.c")
    assert record.line > 0


def test_the_end_of_the_path_is_kept_when_it_is_long(board: Board) -> None:
    board.sketch.uc.mem_write(SCRATCH, b"x" * 40)
    board.sketch.call_to_reset(board.symbols["fault_assert_failed"], SCRATCH, 77)
    board.boot(SOFTWARE)
    record = board.take()
    assert record is not None and (record.file, record.line) == ("x" * 23, 77)


@pytest.mark.parametrize(("flags", "kind"), [(BITTEN, WATCHDOG), (BROWNED_OUT, BROWN_OUT)])
def test_the_chips_own_reset_is_told_with_the_step_it_came_at(flags: int, kind: int, board: Board) -> None:
    board.sketch.uc.mem_write(SCRATCH, struct.pack("<I", 4711))
    board.sketch.call_with(board.symbols["hal_trace_write"], 0, SCRATCH)  # a trace begins with its step
    board.boot(flags)
    record = board.take()
    assert record is not None and (record.kind, record.uptime_steps) == (kind, 4711)
    assert record.line == (BOR_LEVEL if kind == BROWN_OUT else 0)
    assert board.sketch.field("RCC_CSR", "RMVF") == 1
    board.sketch.call_with(board.symbols["hal_fault_clear"])
    assert board.take() is None


STEPS = 8  # of struct kept: control steps, then the mark that the motors were armed
TRACE = "<I7fBB"  # struct control_trace: step, setpoint, gyro, throttle, armed, motor_count


@pytest.mark.parametrize(("armed", "kind"), [(1, BROWN_OUT), (0, None)])
def test_a_dip_of_the_supply_is_told_when_memory_says_that_the_motors_were_armed(
    armed: int, kind: int | None, board: Board
) -> None:
    """With the brown-out detector off, as the chip is delivered: the flags are those of power-on."""
    board.sketch.uc.mem_write(SCRATCH, struct.pack(TRACE, 4711, *[0.0] * 7, armed, 4))
    board.sketch.call_with(board.symbols["hal_trace_write"], 0, SCRATCH)
    place = board.symbols["kept"] + STEPS
    assert board.sketch.peek(place) == 4711
    board.boot(POWER_ON)
    record = board.take()
    assert (record and (record.kind, record.uptime_steps)) == (kind and (kind, 4711))
    board.sketch.call_with(board.symbols["hal_fault_clear"])
    board.boot(POWER_ON)
    assert board.take() is None, "told once"
    assert board.sketch.peek(place) == 0


@pytest.mark.parametrize("flags", [PULLED, SOFTWARE])
@pytest.mark.parametrize("armed", [1, 0])
def test_any_reset_is_told_when_memory_says_that_the_motors_were_armed(
    armed: int, flags: int, board: Board
) -> None:
    board.sketch.uc.mem_write(SCRATCH, struct.pack(TRACE, 4711, *[0.0] * 7, armed, 4))
    board.sketch.call_with(board.symbols["hal_trace_write"], 0, SCRATCH)
    for _ in range(2):  # a line that bounces: the first boot does not come to its record
        board.boot(flags)
    record = board.take()
    assert (record and (record.kind, record.uptime_steps)) == ((RESET, 4711) if armed else None)
    board.sketch.call_with(board.symbols["hal_fault_clear"])
    board.boot(flags)
    assert board.take() is None, "told once"


@pytest.mark.parametrize("bit", sampled([0, 13, 31, 32, 47, 63], 0, 47))
def test_a_loss_of_power_is_no_dip_when_memory_did_not_outlive_it(bit: int, board: Board) -> None:
    board.sketch.uc.mem_write(SCRATCH, struct.pack(TRACE, 4711, *[0.0] * 7, 1, 4))
    board.sketch.call_with(board.symbols["hal_trace_write"], 0, SCRATCH)
    at = board.symbols["kept"] + STEPS + bit // 32 * 4
    board.sketch.poke(at, board.sketch.peek(at) ^ 1 << bit % 32)
    board.boot(POWER_ON)
    assert board.take() is None


@pytest.mark.slow
def test_a_record_is_not_believed_when_memory_lost_power(board: Board, symbols: dict[str, int]) -> None:
    board.fault()
    place = symbols["note"]
    for at in range(0, struct.calcsize(RECORD) + 12, 4):
        before = board.sketch.peek(place + at)
        board.sketch.poke(place + at, before ^ 1 << at % 32)
        board.boot(POWER_ON)
        assert board.take() is None, at
        board.sketch.poke(place + at, before)
    assert board.take() is not None


def test_the_board_rests_and_shows_it_when_it_faults_again_and_again(board: Board) -> None:
    board.fault()
    board.boot(SOFTWARE)
    board.fault()
    board.boot(SOFTWARE)
    fed = []
    board.sketch.on_write = lambda register, value: fed.append(value) if register.name == "IWDG_KR" else None
    board.sketch.uc.mem_write(DTCM.address + 0x1000, struct.pack("<8I", *FRAME))
    board.sketch.uc.emu_start(board.symbols["fault_handler"] | 1, 0xFFFFFFFE, count=STEPS_TO_STOP)
    assert board.sketch.resets == 2
    assert board.symbols["stop"] & ~1 in board.sketch.seen
    assert set(fed) == {0xAAAA}


def test_a_board_that_was_asked_starts_anew_with_its_motors_low(board: Board) -> None:
    board.sketch.call_to_reset(board.symbols["fault_reset"], 0)
    assert board.sketch.peek(0x40020800) >> 12 & 0xFF == 0b01010101  # PC6..PC9 outputs
    board.boot(SOFTWARE)
    assert board.take() is None


def test_the_watchdog_waits_half_a_second_and_stands_still_for_a_debugger_when_set_up(
    make_sketch: Callable[..., Any], symbols: dict[str, int]
) -> None:
    sketch = make_sketch()
    keys: list[int] = []
    sketch.on_write = lambda register, value: keys.append(value) if register.name == "IWDG_KR" else None
    sketch.run(symbols["power_start"])
    assert keys[:4] == [0xCCCC, 0xCCCC, 0x5555, 0xAAAA], "the boot part starts it, too"
    divider, reload = 4 << sketch.field("IWDG_PR", "PR"), sketch.field("IWDG_RLR", "RL")
    slow, typical, fast = (reload * divider / hz for hz in (17_000, 32_000, 47_000))
    assert typical == pytest.approx(0.5, abs=0.01)
    assert fast > 0.3 and slow < 1
    assert sketch.field("DBGMCU_APB1FZ", "DBG_IWDG_STOP") == 1
    assert sketch.sins == []


def test_the_watchdog_runs_all_the_same_when_it_does_not_take_its_numbers(
    make_sketch: Callable[..., Any], symbols: dict[str, int]
) -> None:
    sketch = make_sketch()
    sketch.on_read = lambda register: sketch.poke(register.address, 3) if register.name == "IWDG_SR" else None
    sketch.run(symbols["power_start"])
    assert sketch.sins == []
