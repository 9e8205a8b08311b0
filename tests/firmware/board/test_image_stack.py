"""The image's stack: the bound by analysis, against what the emulated core really uses."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from unicorn.arm_const import UC_ARM_REG_SP

from neuroflight.toolchain.cortex_m7.stack_use import StackUse, stack_use

STACK_BYTES = 7168
SPARE_BYTES = 1920  # that nothing of ours may ever need


@pytest.fixture(scope="module")
def analysed(image_folder: Path) -> StackUse:
    return stack_use(image_folder / "neuroflight.elf", image_folder / "obj")


@contextmanager
def watched(sketch: Any) -> Iterator[list[int]]:
    """The lowest stack pointer so far, before every instruction."""
    lowest = [1 << 32]

    def on_code(_address: int) -> None:
        lowest[0] = min(lowest[0], sketch.uc.reg_read(UC_ARM_REG_SP))

    before, sketch.on_code = sketch.on_code, on_code
    yield lowest
    sketch.on_code = before


def test_the_deepest_stack_leaves_room_when_analysed(analysed: StackUse) -> None:
    print(f"{analysed.worst:,} of {analysed.size:,} bytes at worst: {analysed}")
    assert analysed.size == STACK_BYTES
    assert analysed.margin >= SPARE_BYTES


@pytest.fixture
def sketch(make_sketch: Callable[..., Any], make_chip: Callable[..., Any]) -> Any:
    """A board with a gyro chip, about to be switched on."""
    made = make_sketch(cycles_a_read=2000)
    make_chip(made, 0x70)
    return made


def test_the_program_keeps_to_its_bound_when_started(
    analysed: StackUse, sketch: Any, symbols: dict[str, int]
) -> None:
    with watched(sketch) as lowest:
        sketch.run(symbols["msp_lines_serve"])
    used = symbols["stack_top"] - lowest[0]
    assert 100 < used <= analysed.thread.size


@pytest.mark.parametrize(
    ("level", "handler"), [(0, "gyro_sample_handler"), (0, "tick_handler"), (2, "gyro_edge_handler")]
)
def test_handlers_keep_to_their_bound_when_called(
    level: int, handler: str, analysed: StackUse, sketch: Any, symbols: dict[str, int]
) -> None:
    sketch.run(symbols["msp_lines_serve"])
    before = sketch.uc.reg_read(UC_ARM_REG_SP)
    with watched(sketch) as lowest:
        for _ in range(12):  # silence among the ticks, control steps among the samples
            sketch.call(symbols[handler])
    assert 0 <= before - lowest[0] <= analysed.interrupts[level].size
