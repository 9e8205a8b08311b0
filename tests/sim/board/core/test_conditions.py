"""IT blocks of all shapes, and what runs right behind them (ARMv7-M DDI 0403E A7.3).

Each program holds every shape of an IT block, under a condition that holds and under one that does not.
The block's instructions read and write pages that nothing has touched before, so that unicorn has to ask for
each of them in the middle of the block. Behind it goes a jump, and where it leads stand instructions without
a condition.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count, product

import pytest

from neuroflight.sim.board.core.context import BoardError
from neuroflight.sim.board.core.engine import Outcome
from tests.sampling import sampled
from tests.sim.board.programs import DEVICE, RESULTS, Boot, attach, results

SHAPES = ("", *("".join(rest) for n in (1, 2, 3) for rest in product("te", repeat=n)))
PAGE, PAGES = 0x400, 0x20008000
UNTOUCHED = 0xA5A5A5A5  # what RAM holds at power-up
HANDLED = 0x20002FF0
MOST = 20_000  # instructions, by far
IT_BITS = 0x0600FC00  # of xPSR
ADDRESSES = (11, 1, 2, 3)  # registers, of the block's instructions in their order
MARKS = 6  # instructions where the jump leads: more than an IT block can cover
LANDED = sum(1 << 8 + i for i in range(MARKS))

# How it goes from behind the block to `landing`.
JUMPS = {
    "b": "b.w {landing}",
    "bl": "bl {landing}",
    "blx": "ldr r4, ={landing}\nblx r4",
    "bx": "ldr r4, ={landing}\nbx r4",
    "cbz": "mov r5, #0\ncbz r5, {landing}",
    "condition": "b{true}.w {landing}",
    "tail_call": "ldmia.w sp!, {{r4, lr}}\nb.w {landing}",
    "return": "ldmia.w sp!, {{r4, pc}}",
    "table": "mov r4, #0\ntbb [pc, r4]\n.byte 1, 0\nb.w {landing}",
    "block": "ite {true}\nadd{true}.w r6, r6, #64\nadd{false}.w r6, r6, #128\nb.w {landing}",
    "nothing": "",
}
# Jumps that are the block's last instruction themselves, executed or skipped.
LAST = {
    "b": "b{c}.w {landing}",
    "bl": "bl{c} {landing}",
    "bx": "bx{c} r8",
    "return": "ldmia{c}.w sp!, {{r4, pc}}",
    "load": "ldr{c}.w pc, [sp, #4]",
}
BEHIND = tuple(f"add.w r6, r6, #{1 << i}" for i in range(5))  # what runs when it is skipped

PROGRAM = """
NAKED reset(void)
{
    __asm volatile(
        "ldr r0, =0xE000E100\\n mov r1, #1\\n str r1, [r0]\\n ldr r7, =0x20002000\\n mov r10, sp\\n"
CASES
        "rest: wfi\\n b rest\\n .ltorg\\n");
}
NAKED handler(void)
{
    __asm volatile(
        "ldr r0, =0x40000000\\n mov r1, #0\\n cmp r1, #0\\n"
        "ittee eq\\n streq r1, [r0]\\n ldreq r2, =0x20002FF0\\n movne r1, #9\\n movne r2, #9\\n"
        "ldr r3, [r2]\\n add r3, #1\\n str r3, [r2]\\n cmp r3, #0\\n bx lr\\n .ltorg\\n");
}
VECTORS([16] = handler);
"""


@dataclass(frozen=True)
class Case:
    """One IT block with its jump."""

    text: str
    expected: tuple[int, ...]  # the registers of `ADDRESSES`, then the marks


def access(kind: int, condition: str, register: int) -> str:
    """An instruction that shows in its address register whether it was executed."""
    texts = (
        "ldr{c}.w {r}, [{r}]",
        "str{c}.w r6, [{r}, #4]!",
        "ldr{c}.w r5, [{r}], #8",
        "ldmia{c}.w {r}!, {{r4, r5, r9}}",
    )
    return texts[kind % 4].format(c=condition, r=f"r{register}")


def accessed(kind: int, address: int, loaded: int) -> int:
    """What the register holds then."""
    return (loaded, address + 4, address + 8, address + 12)[kind % 4]


def make_case(number: int, shape: str, holds: bool, jump: str, addresses: Iterator[int], loaded: int) -> Case:
    landing, last = f"landing_{number}", jump.partition("last_")[2]
    names = {"landing": landing, "true": "eq" if holds else "ne", "false": "ne" if holds else "eq"}
    conditions = ["eq" if slot == "t" else "ne" for slot in "t" + shape]
    lines = [f"mov r0, #{int(not holds)}", "mov r6, #0", f"ldr r8, ={landing}", "push {r8}", "push {r8}"]
    registers, marks, block = dict.fromkeys(ADDRESSES, 0), LANDED, []
    for i, (condition, register) in enumerate(zip(conditions, ADDRESSES, strict=False)):
        address = registers[register] = next(addresses)
        block.append(access(number + i, condition, register))
        if condition == names["true"] and not (last and i == len(shape)):
            registers[register] = accessed(number + i, address, loaded)
        lines.append(f"ldr r{register}, =0x{address:X}")
    lines += [f"mov r{register}, #0" for register in ADDRESSES[len(conditions) :]]
    # The block lies across the end of a page of code, each time at another place.
    lines += ["b.w 1f", ".ltorg", f".balign {PAGE}", f".space {PAGE - 2 * (number % 9 + 1)}", "1:"]
    if last:
        block[-1] = LAST[last].format(c=conditions[-1], landing=landing)
        marks += 0 if conditions[-1] == names["true"] else 31
        behind = [*BEHIND, f"b.w {landing}"]
    else:
        marks += 64 if jump == "block" else 0
        behind = JUMPS[jump].format(**names).splitlines()
    lines += ["cmp r0, #0", f"it{shape} eq", *block, *behind]
    lines += [] if jump == "nothing" else ["udf #0"]
    lines += [".thumb_func", f"{landing}:", *(f"add.w r6, r6, #{1 << 8 + i}" for i in range(MARKS))]
    lines += ["stmia.w r7!, {r1, r2, r3, r6, r11}", "mov sp, r10", "b.w 2f", ".ltorg", "2:"]
    text = "\n".join(f'"{line}\\n"' for line in lines)
    return Case(text, (*(registers[r] for r in (1, 2, 3)), marks, registers[11]))


def make_cases(jump: str, device: bool) -> list[Case]:
    fresh = count(PAGES, PAGE) if not device else iter(lambda: DEVICE + 0x10, None)
    shapes = enumerate(product(SHAPES, (True, False)))
    return [
        make_case(n, shape, holds, jump, fresh, 0 if device else UNTOUCHED) for n, (shape, holds) in shapes
    ]


class Run:
    """A program of all shapes with one kind of jump, on a fresh engine."""

    def __init__(self, boot: Boot, jump: str, device: bool = False) -> None:
        self.cases = make_cases(jump, device)
        self.engine = boot(PROGRAM.replace("CASES", "\n".join(case.text for case in self.cases)))
        self.device = attach(self.engine)
        self.engine.store(HANDLED, 4, 0)

    def interrupt(self, period: int) -> None:
        """From now on each `period` cycles, until the last case is done."""
        engine, end = self.engine, RESULTS + 20 * len(self.cases) - 4

        def ring() -> None:
            engine.irq(0, True)
            if engine.load(end, 4) == UNTOUCHED:
                alarm.set(engine.cycle + period)

        alarm = engine.alarm("interrupt", ring)
        alarm.set(engine.cycle + period)

    def run(self, budget: int, *, forget: bool = False) -> None:
        """To the end, `budget` instructions at a time. forget: all pages are asked for anew at each stop."""
        while self.engine.run(instructions=budget) is not Outcome.ASLEEP:
            assert self.engine.instructions < MOST, "it does not come to its end"
            assert self.engine.register(16) & IT_BITS == 0
            if forget:
                self.engine.set_memory(0x0807FFFC, b"\xff" * 4)

    def check(self) -> None:
        for number, case in enumerate(self.cases):
            found = tuple(self.engine.load(RESULTS + 20 * number + 4 * i, 4) for i in range(5))
            assert found == case.expected, f"case {number}:\n{case.text}"


EVERY = (*JUMPS, *(f"last_{jump}" for jump in LAST))


@pytest.mark.parametrize("jump", EVERY)
def test_what_is_behind_an_it_block_is_executed_whatever_its_shape(boot: Boot, jump: str) -> None:
    run = Run(boot, jump)
    run.run(MOST)
    run.check()


@pytest.mark.parametrize("jump", ["b", "tail_call", "block", "nothing", "last_return"])
def test_it_is_so_when_the_block_reads_and_writes_registers_of_a_peripheral(boot: Boot, jump: str) -> None:
    run = Run(boot, jump, device=True)
    run.run(MOST)
    run.check()
    assert len(run.device.log) > len(run.cases)


@pytest.mark.parametrize("jump", EVERY)
@pytest.mark.parametrize("budget", sampled([1, 2, 3, 5, 11], 1, 3))
def test_it_is_so_when_the_run_is_cut_and_all_pages_are_asked_for_anew(
    boot: Boot, jump: str, budget: int
) -> None:
    whole, cut = Run(boot, jump), Run(boot, jump)
    whole.run(MOST)
    cut.run(budget, forget=True)
    cut.check()
    engines = (whole.engine, cut.engine)
    assert len({(engine.instructions, engine.cycle, engine.trace_hash) for engine in engines}) == 1


@pytest.mark.parametrize("jump", EVERY)
@pytest.mark.parametrize("period", sampled([601, 677, 733], 733))
def test_it_is_so_when_interrupts_come_between(boot: Boot, jump: str, period: int) -> None:
    run = Run(boot, jump)
    run.interrupt(period)
    run.run(7, forget=period == 733)
    run.check()
    assert run.engine.load(HANDLED, 4) > len(run.cases)


FLASHING = """
NAKED reset(void)
{
    __asm volatile(
        "ldr r0, =0x08010000\\n ldr r1, =0x12345678\\n ldr r7, =0x20002000\\n mov r6, #0\\n"
        "TOUCH cmp r0, r0\\n"
        "itet eq\\n streq r1, [r0]\\n movne r6, #64\\n beq.w 1f\\n udf #0\\n"
        "1: add r6, #1\\n add r6, #2\\n add r6, #4\\n add r6, #8\\n add r6, #16\\n str r6, [r7]\\n"
        "ldr r6, [r0]\\n str r6, [r7, #4]\\n"
        "2: wfi\\n b 2b\\n .ltorg\\n");
}
VECTORS();
"""


@pytest.mark.parametrize("touched", [False, True])
def test_it_is_so_when_the_block_programs_flash(boot: Boot, touched: bool) -> None:
    engine = boot(FLASHING.replace("TOUCH", "ldr r2, [r0, #4]\\n str r2, [r0, #4]\\n" if touched else ""))
    engine.on_flash_store(lambda at, size, value: engine.set_memory(at, value.to_bytes(size, "little")))
    engine.run(instructions=MOST)
    assert results(engine, 2) == [31, 0x12345678]


FAULTY = """
NAKED reset(void)
{
    __asm volatile(
        "ldr r1, =0x20003001\\n ldr r7, =0x20002000\\n mov r6, #1\\n cmp r1, r1\\n"
        "FIRST faulty: SECOND\\n"
        "2: wfi\\n b 2b\\n .ltorg\\n");
}
NAKED fault(void)
{
    __asm volatile("ldr r0, [sp, #24]\\n ldr r1, =0x20002000\\n str r0, [r1]\\n 1: wfi\\n b 1b\\n .ltorg\\n");
}
VECTORS([3] = fault);
"""
FAULTS = (
    ("it eq\\n", "ldrdeq r2, r3, [r1]", "unaligned access at 0x20003001"),
    ("ite eq\\n", "ldrdeq r2, r3, [r1]\\n ldrne r4, [r7]", "unaligned access at 0x20003001"),
    ("itt eq\\n", "ldmiaeq r1!, {r2, r3}\\n ldreq r4, [r1, r6]", "unaligned access at 0x20003001"),
    ("ittt eq\\n", "ldrdeq r2, r3, [r1]\\n streq r6, [r7, #4]\\n beq.w 2f", "unaligned access at 0x20003001"),
    (
        "itttt eq\\n moveq r1, #0\\n",
        "ldreq r2, [r1]\\n ldreq r2, [r1]\\n beq.w 2f",
        "0x00000000, in the null page",
    ),
)


@pytest.mark.parametrize(("first", "second", "message"), FAULTS)
def test_a_fault_in_an_it_block_is_told_at_its_instruction(
    boot: Boot, first: str, second: str, message: str
) -> None:
    source = FAULTY.replace("FIRST", first).replace("SECOND", second)
    engine = boot(source)
    with pytest.raises(BoardError, match=message):
        engine.run(instructions=MOST)
    assert engine.pc == engine.symbols["faulty"]
    lenient = boot(source, strict=False)
    lenient.run(instructions=MOST)
    assert results(lenient, 1) == [lenient.symbols["faulty"]]
