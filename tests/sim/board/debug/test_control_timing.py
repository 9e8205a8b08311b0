"""The meter of control tasks on a program of known instructions, interrupted and chained as it can be."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from neuroflight.sim.board.board import Board
from neuroflight.sim.board.debug.control_timing import ControlMeter, Kind, Work, task_costs
from neuroflight.sim.board.debug.profile import task_counts
from neuroflight.toolchain.cortex_m7.cycles import DEVICE_CYCLES
from neuroflight.toolchain.cortex_m7.disassembly import disassemble
from neuroflight.toolchain.cortex_m7.llvm_mca import find_pricer
from neuroflight.toolchain.errors import BuildError

# Each second sample is a control step; step n asks the policy for n rounds of its loop, which then lets the
# edge interrupt it and leaves another handler to follow. Thread and policy call `shared`, where samples come.
# A step reads a register of a peripheral in Python (RCC_CR) and of one in C (GPIOA_MODER).
FLYING = """
struct { uint32_t control_steps, odd; struct { struct { uint8_t armed; } trace; } status; } firmware;
NAKED shared(void) { __asm volatile("str r1, [r2]\\n nop\\n bx lr"); }
NAKED policy_step(void)
{
    __asm volatile(
        "push {r4, lr}\\n 1: subs r0, #1\\n bne 1b\\n"
        "ldr r2, =0xE000E200\\n ldr r1, =0x100040\\n str r1, [r2]\\n dsb\\n"
        "movs r1, #0\\n bl shared\\n pop {r4, pc}\\n .ltorg");
}
NAKED pid_step(void) { __asm volatile("bx lr"); }
NAKED gyro_sample_handler(void)
{
    __asm volatile(
        "push {r4, lr}\\n ldr r4, =firmware\\n ldr r0, [r4, #4]\\n movs r1, #1\\n eors r0, r1\\n"
        "str r0, [r4, #4]\\n beq 1f\\n"
        "ldr r0, [r4]\\n adds r0, #1\\n str r0, [r4]\\n bl policy_step\\n"
        "ldr r1, =0x40023800\\n ldr r1, [r1]\\n ldr r1, =0x40020000\\n ldr r1, [r1]\\n"
        "1: pop {r4, pc}\\n .ltorg");
}
NAKED edge(void) { __asm volatile("nop\\n ldr r1, =0x40023800\\n ldr r1, [r1]\\n bx lr\\n .ltorg"); }
NAKED after(void) { __asm volatile("nop\\n bx lr"); }
HANDLER reset(void)
{
    firmware.control_steps = firmware.odd = 0;
    firmware.status.trace.armed = 0;
    REG(0x40023830) |= 1; (void)REG(0x40023830);
    PRIORITY(58, 0x20); PRIORITY(20, 0x20); PRIORITY(6, 0x10);
    ENABLE(58); ENABLE(20); ENABLE(6);
    for (int i = 0; i < 6; ++i) {
        firmware.status.trace.armed = i >= 2;
        register uint32_t bit __asm("r1") = 1u << 26, at __asm("r2") = 0xE000E204;
        __asm volatile("bl shared" :: "r"(bit), "r"(at) : "lr", "memory");
    }
    REST();
}
VECTORS([16 + 6] = edge, [16 + 20] = after, [16 + 58] = gyro_sample_handler);
"""
SHARED, EDGE, BETWEEN = 3, 4, 8
ROUND, POLICY, STEP = 2, 8 + SHARED, 8  # a round of its loop; without them; what a step has beside BETWEEN
STEPS, ACCESSES = 3, 2
CYCLES = 100_000

Flown = tuple[Board, ControlMeter, dict[int, Any]]


@pytest.fixture
def flown(compile_program: Callable[[str], Any]) -> Iterator[Flown]:
    program = compile_program(FLYING)
    code = disassemble(program.elf)
    board = Board(program.flash, elf=program.elf)
    meter = ControlMeter(board, program.elf, code)
    meter.run_to(CYCLES)
    yield board, meter, code
    board.close()


def counted(meter: ControlMeter, code: dict[int, Any]) -> dict[Kind, list[tuple[int, int, int]]]:
    """Instructions, accesses of devices and times, of every distinct run of each kind."""
    return {
        kind: sorted(
            (
                sum(times * in_run(start, size, code) for (start, size), times in run.route),
                run.accesses,
                run.times,
            )
            for run in runs
        )
        for kind, runs in meter.runs().items()
    }


def in_run(start: int, size: int, code: dict[int, Any]) -> int:
    return sum(start <= address < start + size for address in code)


def test_tasks_are_those_counted_by_hand_when_others_interrupt_and_follow(flown: Flown) -> None:
    _, meter, code = flown
    policy = [POLICY + ROUND * step for step in (1, 2, 3)]
    steps = [BETWEEN + STEP + taken for taken in policy]
    assert counted(meter, code) == {
        Kind(Work.ALGORITHM, True, "policy"): [(taken, 0, 1) for taken in policy],
        Kind(Work.TASK, False, "policy"): [(steps[0], ACCESSES, 1)],
        Kind(Work.TASK, True, "policy"): [(taken, ACCESSES, 1) for taken in steps[1:]],
        Kind(Work.SAMPLE, False, ""): [(BETWEEN, 0, 1)],
        Kind(Work.SAMPLE, True, ""): [(BETWEEN, 0, 2)],
    }
    assert (meter.interruptions, meter.interrupting) == (STEPS, STEPS * EDGE)


def test_sums_are_the_engines_own_when_all_runs_are_added(flown: Flown) -> None:
    board, meter, code = flown
    (task,) = (task for task in task_counts(board.engine) if task.handler == "gyro_sample_handler")
    handled = {kind: runs for kind, runs in counted(meter, code).items() if kind.work is not Work.ALGORITHM}
    assert sum(taken * times for runs in handled.values() for taken, _, times in runs) == task.instructions
    assert min(run[0] for runs in handled.values() for run in runs) == task.least
    assert max(run[0] for runs in handled.values() for run in runs) == task.most


def test_the_board_runs_the_same_when_there_is_no_meter(
    flown: Flown, compile_program: Callable[[str], Any]
) -> None:
    board, _, _ = flown
    program = compile_program(FLYING)
    plain = Board(program.flash, elf=program.elf)
    plain.run_to(CYCLES)
    assert plain.engine.trace_hash == board.engine.trace_hash
    assert plain.engine.instructions == board.engine.instructions
    plain.close()


def test_worst_and_best_are_the_kinds_when_runs_are_priced(flown: Flown) -> None:
    _, meter, code = flown
    costs, priced = task_costs(meter.runs(), code)
    found = {cost.kind: cost for cost in costs}
    task = found[Kind(Work.TASK, True, "policy")]
    step = BETWEEN + STEP + POLICY
    assert (task.times, task.routes, task.accesses) == (2, 2, (ACCESSES, ACCESSES))
    assert task.instructions == (step + 2 * ROUND, step + 3 * ROUND)
    if find_pricer() is None:
        assert task.cycles is None
        assert priced.no_cycles_reason
        assert task.variability == ROUND / task.instructions[1]
    else:
        algorithm = found[Kind(Work.ALGORITHM, True, "policy")]
        assert task.cycles is not None
        assert algorithm.cycles is not None
        assert task.variability == (task.cycles[1] - task.cycles[0]) / task.cycles[1]
        assert task.cycles[1] - algorithm.cycles[1] > ACCESSES * DEVICE_CYCLES


def test_it_says_what_is_missing_when_the_program_is_no_firmware(
    compile_program: Callable[[str], Any],
) -> None:
    program = compile_program(FLYING.replace("pid_step", "other_step"))
    board = Board(program.flash, elf=program.elf)
    with pytest.raises(BuildError, match="has no function pid_step"):
        ControlMeter(board, program.elf, disassemble(program.elf))
    board.close()


def test_it_refuses_another_images_listing_when_runs_are_asked_for(
    flown: Flown, compile_program: Callable[[str], Any]
) -> None:
    _, _, code = flown
    program = compile_program(FLYING)
    less = {address: found for address, found in code.items() if found.function != "policy_step"}
    board = Board(program.flash, elf=program.elf)
    meter = ControlMeter(board, program.elf, less)
    meter.run_to(CYCLES)
    with pytest.raises(BuildError, match="of them in the ELF file"):
        meter.runs()
    board.close()
