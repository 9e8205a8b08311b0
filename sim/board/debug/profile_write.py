"""A profile of what an image did on the emulated board, as files in a directory."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from neuroflight.sim.board.board import Board
from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.debug.flame_graph import flame_graph
from neuroflight.sim.board.debug.profile import coverage, folded_stacks, profile_table, task_counts
from neuroflight.toolchain.files import write_text

EVERY = 1 << 20  # functions, more than there are
_US = 1e6 / TIME_HZ


def write_profile(directory: Path, board: Board) -> tuple[str, ...]:
    """Write all files into `directory`, made if it is not there, each in one step; returns their names.

    tasks.txt, functions.txt, coverage.txt, registers.txt, stacks.folded, flame.svg; see
    docs/explanation/emulated-board.md.
    Raises BuildError unless the board was made with `profile` and the image's ELF.
    """
    stacks = folded_stacks(board.engine)
    instructions = board.engine.instructions
    title = f"{instructions:,} instructions in {board.cycle / TIME_HZ:.3f} s of the board's time"
    files = {
        "tasks.txt": tasks_table(board),
        "functions.txt": profile_table(board.engine, EVERY),
        "coverage.txt": coverage_table(board),
        "registers.txt": registers_table(board),
        "stacks.folded": stacks,
        "flame.svg": (flame_graph(stacks, title).rstrip("\n"),),
    }
    for name, lines in files.items():
        write_text(directory / name, "\n".join(lines) + "\n")
    return tuple(files)


def tasks_table(board: Board) -> Iterator[str]:
    """Yield a line for each exception's handler: runs, instructions, and its worst delay with the place."""
    total = max(board.engine.instructions, 1)
    yield (
        f"{'task':12} {'handler':24} {'runs':>9} {'instructions':>14} {'share':>7} {'least':>7} {'mean':>9} "
        f"{'most':>7} {'longest us':>11} {'latest us':>10}  where it waited so"
    )
    for task in task_counts(board.engine):
        name = f"{task.name:12} {task.handler:24}"
        share = f"{task.instructions:14,} {task.instructions / total:7.1%}"
        if task.exception == 0:
            yield f"{name} {'':>9} {share}"
            continue
        mean = task.instructions / task.activations
        yield (
            f"{name} {task.activations:9,} {share} {task.least:7,} {mean:9,.1f} "
            f"{task.most:7,} {task.longest * _US:11.2f} {task.latest * _US:10.3f}  "
            f"{task.latest_place if task.latest else 'it never did'}"
        )


def coverage_table(board: Board) -> Iterator[str]:
    """Yield each function's share of executed instructions, and the spans of those never executed."""
    functions = coverage(board.engine)
    count = sum(function.instructions for function in functions)
    missed = sum(len(function.missed) for function in functions)
    yield f"{count - missed:,} of {count:,} instructions executed, {1 - missed / max(count, 1):.1%}"
    yield ""
    yield f"{'function':32} {'instructions':>12} {'executed':>9}  never"
    for function in functions:
        yield (
            f"{function.name:32} {function.instructions:12,} {function.share:9.1%}  {_spans(function.missed)}"
        ).rstrip()


def registers_table(board: Board) -> Iterator[str]:
    """Yield every register of a peripheral that the image touched."""
    yield f"{'register':24} {'reads':>14} {'writes':>14}"
    for touch in board.report().registers:
        yield f"{touch.register:24} {touch.reads:14,} {touch.writes:14,}"


def _spans(addresses: tuple[int, ...]) -> str:
    """Format spans of consecutive instructions: "0x08020100..0x0802010C, 0x08020200"."""
    spans: list[list[int]] = []
    for address in addresses:
        if spans and address - spans[-1][1] <= 4:
            spans[-1][1] = address
        else:
            spans.append([address, address])
    return ", ".join(f"0x{a:08X}" if a == b else f"0x{a:08X}..0x{b:08X}" for a, b in spans)
