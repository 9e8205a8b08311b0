"""What was executed: by exception, by function, by address, by who called whom."""

from __future__ import annotations

import pytest

from neuroflight.sim.board.core.engine import Engine
from neuroflight.sim.board.debug.profile import (
    coverage,
    execution_counts,
    folded_stacks,
    function_counts,
    profile_table,
    task_counts,
)
from neuroflight.toolchain.cortex_m7.disassembly import disassemble
from neuroflight.toolchain.errors import BuildError
from tests.sim.board.programs import Boot

CALLING = """
NAKED leaf(void) { __asm volatile("nop\\n nop\\n nop\\n bx lr"); }
NAKED twice(void) { __asm volatile("push {r4, lr}\\n bl leaf\\n bl leaf\\n pop {r4, pc}"); }
NAKED tail(void) { __asm volatile("nop\\n b leaf"); }
NAKED handler(void) { __asm volatile("push {r4, lr}\\n bl leaf\\n pop {r4, pc}"); }
NAKED never(void) { __asm volatile("nop\\n bx lr"); }
NAKED reset(void)
{
    __asm volatile(
        "ldr r0, =0xE000E100\\n movs r1, #1\\n str r1, [r0]\\n"
        "bl twice\\n bl tail\\n bl leaf\\n"
        "ldr r0, =0xE000E200\\n str r1, [r0]\\n nop\\n str r1, [r0]\\n nop\\n"
        "2: wfi\\n b 2b\\n .ltorg\\n");
}
VECTORS([16] = handler);
"""
LEAF, TWICE, TAIL, HANDLER, RESET = 4, 4, 2, 3, 12


def test_every_instruction_is_somebodys_when_functions_call(boot: Boot) -> None:
    engine = boot(CALLING)
    engine.run()
    found = {f.name: f for f in function_counts(engine)}
    assert {name: (f.instructions, f.calls, f.covered) for name, f in found.items()} == {
        "leaf": (6 * LEAF, 6, 4),
        "twice": (TWICE, 1, 4),
        "tail": (TAIL, 1, 2),
        "handler": (2 * HANDLER, 2, 3),
        "reset": (RESET, 1, RESET),
    }
    assert sum(f.instructions for f in found.values()) == engine.instructions
    assert "leaf" in list(profile_table(engine))[1]


def test_handlers_are_apart_from_the_thread_when_they_interrupt(boot: Boot) -> None:
    engine = boot(CALLING)
    engine.run()
    thread, task = task_counts(engine)
    one = HANDLER + LEAF
    assert (task.handler, task.activations, task.instructions) == ("handler", 2, 2 * one)
    assert (task.least, task.most) == (one, one)
    assert thread.instructions == engine.instructions - 2 * one


def test_stacks_say_who_called_when_a_profile_was_asked_for(boot: Boot) -> None:
    engine = boot(CALLING, profile=True)
    engine.run()
    assert dict(line.rsplit(" ", 1) for line in folded_stacks(engine)) == {
        "handler": str(2 * HANDLER),
        "handler;leaf": str(2 * LEAF),
        "reset": str(RESET),
        "reset;leaf": str(2 * LEAF),  # one called, one by tail's branch in its place
        "reset;tail": str(TAIL),
        "reset;twice": str(TWICE),
        "reset;twice;leaf": str(2 * LEAF),
    }


@pytest.mark.parametrize("period", [36, 37, 38, 39, 41])
def test_a_stack_is_kept_when_an_interrupt_falls_between_call_and_callee(boot: Boot, period: int) -> None:
    engine = boot(CALLING, profile=True, cpi=1)
    engine.core_clock(216_000_000)

    def ring() -> None:
        engine.irq(0, True)
        engine.irq(0, False)
        alarm.set(engine.cycle + period)

    alarm = engine.alarm("often", ring)
    alarm.set(1)
    engine.run(instructions=800)
    stacks = dict(line.rsplit(" ", 1) for line in folded_stacks(engine))
    for path in ("reset;leaf", "reset;twice;leaf"):
        assert int(stacks[path]) == 2 * LEAF
    assert set(stacks) == {
        *("handler", "handler;leaf", "reset", "reset;leaf", "reset;tail", "reset;twice", "reset;twice;leaf")
    }


def test_counts_lie_on_instructions_when_held_against_the_disassembly(boot: Boot) -> None:
    engine = boot(CALLING)
    engine.run()
    assert engine.places is not None
    code = disassemble(engine.places.path)
    executed = execution_counts(engine)
    assert set(executed) <= set(code)
    assert sum(executed.values()) == engine.instructions


def test_what_was_never_executed_is_named_when_asked_for(boot: Boot) -> None:
    engine = boot(CALLING)
    engine.run()
    found = {f.name: f for f in coverage(engine)}
    assert found["never"].share == 0 and len(found["never"].missed) == 2
    assert found["leaf"].share == 1
    assert len(found["reset"].missed) == 1  # the branch behind the last WFI
    assert found["reset"].missed[0] in range(engine.symbols["reset"], engine.symbols["reset"] + 80)


def test_one_line_says_so_when_there_is_nothing_to_name_functions_by(boot: Boot) -> None:
    with pytest.raises(BuildError, match="needs the image's ELF"):
        function_counts(Engine(bytes(64)))
    with pytest.raises(BuildError, match="made with profile"):
        folded_stacks(boot(CALLING))
