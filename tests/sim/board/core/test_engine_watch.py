"""Watchpoints of the engine: what they see is held against the accesses that unicorn itself tells of."""

from __future__ import annotations

import random
import struct
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import pytest
import unicorn
from unicorn import arm_const

from neuroflight.sim.board.core.context import BoardError
from neuroflight.sim.board.core.engine import CORE_REGISTERS, Engine, Outcome, Watchpoint
from tests.sampling import examples
from tests.sim.board.programs import RESULTS, Boot

FLASH, CODE, RAM, RAM_BYTES = 0x08000000, 0x08000400, 0x20000000, 0x40000
CPACR = 0xE000ED88
STRIDE = 8  # bytes for each instruction and the jump to itself behind it
HERE = 0xE7FE  # b .
CASES = examples(4000)
LOADS_AND_STORES = (0x4800, 0x5000, 0x6000, 0x7000, 0x8000, 0x9000, 0xB400, 0xBC00, 0xC000)  # first halfwords
WIDE = (0xE800, 0xE840, 0xE8C0, 0xE900, 0xEC00, 0xED00, 0xF800, 0xF880, 0xF900)
MASKS_OF_WIDE = (0x01FF, 0x01BF, 0x003F, 0x00FF, 0x00FF, 0x00FF, 0x007F, 0x007F, 0x01FF)
# What changes more than registers and memory (IT, SVC, system instructions), Advanced SIMD, which the core
# has not, and stores that need a load before (STREX) or are against PC (unpredictable).
LEFT_OUT = (
    *((0xFF00, 0xBF00), (0xFF00, 0xB600), (0xF000, 0xD000), (0xFFC0, 0xF380), (0xFF00, 0xBE00)),
    *((0xFF10, 0xF900), (0xFFF0, 0xE840), (0xFFF0, 0xE8C0), (0xFE1F, 0xF80F)),
)


def instructions(seed: int) -> Iterator[tuple[int, int]]:
    """Draw halfwords of instructions, most of them loads and stores of every form; many are undefined."""
    rng = random.Random(seed)
    while True:
        b = rng.getrandbits(16)
        kind = rng.random()
        if kind < 0.25:
            a, b = rng.choice(LOADS_AND_STORES) | rng.getrandbits(11), HERE
        elif kind < 0.9:
            i = rng.randrange(len(WIDE))
            a = WIDE[i] | rng.getrandbits(16) & MASKS_OF_WIDE[i]
            if WIDE[i] & 0xFE00 == 0xEC00:
                b = b & ~0xE00 | 0xA00  # the floating-point unit's
            elif a & 0xFFF0 == 0xE8D0:
                b = b & ~0xF0 | rng.choice((0x00, 0x10, 0x40, 0x50))  # TBB, TBH, LDREXB, LDREXH
        else:
            a = rng.getrandbits(16)
            b = b if a >= 0xE800 else HERE
        if not any(a & mask == value for mask, value in LEFT_OUT):
            yield a, b


def registers(seed: int) -> dict[int, int]:
    """r0 to r3 are small, the others point into RAM."""
    rng = random.Random(seed)
    values = {i: 4 * rng.randrange(8) for i in range(4)}
    return values | {i: RAM + 0x10000 + 8 * rng.randrange(0x1000) for i in range(4, 15)}


class Judge:
    """Unicorn by its own binding: the accesses of one instruction."""

    def __init__(self, flash: bytes) -> None:
        self.uc = unicorn.Uc(unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB | unicorn.UC_MODE_MCLASS)
        self.uc.ctl_set_cpu_model(arm_const.UC_CPU_ARM_CORTEX_M7)
        self.uc.mem_map(FLASH, 0x80000, unicorn.UC_PROT_READ | unicorn.UC_PROT_EXEC)
        self.uc.mem_write(FLASH, flash)
        self.uc.mem_map(RAM, RAM_BYTES)
        self.uc.hook_add(unicorn.UC_HOOK_MEM_READ | unicorn.UC_HOOK_MEM_WRITE, self._note)
        self.seen: list[tuple[bool, int, int]] = []

    def _note(self, uc: Any, kind: int, address: int, size: int, value: int, user: object) -> None:
        self.seen.append((kind == unicorn.UC_MEM_WRITE, address, size))

    def accesses(self, at: int, values: dict[int, int]) -> tuple[bool, int, int] | None:
        """Return whether it stores, and the span it accesses, if any. Raises UcError for no instruction."""
        for number, value in values.items():
            self.uc.reg_write(CORE_REGISTERS[number], value)
        self.seen.clear()
        self.uc.emu_start(at | 1, 0xFFFFFFFF, count=1)
        if not self.seen:
            return None
        stores = {store for store, _, _ in self.seen}
        assert len(stores) == 1
        spans = [(address, address + size) for _, address, size in self.seen]
        return stores.pop(), min(start for start, _ in spans), max(end for _, end in spans)


def test_watchpoints_see_what_unicorn_accesses_when_any_load_or_store_is_executed() -> None:
    drawn = [pair for pair, _ in zip(instructions(7), range(CASES), strict=False)]
    head = struct.pack("<II", RAM + 0x1000, CODE | 1).ljust(CODE - FLASH, b"\0")
    flash = head + b"".join(struct.pack("<4H", a, b, HERE, HERE) for a, b in drawn)
    judge, engine = Judge(flash), Engine(flash)
    engine.store(CPACR, 4, 0x00F00000)
    found = {False: 0, True: 0}
    none = 0

    def stops(at: int, values: dict[int, int], store: bool, start: int, end: int) -> int | None:
        for number, value in values.items():
            engine.set_register(number, value)
        engine.pc = at
        engine.set_watchpoints([Watchpoint(start, end - start, loads=not store, stores=store)])
        before = engine.instructions
        outcome = None
        with suppress(BoardError):
            outcome = engine.run(instructions=1)
        if outcome is not Outcome.WATCHPOINT:  # it was executed, and may have jumped anywhere
            if outcome is None or not 0 < engine.pc - at <= 4:
                engine.pull_reset()
                engine.store(CPACR, 4, 0x00F00000)
            return None
        assert (engine.pc, engine.instructions) == (at, before)
        assert {n: engine.register(n) for n in values} == values, "nothing was executed"
        return engine.watch_hit[1]

    for i in range(CASES):
        at, values = CODE + STRIDE * i, registers(i)
        try:
            expected = judge.accesses(at, values)
        except (unicorn.UcError, AssertionError):
            judge = Judge(flash)
            continue
        if expected is None:
            none += 1
            assert stops(at, values, True, FLASH, RAM + RAM_BYTES) is None, drawn[i]
            continue
        store, start, end = expected
        found[store] += 1
        assert stops(at, values, store, start - 1, end + 1) == start, drawn[i]
        assert stops(at, values, store, start, start + 1) == start, drawn[i]
        assert stops(at, values, store, end - 1, end) == end - 1, drawn[i]
        if start >= RAM:
            assert stops(at, values, not store, start, end) is None, drawn[i]
    assert min(found.values()) > CASES // 10 and none > CASES // 60


LOOPING = """
__attribute__((noinline)) void step(void) { RESULT[0] += 3; }
HANDLER tick(void) { RESULT[1] += 1; }
HANDLER reset(void)
{
    REG(0xE000E014) = 200; REG(0xE000E018) = 0; REG(0xE000E010) = 7;
    RESULT[0] = RESULT[1] = 0;
    for (;;) step();
}
VECTORS([15] = tick);
"""


def watched(address: int = RESULTS, size: int = 4) -> list[Watchpoint]:
    return [Watchpoint(address, size, loads=False, stores=True)]


def test_the_run_is_the_same_when_it_is_watched_and_stops(boot: Boot) -> None:
    """Time, jumps and interrupts: `trace_hash` is of all of them."""
    free, held = boot(LOOPING), boot(LOOPING)
    free.run_to(200_000)
    held.set_watchpoints(watched() + watched(RESULTS + 4))
    stops = 0
    while held.run(200_000) is Outcome.WATCHPOINT:
        held.skip_breakpoint()
        stops += 1
    assert stops == held.load(RESULTS, 4) // 3 + held.load(RESULTS + 4, 4) + 2  # the two that clear them
    assert (held.cycle, held.instructions) == (free.cycle, free.instructions)
    assert held.trace_hash == free.trace_hash
    assert held.memory(RAM, 0x3000) == free.memory(RAM, 0x3000)


def test_it_stops_once_at_a_breakpoint_when_an_interrupt_comes_before_the_instruction(boot: Boot) -> None:
    engine = boot(LOOPING)
    engine.set_breakpoints([engine.symbols["step"]])
    stops = 0
    while engine.run(200_000) is Outcome.BREAKPOINT:
        engine.skip_breakpoint()
        stops += 1
    assert engine.load(RESULTS + 4, 4) > 50
    assert stops - engine.load(RESULTS, 4) // 3 in (0, 1)


def test_it_stops_behind_an_it_block_when_the_access_is_inside(boot: Boot) -> None:
    source = """
        NAKED reset(void)
        {
            __asm volatile("ldr r1, =0x20002000\\nmovs r0, #5\\nstr r0, [r1]\\ncmp r0, #5\\n"
                "itt eq\\nstreq r0, [r1, #4]\\nmoveq r2, #9\\n.global behind\\nbehind: mov.w r3, #1\\n"
                "it ne\\nstrne r0, [r1, #4]\\nb .");
        }
        VECTORS();
    """
    engine = boot(source)
    engine.set_watchpoints(watched(RESULTS + 4))
    assert engine.run(10_000) is Outcome.WATCHPOINT
    assert engine.load(RESULTS + 4, 4) == 5
    assert (engine.register(2), engine.register(3)) == (9, 0xA5A5A5A5)
    assert engine.run(10_000) is Outcome.REACHED, "the second one is skipped"


def test_nothing_is_watched_when_dma_or_the_debugger_writes(boot: Boot) -> None:
    engine = boot("HANDLER reset(void) { REST(); } VECTORS();")
    engine.set_watchpoints(watched())
    engine.store(RESULTS, 4, 1)
    engine.set_memory(RESULTS, b"\1")
    assert engine.run(10_000) is Outcome.REACHED


def test_more_watchpoints_than_there_are_raise(boot: Boot) -> None:
    engine = boot(LOOPING)
    with pytest.raises(ValueError, match="33 watchpoints, at most 32"):
        engine.set_watchpoints(watched() * 33)
