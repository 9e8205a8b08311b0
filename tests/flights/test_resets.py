"""From any reset to the stop frames on the emulated pins: an ESC holds its last value until frames come."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from neuroflight.flash.link.msp import encode, request
from neuroflight.sim.board.board import Board
from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.devices.esc import Frame
from neuroflight.sim.board.devices.gyro_chip import GyroKind
from neuroflight.sim.board.devices.gyro_mpu import ICM20689, MPU6500, MpuKind
from neuroflight.sim.board.peripherals.usart import Format
from neuroflight.sim.board.serial.bridge import MSP_UART, LineTransport, UartLine
from neuroflight.toolchain.contract import FLASH_BASE, FLASH_BYTES, FLASH_FAULT_RECORD, MSP_BAUD_DEFAULT, Msp
from neuroflight.toolchain.image.elf import read_flashable

BOUND_S = 0.02  # from a reset to the first frame of each motor
PAUSE_S = 0.012  # between two frames of a motor, up to the second in which flash may be written
MOTORS = 4


@dataclass(frozen=True, kw_only=True)
class Nothing(MpuKind):
    """A place without a chip: its bus reads high whatever is asked, and knows no write."""

    def told(self, register: int) -> int:
        return 0xFF


ABSENT = Nothing(name="nothing", who_am_i=0xFF, data_hz=20_000_000, counts_per_degree=1.0, zero_deg_c=0.0)
CHIPS = {"mpu6500": MPU6500, "icm20689": ICM20689, "absent": ABSENT}


class Pins:
    """A board of its own, and the frames on its motors' pins."""

    def __init__(self, image: Path, chip: GyroKind = MPU6500, *, log_full: bool = False) -> None:
        flash, elf = bytearray(read_flashable(image)), image.with_suffix(".elf")
        flash += b"\xff" * (FLASH_BYTES - len(flash))
        if log_full:
            start = FLASH_FAULT_RECORD.address - FLASH_BASE
            flash[start : start + FLASH_FAULT_RECORD.size] = bytes(FLASH_FAULT_RECORD.size)
        self.board = Board(bytes(flash), elf=elf, chip=chip, strict=False, watchdog_resets=True)
        self.board.hardware.gyro.measure((0, 0, 2048), 0, (0, 0, 0))
        self.frames: list[Frame] = []
        self.board.hardware.hear_frames(self.frames.append)

    def run(self, seconds: float) -> None:
        self.board.run(seconds)

    def await_reset(self, seconds: float, cause: str) -> None:
        """Run until the board has been reset."""
        resets = self.board.engine.resets
        known, end = len(resets), self.board.cycle + round(seconds * TIME_HZ)
        while len(resets) == known:
            assert self.board.cycle < end, f"no reset within {seconds} s"
            self.board.run(0.0001)
        assert resets[known:] == [cause]

    def never_feeds(self) -> None:
        """From now on the program's feeding of the watchdog does nothing."""
        engine = self.board.engine
        engine.set_memory(self.board.symbols["hal_watchdog_feed"] & ~1, bytes.fromhex("7047"))  # bx lr

    def send_msp(self, command: Msp) -> None:
        """A request on the MSP line."""
        line = LineTransport(UartLine(self.board, MSP_UART, Format(MSP_BAUD_DEFAULT)), self.board.run_to)
        line.write(encode(request(command)))

    def answers_within_bound(self) -> None:
        """The reset is now: stop frames come in time to each motor, and go on."""
        self.frames.clear()
        reset = self.board.cycle
        self.run(0.3)
        for motor in range(1, MOTORS + 1):
            at = [frame.cycle for frame in self.frames if frame.motor == motor]
            assert at, f"motor {motor} gets no frame"
            assert (at[0] - reset) / TIME_HZ <= BOUND_S
            assert max(after - before for before, after in itertools.pairwise(at)) / TIME_HZ <= PAUSE_S
            print(f"motor {motor}: {1000 * (at[0] - reset) / TIME_HZ:.1f} ms to its first frame")
        assert {frame.value for frame in self.frames} == {0}


@pytest.fixture
def pins(board_image: Path) -> Iterator[Callable[..., Pins]]:
    with contextlib.ExitStack() as stack:

        def make(chip: str = "mpu6500", *, log_full: bool = False) -> Pins:
            made = Pins(board_image.with_suffix(".bin"), CHIPS[chip], log_full=log_full)
            stack.callback(made.board.close)
            return made

        yield make


@pytest.mark.parametrize("chip", CHIPS)
def test_stop_frames_come_in_time_when_the_board_gets_its_power(pins: Callable[..., Pins], chip: str) -> None:
    pins(chip).answers_within_bound()


@pytest.mark.parametrize("chip", CHIPS)
def test_stop_frames_come_in_time_when_the_supply_dips(pins: Callable[..., Pins], chip: str) -> None:
    board = pins(chip)
    board.run(0.5)
    board.board.brown_out()
    board.answers_within_bound()


@pytest.mark.parametrize("chip", ["mpu6500", "absent"])
def test_stop_frames_come_in_time_when_the_watchdog_resets(pins: Callable[..., Pins], chip: str) -> None:
    board = pins(chip)
    board.run(0.5)
    board.never_feeds()
    board.await_reset(1.0, "iwdg")
    board.answers_within_bound()


@pytest.mark.parametrize("chip", ["mpu6500", "absent"])
def test_stop_frames_come_in_time_when_the_processor_faults(pins: Callable[..., Pins], chip: str) -> None:
    board = pins(chip)
    board.run(0.5)
    board.board.engine.pc = 0x60000000  # external memory, which this board has none of
    board.await_reset(0.01, "software")
    board.answers_within_bound()


@pytest.mark.parametrize("chip", ["mpu6500", "absent"])
def test_stop_frames_come_in_time_when_msp_asks_for_a_reboot(pins: Callable[..., Pins], chip: str) -> None:
    board = pins(chip)
    board.run(0.7)
    board.send_msp(Msp.REBOOT)
    board.await_reset(0.1, "software")
    board.answers_within_bound()


def test_stop_frames_come_in_time_when_the_gyro_is_silent_after_the_reset(pins: Callable[..., Pins]) -> None:
    board = pins()
    board.run(0.7)
    board.board.brown_out()
    board.board.hardware.gyro.silent = True
    board.answers_within_bound()
    board.frames.clear()
    board.run(0.5)  # the program's own frames, now that it runs
    assert len(board.frames) >= 0.4 / PAUSE_S
    assert {frame.value for frame in board.frames} == {0}


@pytest.mark.slow
def test_stop_frames_come_for_seconds_before_the_full_fault_log_is_erased(pins: Callable[..., Pins]) -> None:
    board = pins(log_full=True)
    board.answers_within_bound()
    flash = board.board.hardware.flash
    assert flash.operations == 0
    board.run(4.5)
    assert flash.operations == 0
    board.run(2.0)
    assert flash.operations > 20, "erased, then an entry written"
    pauses = [after.cycle - before.cycle for before, after in itertools.pairwise(board.frames[::MOTORS])]
    assert sum(pause > PAUSE_S * TIME_HZ for pause in pauses) == 1
    assert {frame.value for frame in board.frames} == {0}
