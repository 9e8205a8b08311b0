"""The result of lowering: calls of kernels, and the places in `struct policy` that they work on."""

from __future__ import annotations

from dataclasses import dataclass

BLOCK = 8  # outputs summed at a time: 8 sums, 8 inputs and 16 weights fill the FPU's 32 registers


@dataclass(frozen=True)
class BufferPlace:
    """The place of a value in `struct policy`."""

    memory: str  # "scratch" or "state"
    offset: int  # floats


@dataclass(frozen=True)
class Call:
    """One call of a kernel: target[0..count) from its sources, table and constants."""

    kernel: str
    target: BufferPlace | None  # None: the action
    sources: tuple[BufferPlace, ...]  # none: the observation
    count: int  # values; for "linear8" and "linear4" blocks
    table: int | None = None  # offset of its part in the table
    inputs: int = 0  # of a linear kernel, or the stride of a "copy"
    constants: tuple[float, ...] = ()
