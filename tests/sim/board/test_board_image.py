"""The project's own image on the board with its busy peripherals in C, and with all of them in Python."""

from __future__ import annotations

from pathlib import Path

from sim.board.board import Board
from sim.board.peripherals.usart import SBUS


def test_image_does_the_same_when_peripherals_are_in_c_and_in_python(board_image: Path) -> None:
    image = board_image.with_suffix(".bin").read_bytes()
    seen = []
    for in_c in (True, False):
        board = Board(image, elf=board_image, in_c=in_c)
        gyro = board.hardware.gyro
        gyro.before_sample = lambda number, gyro=gyro: gyro.measure(  # type: ignore[misc]
            (0, 0, 2048), 333, (number % 3, 0, -(number % 2))
        )
        board.hardware.adc.set_battery(16.0, 1.0)
        board.run(0.35)
        board.hardware.usarts["USART2"].feed(bytes(25), SBUS)
        board.run(0.1)
        report = board.report()
        seen.append((board.engine.trace_hash, report.instructions, report.frames, report.registers))
        board.close()
    assert seen[0] == seen[1]
    assert min(seen[0][2][:4]) > 100
