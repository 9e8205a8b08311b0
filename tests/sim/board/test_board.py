"""A small firmware, independent of ours, on the whole board: what it does, that it repeats, and restored."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from neuroflight.sim.board.board import Board
from neuroflight.sim.board.core.context import BoardError
from neuroflight.sim.board.debug.snapshot import restore_snapshot, take_snapshot
from neuroflight.sim.board.devices.gyro_mpu import MPU6500
from neuroflight.sim.board.peripherals.usart import SBUS

BOOT_S = 0.0072
QUICK = replace(MPU6500, start_ms=1, reset_ms=2)  # a chip that need not be waited for
GCC = "arm-none-eabi-gcc"
FLAGS = ("-mcpu=cortex-m7", "-mthumb", "-O2", "-std=c11", "-ffreestanding", "-nostdlib", "-Wall", "-Wextra")
PLACES = """SECTIONS {
    . = 0x08000000;
    .text : { KEEP(*(.vectors)) *(.text*) *(.rodata*) }
    . = 0x20010000;
    .bss (NOLOAD) : { bss_start = .; *(.bss*) bss_end = .; }
    /DISCARD/ : { *(.ARM.*) }
}"""


def build(folder: Path, source: str) -> tuple[bytes, Path]:
    """Compile and link a program; its image and ELF."""
    code, script, elf = folder / "flight.c", folder / "flight.ld", folder / "flight.elf"
    code.write_text(source)
    script.write_text(PLACES)
    link = [f"-Wl,-T,{script}", "-Wl,-e,reset", "-g"]
    subprocess.run([GCC, *FLAGS, *link, str(code), "-o", str(elf)], check=True)
    image = elf.with_suffix(".bin")
    subprocess.run(["arm-none-eabi-objcopy", "-O", "binary", "-j", ".text", str(elf), str(image)], check=True)
    return image.read_bytes(), elf


@pytest.fixture(scope="module")
def source() -> str:
    return (Path(__file__).parent / "flight.c").read_text()


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory, source: str) -> tuple[bytes, Path]:
    """Image and ELF."""
    return build(tmp_path_factory.mktemp("flight"), source)


@pytest.fixture
def make_board(program: tuple[bytes, Path]) -> Callable[..., Board]:
    return lambda **options: Board(program[0], elf=program[1], chip=QUICK, **options)


def counts(number: int) -> tuple[int, int, int]:
    """What the gyro measures at sample `number`."""
    return (number * 7 % 30_000, -(number * 13) % 30_000 - 15_000, number * 101 % 30_000)


def fly(board: Board) -> list[tuple[int, int, int]]:
    """Let the gyro move; returns the list to which frames come as cycle, motor, value."""
    frames: list[tuple[int, int, int]] = []
    gyro = board.hardware.gyro
    gyro.before_sample = lambda number: gyro.measure((0, 0, 2048), 0, counts(number))
    board.hardware.hear_frames(lambda frame: frames.append((frame.cycle, frame.motor, frame.value)))
    return frames


def peek(board: Board, name: str) -> int:
    return int.from_bytes(board.engine.memory(board.symbols[name], 4), "little")


def test_motors_follow_the_gyro_when_the_program_flies(make_board: Callable[..., Board]) -> None:
    board = make_board()
    frames = fly(board)
    board.run(BOOT_S + 0.02)
    frames.sort()  # those of a time come in the order of their last edges
    read = range(0, board.hardware.gyro.samples, 2)  # every second edge
    expected = [48 + counts(k)[i % 3] % 65536 % 2000 for k in read for i in range(4)]
    values = [value for _, _, value in frames]
    assert len(values) > 4 * 60
    assert values == expected[: len(values)]
    assert [motor for _, motor, _ in frames[:4]] == [1, 2, 3, 4]
    # Every 250 us but for what the core takes to get there, and in the long run exactly so.
    steps = [b - a for (a, _, _), (b, _, _) in zip(frames[::4], frames[4::4], strict=False)]
    assert all(abs(step - 54_000) < 30 for step in steps)
    assert abs(sum(steps) - 54_000 * len(steps)) < 30


def test_samples_keep_their_beat_when_the_core_is_busy(tmp_path: Path, source: str) -> None:
    image, elf = build(tmp_path, source.replace('__asm volatile("wfi")', "pause_us(1)"))
    board = Board(image, elf=elf, chip=QUICK)
    board.run(BOOT_S)
    first, number = board.hardware.gyro.next_sample, board.hardware.gyro.samples
    assert first is not None
    board.run(0.02)
    gyro = board.hardware.gyro
    assert gyro.next_sample == first + 27_000 * (gyro.samples - number)


def test_receiver_bytes_are_there_when_they_have_come(make_board: Callable[..., Board]) -> None:
    board = make_board()
    board.run(BOOT_S)
    end = board.hardware.usarts["USART2"].feed(bytes(25), SBUS)
    board.run_to(end + 300 * 216)
    assert peek(board, "received") == 25


def test_run_repeats_to_the_bit_when_made_again(make_board: Callable[..., Board]) -> None:
    hashes = []
    for _ in range(2):
        board = make_board()
        fly(board)
        board.run(BOOT_S + 0.01)
        hashes.append((board.engine.trace_hash, board.cycle, str(board.report())))
    assert hashes[0] == hashes[1]


def test_run_goes_on_alike_when_restored_in_the_middle(make_board: Callable[..., Board]) -> None:
    board = make_board()
    frames = fly(board)
    board.run(BOOT_S + 0.0011)
    board.hardware.usarts["USART2"].feed(b"0123456789", SBUS)
    board.run(0.00031)
    # In the midst of things: bytes on the line, a frame or a sample under way.
    snapshot = take_snapshot(board.engine)
    results: list[Any] = []
    for _ in range(2):
        frames.clear()
        board.run(0.005)
        report = board.report()
        results.append((list(frames), board.engine.trace_hash, report.registers, peek(board, "received")))
        restore_snapshot(board.engine, snapshot)
    assert results[0] == results[1]
    assert results[0][3] == 10
    other = make_board()
    frames = fly(other)
    restore_snapshot(other.engine, snapshot)
    other.run(0.005)
    assert (frames, other.engine.trace_hash) == results[0][:2]


def test_report_names_every_register_when_the_program_has_run(make_board: Callable[..., Board]) -> None:
    board = make_board()
    board.run(BOOT_S)
    report = board.report()
    touched = {t.register for t in report.registers}
    assert {"RCC_CR", "SPI1_DR", "TIM8_CNT", "DMA2_S1CR", "EXTI_PR", "USART2_BRR"} <= touched
    assert not {t for t in touched if t.startswith(("TIM3", "I2C", "GPIOB"))}
    assert "resets: power" in str(report)
    assert "RCC_PLLCFGR" in str(report)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("R(FLASH) = 7u", "R(FLASH) = 6u", "flash wait states too few"),
        ("1u << 1 | 1u << 12 | 1u << 14", "1u << 12 | 1u << 14", "TIM8_ARR is written without its clock"),
        ("(u32)request;", "0x20000100;", r"DMA2 stream 3 reads DTCM \(0x20000100\) while the core sleeps"),
        ("R(SYSCFG + 8) = 2u << 12;", "R(0x40005400) = 1;", "I2C1 is not modelled"),
    ],
)
def test_mistake_is_named_with_its_place_when_the_program_makes_it(
    tmp_path: Path, source: str, old: str, new: str, message: str
) -> None:
    assert source.count(old) == 1
    image, elf = build(tmp_path, source.replace(old, new))
    board = Board(image, elf=elf, chip=QUICK)
    with pytest.raises(BoardError, match=message) as caught:
        board.run(BOOT_S + 0.01)
    assert "flight.c:" in str(caught.value)


def test_chip_and_processor_start_anew_when_the_supply_dips(make_board: Callable[..., Board]) -> None:
    board = make_board()
    fly(board)
    board.run(BOOT_S + 0.002)
    assert peek(board, "samples") > 4
    board.brown_out()
    board.run(0.001)
    assert board.report().resets == ("power", "brown-out")
    assert board.hardware.gyro.next_sample is None
    board.run(BOOT_S)
    assert board.hardware.gyro.samples > 0


def test_processor_goes_on_with_hsi_when_the_crystal_fails(make_board: Callable[..., Board]) -> None:
    """The program has no handler: the non-maskable interrupt is what stops it."""
    board = make_board()
    board.run(BOOT_S)
    board.hardware.rcc.fail_crystal()
    assert board.hardware.rcc.clocks.core == 16_000_000
    with pytest.raises(BoardError):
        board.run(0.001)
