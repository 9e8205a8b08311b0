"""What unicorn's callbacks cost beside its bare speed.

The same loop runs with none, with one at each block, with one at each instruction as well, and under the
engine of the emulated board. The callback is a C function that does nothing: what the engine does in its own
shows in the last row.
"""

from __future__ import annotations

import ctypes
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass

import unicorn
from unicorn import arm_const
from unicorn.unicorn_py3.unicorn import uclib

from neuroflight.sim.board.core.engine import Engine
from neuroflight.toolchain.contract import FLASH_BASE, FLASH_BYTES

LOOPS = 500_000
RUNS = 7  # of which the fastest counts
RAM, RAM_BYTES = 0x20000000, 0x40000
CODE = 0x100  # offset in flash


def _move(operation: int, register: int, value: int) -> bytes:
    """MOVW or MOVT (ARMv7-M DDI 0403E A7.7.76, A7.7.79)."""
    first = operation | (value >> 11 & 1) << 10 | value >> 12
    return struct.pack("<2H", first, (value >> 8 & 7) << 12 | register << 8 | value & 0xFF)


def _word(register: int, value: int) -> bytes:
    return _move(0xF240, register, value & 0xFFFF) + _move(0xF2C0, register, value >> 16)


_LOOP = struct.pack(
    "<10H",
    *(0x1C52, 0x1C9B, 0x18D4, 0x4054, 0x1C52, 0x1C9B),  # adds r2; adds r3; adds r4; eors r4; adds r2; adds r3
    *(0x6008, 0x680D),  # str r0, [r1]; ldr r5, [r1]
    *(0x3801, 0xD1F5),  # subs r0, #1; bne to the first
)
_HEAD = _word(0, LOOPS) + _word(1, RAM + 0x100)
_REST = struct.pack("<2H", 0xBF30, 0xE7FE)  # wfi; b .
BLOCK = 10  # instructions of the loop, which unicorn translates as one
FLASH = struct.pack("<2I", RAM + 0x1000, FLASH_BASE + CODE | 1).ljust(CODE, b"\xff") + _HEAD + _LOOP + _REST


@dataclass(frozen=True)
class Cost:
    """How long an instruction of the loop took."""

    name: str
    ns: float


def unicorn_costs() -> tuple[Cost, ...]:
    """The loop's instruction under each kind of callback; the first row is unicorn alone."""
    block, code = unicorn.UC_HOOK_BLOCK, unicorn.UC_HOOK_CODE
    return (
        Cost("unicorn alone", _best(_bare)),
        Cost("a callback at each block", _best(lambda: _bare(block))),
        Cost("and at each instruction", _best(lambda: _bare(block, code))),
        Cost("the engine", _best(_engine)),
    )


def _best(run: Callable[[], float]) -> float:
    return 1e9 * min(run() for _ in range(RUNS)) / (LOOPS * BLOCK)


def _bare(*hooks: int) -> float:
    """Seconds that unicorn takes for the loop."""
    core = unicorn.Uc(unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB | unicorn.UC_MODE_MCLASS)
    core.ctl_set_cpu_model(arm_const.UC_CPU_ARM_CORTEX_M7)
    core.mem_map(FLASH_BASE, FLASH_BYTES, unicorn.UC_PROT_READ | unicorn.UC_PROT_EXEC)
    core.mem_map(RAM, RAM_BYTES, unicorn.UC_PROT_READ | unicorn.UC_PROT_WRITE)
    core.mem_write(FLASH_BASE, FLASH)
    nothing = ctypes.cast(ctypes.CDLL(None).labs, ctypes.c_void_p)
    for kind in hooks:
        place = ctypes.c_size_t()
        everywhere = ctypes.c_uint64(1), ctypes.c_uint64(0)
        if uclib.uc_hook_add(core._uch, ctypes.byref(place), kind, nothing, None, *everywhere):
            raise RuntimeError("unicorn takes no hook")
    begin, end = FLASH_BASE + CODE, FLASH_BASE + CODE + len(_HEAD) + len(_LOOP)
    since = time.perf_counter()
    core.emu_start(begin | 1, end)
    return time.perf_counter() - since


def _engine() -> float:
    """Seconds that the engine takes for it."""
    engine = Engine(FLASH)
    since = time.perf_counter()
    engine.run(instructions=LOOPS * BLOCK)
    since = time.perf_counter() - since
    engine.close()
    return since
