"""The real image on the whole board: equal runs, snapshots in mid-flight, counts on real instructions."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from neuroflight.sim.board.board import Board
from neuroflight.sim.board.debug.profile import coverage, execution_counts, task_counts
from neuroflight.sim.board.debug.snapshot import restore_snapshot, take_snapshot
from neuroflight.toolchain.cortex_m7.disassembly import disassemble

MIDDLE, END = 150_000_123, 200_000_000  # cycles: samples have begun


@pytest.fixture
def make(board_image: Path) -> Callable[[], Board]:
    """Boards with the image, just powered."""
    return lambda: Board(board_image.with_suffix(".bin").read_bytes(), elf=board_image)


def facts(board: Board) -> tuple[object, ...]:
    engine = board.engine
    memory = engine.memory(0x20000000, 0x10000)
    return engine.cycle, engine.instructions, engine.trace_hash, memory, str(board.report())


def test_the_image_flies_on_identically_when_restored(make: Callable[[], Board]) -> None:
    board = make()
    board.run_to(MIDDLE)
    snapshot = take_snapshot(board.engine)
    board.run_to(END)
    first = facts(board)
    assert {task.handler for task in task_counts(board.engine)} >= {"gyro_edge_handler", "tick_handler"}
    again = make()
    again.run_to(END)
    assert facts(again) == first
    restore_snapshot(again.engine, snapshot)
    again.run_to(END)
    assert facts(again) == first


def test_counts_lie_on_the_images_instructions_when_it_has_run(
    make: Callable[[], Board], board_image: Path
) -> None:
    board = make()
    board.run_to(MIDDLE)
    executed = execution_counts(board.engine)
    assert set(executed) <= set(disassemble(board_image))
    assert sum(executed.values()) == board.engine.instructions
    by_name = {function.name: function for function in coverage(board.engine)}
    assert by_name["reset_handler"].share > 0.8
