"""Entry, return, nesting, masks, tail-chaining and faults (ARMv7-M DDI 0403E B1.5)."""

from __future__ import annotations

import pytest

from neuroflight.sim.board.core.context import BoardError
from neuroflight.sim.board.core.engine import Engine, Outcome
from neuroflight.sim.board.debug.profile import task_counts
from tests.sim.board.programs import Boot, attach, ran, results

# Every register holds a value of its own when the interrupt comes, and the handler destroys what it may.
PRESERVING = """
NAKED reset(void)
{
    __asm volatile(
        "ldr r0, =0xE000ED88\\n ldr r1, =0x00F00000\\n str r1, [r0]\\n dsb\\n isb\\n"
        "ldr r0, =0xE000E100\\n movs r1, #1\\n str r1, [r0]\\n"
        "SETUP"
        "ldr r0, =0xE000E200\\n"
        "mov r1, #1\\n mov r2, #12\\n mov r3, #13\\n mov r4, #14\\n"
        "mov r5, #15\\n mov r6, #16\\n mov r7, #17\\n"
        "mov r8, #18\\n mov r9, #19\\n mov r10, #20\\n mov r11, #21\\n mov r12, #22\\n mov lr, #23\\n"
        "cmp r1, #2\\n"
        "str r1, [r0]\\n"
        "nop\\n"
        "push {r0}\\n mrs r0, xpsr\\n push {r0}\\n ldr r0, =0x20002000\\n"
        "stm r0!, {r1-r12, lr}\\n"
        "pop {r1}\\n str r1, [r0], #4\\n"
        "pop {r1}\\n str r1, [r0], #4\\n"
        "str sp, [r0], #4\\n"
        "READ"
        "2: wfi\\n b 2b\\n .ltorg\\n");
}
NAKED handler(void)
{
    __asm volatile(
        "ldr r0, =0x20002100\\n str lr, [r0]\\n str sp, [r0, #4]\\n mrs r1, ipsr\\n str r1, [r0, #8]\\n"
        "mov r1, sp\\n add r0, #16\\n mov r2, #8\\n"
        "1: ldr r3, [r1], #4\\n str r3, [r0], #4\\n subs r2, #1\\n bne 1b\\n"
        "HANDLE"
        "mov r12, #0\\n"
        "bx lr\\n .ltorg\\n");
}
VECTORS([16] = handler);
"""
EXPECTED = [1, *range(12, 24)]


def preserving(setup: str = "", handle: str = "", read: str = "") -> str:
    return PRESERVING.replace("SETUP", setup).replace("HANDLE", handle).replace("READ", read)


def test_registers_and_flags_survive_when_an_interrupt_comes_between(boot: Boot) -> None:
    engine = boot(preserving())
    engine.run()
    found = results(engine, 16)
    assert found[:13] == EXPECTED
    assert found[13] & 0xF0000000 == 0x80000000  # N of cmp #1, #2
    assert (found[14], found[15]) == (0xE000E200, 0x20001000)
    lr, sp, ipsr = (engine.load(0x20002100 + 4 * i, 4) for i in range(3))
    assert (lr, sp, ipsr) == (0xFFFFFFF9, 0x20001000 - 0x20, 16)
    frame = [engine.load(0x20002110 + 4 * i, 4) for i in range(8)]
    assert frame[:6] == [0xE000E200, 1, 12, 13, 22, 23]
    assert frame[6] > engine.symbols["reset"] and frame[6] < engine.symbols["handler"]
    assert frame[7] & 0xF1000000 == 0x81000000


def test_the_frame_is_aligned_when_the_stack_is_not(boot: Boot) -> None:
    engine = boot(preserving(setup="sub sp, #4\\n"))
    assert ran(engine, 13) == EXPECTED
    assert engine.load(0x2000203C, 4) == 0x20000FFC
    assert engine.load(0x20002104, 4) == 0x20000FFC - 4 - 0x20
    assert engine.load(0x20002110 + 28, 4) & 1 << 9


def test_floats_survive_when_the_handler_computes_with_others(boot: Boot) -> None:
    load = "".join(f"vmov.f32 s{i}, #{1 + i / 16 if i < 16 else 2.0}\\n" for i in range(16))
    spoil = "".join(f"vmov.f32 s{i}, #3.0\\n" for i in range(16)) + "mov r1, #0\\n vmsr fpscr, r1\\n"
    setup = load + "ldr r1, =0x00400000\\n vmsr fpscr, r1\\n"
    engine = boot(preserving(setup, spoil, "vstm r0!, {s0-s15}\\n vmrs r1, fpscr\\n str r1, [r0]\\n"))
    assert ran(engine, 13) == EXPECTED
    floats = [engine.load(0x20002040 + 4 * i, 4) for i in range(17)]
    assert floats == [0x3F800000 + i * 0x80000 for i in range(16)] + [0x00400000]
    assert engine.load(0x20002100, 4) == 0xFFFFFFE9
    assert engine.load(0x20002104, 4) == 0x20001000 - 0x68


def test_the_handler_starts_without_floats_when_it_has_used_none(boot: Boot) -> None:
    engine = boot(preserving(setup="vmov.f32 s0, #1.0\\n", handle="mrs r1, control\\n str r1, [r0, #64]\\n"))
    engine.run()
    control = engine.load(0x20002110 + 32 + 64, 4)
    assert control & 4 == 0  # FPCA


NESTED = """
static volatile uint32_t n;
static void say(uint32_t what) { RESULT[n++] = what; }
HANDLER low(void)
{
    say(1);
    PEND(1);
    __asm volatile("dsb\\n isb");
    say(2);
    PEND(2);
    __asm volatile("dsb\\n isb");
    say(3);
}
HANDLER high(void) { say(10); }
HANDLER same(void) { say(20); }
HANDLER reset(void)
{
    n = 0;
    REG(0xE000ED0C) = 0x05FA0000 | REG(0x08007004) << 8;
    PRIORITY(0, 0x40);
    PRIORITY(1, REG(0x08007000));
    PRIORITY(2, 0x40);
    ENABLE(0);
    ENABLE(1);
    ENABLE(2);
    PEND(0);
    __asm volatile("dsb\\n isb");
    say(4);
    RESULT[15] = n;
    REST();
}
VECTORS([16] = low, high, same);
"""


@pytest.mark.parametrize(
    ("high", "split", "order"),
    [
        (0x30, 3, [1, 10, 2, 3, 20, 4]),
        (0x40, 3, [1, 2, 3, 10, 20, 4]),
        (0x50, 3, [1, 2, 3, 20, 10, 4]),
        # Two bits of group: priorities of one group do not interrupt each other, but the lower goes first.
        (0x00, 5, [1, 10, 2, 3, 20, 4]),
        (0x70, 5, [1, 2, 3, 20, 10, 4]),
        (0x30, 6, [1, 2, 3, 10, 20, 4]),
    ],
)
def test_handlers_interrupt_each_other_when_their_priority_says_so(
    boot: Boot, high: int, split: int, order: list[int]
) -> None:
    engine = boot(NESTED)
    engine.set_memory(0x08007000, b"".join(word.to_bytes(4, "little") for word in (high, split)))
    assert ran(engine, len(order)) == order


MASKED = """
HANDLER handler(void) { RESULT[1] = RESULT[0]; }
HANDLER reset(void)
{
    RESULT[0] = RESULT[1] = 0;
    PRIORITY(0, 0x40);
    ENABLE(0);
    MASK
    PEND(0);
    __asm volatile("dsb\\n isb");
    RESULT[0] = 1;
    UNMASK
    RESULT[0] = 2;
    REST();
}
VECTORS([16] = handler);
"""


@pytest.mark.parametrize(
    ("mask", "unmask", "seen"),
    [
        ("", "", 0),
        ("cpsid i", "cpsie i", 1),
        ("cpsid f", "cpsie f", 1),
        ("mov r0, #0x40\\n msr basepri, r0", "mov r0, #0\\n msr basepri, r0", 1),
        ("mov r0, #0x30\\n msr basepri, r0", "mov r0, #0x50\\n msr basepri, r0", 1),
        ("mov r0, #0x50\\n msr basepri, r0", "", 0),
        ("mov r0, #1\\n msr primask, r0", "mov r0, #0\\n msr primask, r0", 1),
    ],
)
def test_an_interrupt_waits_when_it_is_masked(boot: Boot, mask: str, unmask: str, seen: int) -> None:
    def assembly(text: str) -> str:
        return f'__asm volatile("{text}" ::: "r0", "memory");' if text else ""

    assert ran(boot(MASKED.replace("UNMASK", assembly(unmask)).replace("MASK", assembly(mask))), 2) == [
        2,
        seen,
    ]


def test_the_next_handler_follows_without_unstacking_when_one_waits(boot: Boot) -> None:
    source = """
    NAKED first(void) { __asm volatile("ldr r0, =0x20002000\\n str sp, [r0]\\n str lr, [r0, #4]\\n bx lr"); }
    NAKED second(void) {
        __asm volatile("ldr r0, =0x20002000\\n str sp, [r0, #8]\\n str lr, [r0, #12]\\n bx lr"); }
    HANDLER reset(void) { ENABLE(3); ENABLE(4); __asm volatile("cpsid i"); PEND(3); PEND(4);
        __asm volatile("cpsie i\\n isb"); RESULT[4] = 1; REST(); }
    VECTORS([19] = first, second);
    """
    engine = boot(source, cpi=1)
    engine.run()
    found = results(engine, 5)
    assert found[0] == found[2] and found[1] == found[3] == 0xFFFFFFF9 and found[4] == 1
    assert engine.load(0xE000ED04, 4) & 0x1FF == 0  # nothing active


def test_svc_finds_its_number_when_it_is_called(boot: Boot) -> None:
    source = """
    HANDLER serve(uint32_t *frame) { RESULT[0] = ((uint8_t *)frame[6])[-2]; frame[0] = 77; }
    NAKED svc(void) { __asm volatile("mov r0, sp\\n b serve"); }
    HANDLER reset(void) { register uint32_t r0 __asm("r0") = 1;
        __asm volatile("svc #42" : "+r"(r0) :: "memory");
        RESULT[1] = r0; REST(); }
    VECTORS([11] = svc);
    """
    assert ran(boot(source), 2) == [42, 77]


def test_pendsv_and_nmi_run_when_their_bits_are_set(boot: Boot) -> None:
    source = """
    HANDLER pendsv(void) { RESULT[0]++; }
    HANDLER nmi(void) { RESULT[1]++; RESULT[3] = RESULT[0]; }
    HANDLER reset(void) { for (int i = 0; i < 4; ++i) RESULT[i] = 0; __asm volatile("cpsid i");
        REG(0xE000ED04) = 1u << 28; REG(0xE000ED04) = 1u << 31; __asm volatile("dsb"); RESULT[2] = RESULT[1];
        __asm volatile("cpsie i\\n isb"); REST(); }
    VECTORS([2] = nmi, [14] = pendsv);
    """
    assert ran(boot(source), 4) == [1, 1, 1, 0]


def test_the_handler_runs_again_when_its_line_stays_high(boot: Boot) -> None:
    source = """
    HANDLER handler(void) { if (++RESULT[0] == 3) REG(DEVICE) = 0; }
    HANDLER reset(void) { RESULT[0] = 0; ENABLE(7); REG(DEVICE) = 1; REST(); }
    VECTORS([23] = handler);
    """
    engine = boot(source)
    attach(engine, irq=7)
    assert ran(engine, 1) == [3]


def test_wfi_ends_without_a_handler_when_interrupts_are_masked(boot: Boot) -> None:
    source = """
    HANDLER handler(void) { RESULT[1] = 1; }
    HANDLER reset(void) { RESULT[0] = RESULT[1] = 0; ENABLE(1); __asm volatile("cpsid i\\n wfi" ::: "memory");
        RESULT[0] = 1 + RESULT[1]; __asm volatile("cpsie i\\n isb" ::: "memory"); REST(); }
    VECTORS([17] = handler);
    """
    engine = boot(source)
    alarm = engine.alarm("wake", lambda: engine.irq(1, True))
    stop = engine.alarm("stop", lambda: engine.irq(1, False))
    alarm.set(1_000_000)
    stop.set(1_000_001)
    assert ran(engine, 2) == [1, 1]
    assert engine.cycle > 1_000_000


def test_vectors_in_ram_serve_when_vtor_points_there(boot: Boot) -> None:
    source = """
    HANDLER other(void) { RESULT[0] = 2; }
    HANDLER handler(void) { RESULT[0] = 1; }
    HANDLER reset(void) { uint32_t *table = (uint32_t *)0x20004000;
        for (int i = 0; i < 120; ++i) table[i] = 0;
        table[16] = (uint32_t)other; REG(0xE000ED08) = 0x20004000; __asm volatile("dsb"); ENABLE(0); PEND(0);
        __asm volatile("dsb\\n isb"); REST(); }
    VECTORS([16] = handler);
    """
    assert ran(boot(source), 1) == [2]


FAULTING = """
HANDLER fault(void)
{
    RESULT[1] = REG(0xE000ED28);
    RESULT[2] = REG(0xE000ED2C);
    RESULT[3] = REG(0xE000ED34);
    RESULT[4] = REG(0xE000ED38);
    uint32_t ipsr;
    __asm volatile("mrs %0, ipsr" : "=r"(ipsr));
    RESULT[0] = ipsr;
    REST();
}
HANDLER reset(void)
{
    REG(0xE000ED24) = REG(0x08007004);
    REG(0xE000ED14) |= 1u << 3 | 1u << 4;
    REG(0xE000ED98) = 0; REG(0xE000ED9C) = 0; REG(0xE000EDA0) = 1u << 28 | 7u << 1 | 1u; REG(0xE000ED94) = 5;
    __asm volatile("dsb\\n isb");
    volatile uint32_t zero = 0, one = 1;
    (void)zero; (void)one;
    switch (REG(0x08007000)) {
    ACTS
    }
    REST();
}
VECTORS([3] = fault, fault, fault, fault);
"""
ALL = 7 << 16
FAULTS = (
    ('__asm volatile("udf #0");', ALL, 6, 1 << 16, 0, None),
    ("RESULT[9] = one / zero;", ALL, 6, 1 << 25, 0, None),
    ("RESULT[9] = REG(0x20004001 + zero);", ALL, 6, 1 << 24, 0, None),
    ("RESULT[9] = REG(0x90000000 + zero);", ALL, 5, 1 << 9 | 1 << 15, 0, 0x90000000),
    ("REG(0x30000000 + zero) = 1;", ALL, 5, 1 << 9 | 1 << 15, 0, 0x30000000),
    ("RESULT[9] = REG(0x10 + zero);", ALL, 4, 1 << 1 | 1 << 7, 0, 0x10),
    ("((void (*)(void))(0x20004001 + zero))();", ALL, 4, 1, 0, None),
    ("((void (*)(void))(0x60000001 + zero))();", ALL, 5, 1 << 8, 0, None),
    ('__asm volatile("udf #0");', 0, 3, 1 << 16, 1 << 30, None),
    ('__asm volatile("cpsid i\\n udf #0");', ALL, 3, 1 << 16, 1 << 30, None),
    ('__asm volatile("cpsid i\\n svc #0");', ALL, 3, 0, 1 << 30, None),
)


@pytest.mark.parametrize("which", range(len(FAULTS)))
def test_faults_reach_their_handler_when_the_core_is_not_strict(boot: Boot, which: int) -> None:
    _, enables, number, cfsr, hfsr, address = FAULTS[which]
    cases = [f"case {i}: {{ {fault[0]} }} break;" for i, fault in enumerate(FAULTS)]
    engine = boot(FAULTING.replace("ACTS", "\n".join(cases)), strict=False)
    words = (which, enables)
    engine.set_memory(0x08007000, b"".join(word.to_bytes(4, "little") for word in words))
    assert engine.run() is Outcome.ASLEEP
    found = results(engine, 5)
    assert found[:3] == [number, cfsr, hfsr]
    if address is not None:
        assert found[3 if number == 4 else 4] == address


def test_the_core_locks_up_when_a_fault_handler_faults(boot: Boot) -> None:
    source = """
    HANDLER fault(void) { __asm volatile("udf #1"); }
    HANDLER reset(void) { __asm volatile("udf #0"); REST(); }
    VECTORS([3] = fault);
    """
    with pytest.raises(BoardError, match=r"lockup.*undefined instruction; pc .* in fault"):
        boot(source, strict=False).run()


LATE = """
HANDLER handler(void) { }
__attribute__((noinline)) void masked(void) { __asm volatile("cpsid i");
    for (int i = 0; i < 100; ++i) __asm volatile("nop"); __asm volatile("cpsie i\\n isb"); }
HANDLER reset(void) { ENABLE(5); masked(); REST(); }
VECTORS([21] = handler);
"""


def late(boot: Boot) -> Engine:
    """A program that masks the interrupt which comes just then."""
    engine = boot(LATE, cpi=1)
    engine.core_clock(216_000_000)

    def on_pulse() -> None:
        engine.irq(5, True)
        engine.irq(5, False)

    engine.alarm("pulse", on_pulse).set(50)
    return engine


def test_the_longest_wait_is_known_when_interrupts_were_masked(boot: Boot) -> None:
    engine = late(boot)
    engine.run()
    (task,) = [t for t in task_counts(engine) if t.exception == 21]
    assert (task.name, task.handler, task.activations) == ("IRQ5", "handler", 1)
    assert 200 < task.latest < 500
    assert "in masked" in task.latest_place


def test_a_wait_is_an_error_when_it_exceeds_its_bound(boot: Boot) -> None:
    engine = late(boot)
    engine.bound_entry(5, 500)
    engine.run()
    engine = late(boot)
    engine.bound_entry(5, 200)
    with pytest.raises(
        BoardError, match=r"interrupt 5 waited 1\.\d\d us .*0\.93 us .*were masked; .*in masked"
    ):
        engine.run()


def test_the_handler_is_named_when_a_bounded_interrupt_waits_for_it(boot: Boot) -> None:
    source = """
    HANDLER handler(void) { }
    HANDLER other(void) { for (int i = 0; i < 100; ++i) __asm volatile("nop"); }
    HANDLER reset(void) { ENABLE(5); ENABLE(6); PEND(6); __asm volatile("dsb\\n isb"); REST(); }
    VECTORS([21] = handler, [22] = other);
    """
    engine = boot(source, cpi=1)
    engine.core_clock(216_000_000)
    engine.alarm("rise", lambda: engine.irq(5, True)).set(100)
    engine.alarm("fall", lambda: engine.irq(5, False)).set(101)
    engine.bound_entry(5, 100, "the button")
    with pytest.raises(
        BoardError, match=r"the button waited .*: the handler of exception 22 ran; .*in other"
    ):
        engine.run()


def erasing(boot: Boot, where: str) -> Engine:
    """A program that masks an interrupt in `where` while flash is busy for 1000 cycles."""
    source = """
    HANDLER handler(void) { }
    extern uint32_t itcm_load[], itcm_start[], itcm_end[];
    #define MASKED { __asm volatile("cpsid i"); \
        for (int i = 0; i < 300; ++i) __asm volatile("nop"); __asm volatile("cpsie i\\n isb"); }
    __attribute__((section(".itcm"), noinline, used)) void in_itcm(void) MASKED
    __attribute__((noinline, used)) void in_flash(void) MASKED
    HANDLER reset(void) { ENABLE(5);
        for (uint32_t i = 0; itcm_start + i < itcm_end; ++i) itcm_start[i] = itcm_load[i];
        ((void (*volatile)(void))WHERE)(); REST(); }
    VECTORS([21] = handler);
    """
    engine = boot(source.replace("WHERE", where), cpi=1)
    engine.core_clock(216_000_000)
    engine.bound_entry(5, 100, "the button")

    def begin() -> None:
        assert where in engine.place()
        engine.flash_busy(engine.cycle + 1000)
        engine.irq(5, True)
        engine.irq(5, False)

    engine.alarm("begin", begin).set(400)
    return engine


def test_a_bounded_interrupt_may_wait_when_code_in_itcm_erases_flash(boot: Boot) -> None:
    engine = erasing(boot, "in_itcm")
    engine.run()
    (task,) = [t for t in task_counts(engine) if t.exception == 21]
    assert task.activations == 1
    assert task.latest > 100


def test_a_bounded_interrupt_may_not_wait_when_code_in_flash_erases_it(boot: Boot) -> None:
    engine = erasing(boot, "in_flash")
    with pytest.raises(
        BoardError, match=r"the button waited .*: the core waited for busy flash; .*in in_flash"
    ):
        engine.run()


def test_control_reads_as_the_chip_shows_it_when_floats_were_used(boot: Boot) -> None:
    source = """
    HANDLER handler(void) { uint32_t c; __asm volatile("mrs %0, control" : "=r"(c)); RESULT[2] = c; }
    HANDLER reset(void) { FPU_ON(); uint32_t c;
        __asm volatile("mrs %0, control" : "=r"(c)); RESULT[0] = c;
        __asm volatile("mov r0, #0\\n vmov s0, r0\\n mrs %0, control" : "=r"(c) :: "r0"); RESULT[1] = c;
        ENABLE(0); PEND(0); __asm volatile("dsb\\n isb");
        REST(); }
    VECTORS([16] = handler);
    """
    assert ran(boot(source), 3) == [0, 4, 0]


def test_the_process_stack_is_kept_when_interrupts_use_the_main_one(boot: Boot) -> None:
    source = """
    NAKED handler(void) { __asm volatile("ldr r0, =0x20002000\\n str sp, [r0]\\n str lr, [r0, #4]\\n"
        "mrs r1, psp\\n str r1, [r0, #8]\\n bx lr"); }
    NAKED reset(void) { __asm volatile("ldr r0, =0x20005000\\n msr psp, r0\\n"
        "mov r0, #2\\n msr control, r0\\n isb\\n"
        "ldr r0, =0xE000E100\\n mov r1, #1\\n str r1, [r0]\\n"
        "ldr r0, =0xE000E200\\n str r1, [r0]\\n nop\\n"
        "ldr r0, =0x20002000\\n str sp, [r0, #12]\\n mrs r1, control\\n str r1, [r0, #16]\\n"
        "2: wfi\\n b 2b"); }
    VECTORS([16] = handler);
    """
    assert ran(boot(source), 5) == [0x20001000, 0xFFFFFFFD, 0x20005000 - 0x20, 0x20005000, 2]


def test_the_core_sleeps_on_when_a_handler_ends_and_it_was_told_to(boot: Boot) -> None:
    source = """
    HANDLER handler(void) { if (++RESULT[0] == 3) REG(0xE000ED10) = 0; }
    HANDLER reset(void) { RESULT[0] = RESULT[1] = 0; REG(0xE000ED10) = 2;
        REG(0xE000E014) = 999; REG(0xE000E018) = 0; REG(0xE000E010) = 7;
        __asm volatile("dsb\\n wfi" ::: "memory"); RESULT[1] = RESULT[0]; REST(); }
    VECTORS([15] = handler);
    """
    engine = boot(source)
    engine.run_to(1_000_000)
    assert results(engine, 2)[1] == 3


def test_wfe_and_yield_go_on_when_nothing_waits(boot: Boot) -> None:
    source = """
    HANDLER reset(void) { RESULT[0] = 0;
        __asm volatile("sev\\n wfe\\n yield\\n wfe" ::: "memory"); RESULT[0] = 1; REST(); }
    VECTORS();
    """
    engine = boot(source)
    assert engine.run() is Outcome.ASLEEP
    assert results(engine, 1) == [1]


LOW_AND_HIGH = """
    static volatile uint32_t n;
    HANDLER low(void) { RESULT[n++] = 1; }
    HANDLER high(void) { RESULT[n++] = 2; }
    HANDLER reset(void) { n = 0; PRIORITY(8, 0x80); PRIORITY(9, 0x10); ENABLE(8); ENABLE(9); REST(); }
    VECTORS([24] = low, high);
    """


def test_the_higher_handler_goes_first_when_both_come_at_once(boot: Boot) -> None:
    engine = boot(LOW_AND_HIGH)

    def both() -> None:
        engine.irq(8, True)
        engine.irq(9, True)
        engine.irq(8, False)
        engine.irq(9, False)

    engine.alarm("both", both).set(100_000)
    assert ran(engine, 2) == [2, 1]


def test_a_higher_request_interrupts_when_it_arrives_during_entry(boot: Boot) -> None:
    engine = boot(LOW_AND_HIGH)
    engine.core_clock(216_000_000)

    def pulse(irq: int) -> None:
        engine.irq(irq, True)
        engine.irq(irq, False)

    engine.alarm("low", lambda: pulse(8)).set(100_000)
    engine.alarm("high", lambda: pulse(9)).set(100_006)  # entry takes 12
    assert ran(engine, 2) == [2, 1]


def test_a_handler_is_named_when_it_never_clears_its_request(boot: Boot) -> None:
    source = """
    HANDLER handler(void) { ++RESULT[0]; }
    HANDLER reset(void) { RESULT[0] = 0; ENABLE(5); REST(); }
    VECTORS([21] = handler);
    """
    engine = boot(source)
    engine.irq(5, True)
    with pytest.raises(
        BoardError, match=r"handler of exception 21 has run 1000 times .* its request up; .*in handler"
    ):
        engine.run()
    engine = boot(source)
    engine.alarm("fall", lambda: engine.irq(5, False)).set(50_000)
    engine.irq(5, True)
    engine.run()
    assert 100 < engine.load(0x20002000, 4) < 1000
