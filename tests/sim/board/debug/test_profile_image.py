"""Counts of the real image on the whole board."""

from __future__ import annotations

from pathlib import Path

from neuroflight.sim.board.board import Board
from neuroflight.sim.board.debug.profile import coverage, execution_counts, task_counts
from neuroflight.toolchain.cortex_m7.disassembly import disassemble

MIDDLE = 150_000_123  # cycles: samples have begun


def test_counts_lie_on_the_images_instructions_when_it_has_run(board_image: Path) -> None:
    board = Board(board_image.with_suffix(".bin").read_bytes(), elf=board_image)
    board.run_to(MIDDLE)
    assert {task.handler for task in task_counts(board.engine)} >= {"gyro_edge_handler", "tick_handler"}
    executed = execution_counts(board.engine)
    assert set(executed) <= set(disassemble(board_image))
    assert sum(executed.values()) == board.engine.instructions
    by_name = {function.name: function for function in coverage(board.engine)}
    assert by_name["reset_handler"].share > 0.8
