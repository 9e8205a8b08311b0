"""SysTick, the cycle counter and sleep: when things happen, to the cycle."""

from __future__ import annotations

from fractions import Fraction

import pytest

from neuroflight.sim.board.core.engine import Watchpoint
from neuroflight.sim.board.debug.profile import execution_counts
from tests.sim.board.programs import Boot, attach, ran, results

TICKING = """
HANDLER tick(void) { RESULT[0]++; RESULT[1] = REG(0xE000E010); }
HANDLER reset(void)
{
    RESULT[0] = 0;
    REG(0xE000E014) = 9999;
    REG(0xE000E018) = 0;
    REG(0xE000E010) = SOURCE;
    REST();
}
VECTORS([15] = tick);
"""


@pytest.mark.parametrize(("source", "period"), [("7", 10_000), ("3", 80_000)])
def test_ticks_keep_their_period_when_the_core_sleeps(boot: Boot, source: str, period: int) -> None:
    engine = boot(TICKING.replace("SOURCE", source))
    engine.core_clock(216_000_000)
    engine.run_to(100 * period + period // 2)
    assert results(engine, 2) == [100, 0x10007 if source == "7" else 0x10003]


def test_ticks_follow_the_core_when_its_clock_is_slow(boot: Boot) -> None:
    engine = boot(TICKING.replace("SOURCE", "7"))  # 16 MHz after reset: 13.5 cycles of time each
    engine.run_to(100 * 135_000 + 60_000)
    assert results(engine, 1) == [100]


def test_ticks_count_without_an_interrupt_when_none_is_asked_for(boot: Boot) -> None:
    source = """
    HANDLER reset(void) { REG(0xE000E014) = 999; REG(0xE000E018) = 0; REG(0xE000E010) = 5;
        RESULT[0] = REG(0xE000E018); while (!(REG(0xE000E010) & 1u << 16)) ; RESULT[1] = REG(0xE000E010);
        RESULT[2] = REG(0xE000E018); REST(); }
    VECTORS();
    """
    engine = boot(source, cpi=1)
    engine.run_to(100_000)
    found = results(engine, 3)
    assert 900 < found[0] < 1000
    assert found[1] == 5
    assert 950 < found[2] < 1000


COUNTING = """
HANDLER reset(void)
{
    REG(0xE000EDFC) |= 1u << 24;
    UNLOCK
    REG(0xE0001004) = 100;
    REG(0xE0001000) |= 1;
    __asm volatile("ldr r0, =0xE0001004\\n ldr r1, =0x20002000\\n ldr r2, [r0]\\n"
        "nop\\n nop\\n nop\\n nop\\n nop\\n ldr r3, [r0]\\n strd r2, r3, [r1]"
        ::: "r0", "r1", "r2", "r3", "memory");
    REST();
}
VECTORS();
"""


def test_the_cycle_counter_counts_when_its_lock_is_open(boot: Boot) -> None:
    engine = boot(COUNTING.replace("UNLOCK", "REG(0xE0001FB0) = 0xC5ACCE55;"), cpi=3)
    engine.run()
    first, second = results(engine, 2)
    assert 100 < first < 150
    assert second - first == 6 * 3  # five instructions and the first read


def test_the_cycle_counter_stands_when_its_lock_is_closed(boot: Boot) -> None:
    assert ran(boot(COUNTING.replace("UNLOCK", "")), 2) == [0, 0]


def test_time_is_exact_when_instructions_cost_a_fraction(boot: Boot) -> None:
    engine = boot('HANDLER reset(void) { for (;;) __asm volatile("nop"); } VECTORS();', cpi=Fraction(13, 8))
    engine.core_clock(216_000_000)
    engine.run(instructions=1_000_001)
    assert engine.cycle == 1_000_001 * 13 // 8


def test_sleep_ends_at_the_alarm_when_it_raises_an_interrupt(boot: Boot) -> None:
    source = """
    HANDLER handler(void) { REG(DEVICE) = 0; }
    HANDLER reset(void) { ENABLE(0); REST(); }
    VECTORS([16] = handler);
    """
    engine = boot(source, cpi=1)
    engine.core_clock(216_000_000)
    device = attach(engine)
    alarm = engine.alarm("edge", lambda: engine.irq(0, True))
    alarm.set(123_456)
    engine.run()
    assert 123_456 + 12 <= device.times[0] <= 123_456 + 12 + 4  # entry, and the address in a register


def test_it_is_stopped_at_the_same_place_when_run_twice(boot: Boot) -> None:
    engines = [boot(TICKING.replace("SOURCE", "7"), cpi=Fraction(163, 100)) for _ in range(2)]
    for engine in engines:
        engine.run_to(5_000_000)
    assert engines[0].trace_hash == engines[1].trace_hash
    assert engines[0].instructions == engines[1].instructions
    other = boot(TICKING.replace("SOURCE", "7").replace("9999", "9998"), cpi=Fraction(163, 100))
    other.run_to(5_000_000)
    assert other.trace_hash != engines[0].trace_hash


WAITING = """
NAKED tick(void) /* what was interrupted: the counter, and the flags that its last subtraction left */
{
    __asm volatile("ldr r0, =0x20002000\\n ldr r1, [r0]\\n ldr r3, [sp, #8]\\n ldr r12, [sp, #28]\\n"
        "add r1, r1, r3\\n eor r1, r12, r1, ror #7\\n str r1, [r0]\\n"
        "ldr r1, [r0, #4]\\n add r1, #1\\n str r1, [r0, #4]\\n bx lr");
}
NAKED reset(void)
{
    RESULT[0] = RESULT[1] = 0;
    REG(0xE000E014) = 996;
    REG(0xE000E018) = 0;
    REG(0xE000E010) = 7;
    __asm volatile("1: ldr r2, =TURNS\\n 2: subs r2, #1\\n bne 2b\\n b 1b");
}
VECTORS([15] = tick);
"""


@pytest.mark.parametrize("turns", [1, 2, 100, 30_000, 0])
def test_a_wait_that_counts_down_is_counted_to_the_same_run(boot: Boot, turns: int) -> None:
    """Under a watchpoint, even one where nothing is, every turn is executed."""
    skipping, executing = (boot(WAITING.replace("TURNS", str(turns))) for _ in range(2))
    executing.set_watchpoints([Watchpoint(0x20002100, 4, loads=True, stores=True)])
    for engine in (skipping, executing):
        engine.run_to(100_007)
        engine.run(instructions=1001)
        engine.run_to(2_000_003)
    for name in ("cycle", "instructions", "trace_hash", "pc"):
        assert getattr(skipping, name) == getattr(executing, name), name
    assert [skipping.register(n) for n in range(17)] == [executing.register(n) for n in range(17)]
    assert skipping.memory(0x20000000, 0x3000) == executing.memory(0x20000000, 0x3000)
    assert results(skipping, 2)[1] > 100
    assert execution_counts(skipping) == execution_counts(executing)
