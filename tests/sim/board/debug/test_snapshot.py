"""A board put back to an earlier state goes on as it did."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

import pytest

from neuroflight.sim.board.core.context import BoardError
from neuroflight.sim.board.core.engine import Engine
from neuroflight.sim.board.debug.profile import execution_counts, task_counts
from neuroflight.sim.board.debug.snapshot import restore_snapshot, take_snapshot
from tests.sim.board.programs import Boot, attach

Make = Callable[[], tuple[Engine, Any]]

# Interrupts of two kinds, floats in both, a generator of numbers that nothing else could make the same.
BUSY = """
__attribute__((section(".itcm"), noinline, used)) float in_itcm(float x) { return x * 1.0625f + 0.5f; }
extern const uint32_t itcm_load[];
extern uint32_t itcm_start[], itcm_end[];
HANDLER tick(void) { RESULT[1] = RESULT[1] * 1664525u + 1013904223u; REG(DEVICE + 8) = RESULT[1]; }
HANDLER edge(void)
{
    float x = in_itcm((float)(RESULT[2] & 0xFFFF));
    RESULT[2] = RESULT[2] * 22695477u + (uint32_t)x + REG(DEVICE + 4);
    REG(DEVICE) = 0;
}
HANDLER reset(void)
{
    FPU_ON();
    const uint32_t *from = itcm_load;
    for (uint32_t *to = itcm_start; to != itcm_end; ++to)
        *to = *from++;
    RESULT[0] = RESULT[1] = RESULT[2] = 1;
    REG(0xE000E014) = 7777; REG(0xE000E018) = 0; REG(0xE000E010) = 7;
    PRIORITY(0, 0x40);
    REG(0xE000ED20) = 0x80u << 24;
    ENABLE(0);
    float y = 1.0f;
    for (;;) {
        y = y * 1.5f + (float)RESULT[0];
        RESULT[0] = RESULT[0] * 69069u + (y > 1e6f ? 1u : 3u);
        if (y > 1e6f)
            y = 0.25f;
        if (RESULT[0] >> 28 == 3)
            __asm volatile("wfi");
    }
}
VECTORS([15] = tick, [16] = edge);
"""


@pytest.fixture
def make(boot: Boot) -> Make:
    """A busy board whose device raises an interrupt every 3001 cycles."""

    def one() -> tuple[Engine, Any]:
        engine = boot(BUSY)
        device = attach(engine)

        def ring() -> None:
            device.value += 1
            engine.irq(0, True)
            edge.set(engine.cycle + 3001)

        edge = engine.alarm("edge", ring)
        edge.set(50_000)
        return engine, device

    return one


def facts(engine: Engine, device: Any) -> tuple[object, ...]:
    return (
        *(engine.cycle, engine.instructions, engine.trace_hash, engine.memory(0x20002000, 12)),
        *(engine.pc, tuple(device.log), task_counts(engine), execution_counts(engine)),
        tuple(engine.register(i) for i in range(17)),
    )


@pytest.mark.parametrize("cycle", [1, 49_999, 123_457, 400_001])
def test_it_goes_on_identically_when_restored(make: Make, cycle: int) -> None:
    engine, device = make()
    engine.run_to(cycle)
    snapshot = take_snapshot(engine)
    engine.run_to(900_000)
    first = facts(engine, device)
    restore_snapshot(engine, snapshot)
    assert engine.cycle < 900_000
    engine.run_to(900_000)
    assert facts(engine, device) == first


def test_it_goes_on_identically_when_restored_into_another_board(make: Make) -> None:
    engine, device = make()
    engine.run_to(300_000)
    snapshot = take_snapshot(engine)
    other, other_device = make()
    restore_snapshot(other, snapshot)
    for each in (engine, other):
        each.run_to(900_000)
    assert facts(engine, device) == facts(other, other_device)


@pytest.mark.parametrize("seed", range(3))
def test_it_is_the_same_run_when_cut_anywhere(make: Make, seed: int) -> None:
    check_cuts(make, seed, cycle=120_000, longest=40)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(20))
def test_it_is_the_same_run_when_cut_anywhere_for_long(make: Make, seed: int) -> None:
    check_cuts(make, seed, cycle=3_000_000, longest=3 ** (1 + seed % 7))


def check_cuts(make: Make, seed: int, *, cycle: int, longest: int) -> None:
    """Run by a few instructions at a time, now and then by a few cycles: nothing may differ."""
    rng = random.Random(seed)
    whole, whole_device = make()
    whole.run_to(cycle)
    cut, cut_device = make()
    while cut.cycle < cycle:
        if rng.random() < 0.2:
            cut.run_to(min(cycle, cut.cycle + rng.randrange(1, longest)))
        else:
            cut.run(cycle, instructions=rng.randrange(1, longest))
    assert facts(cut, cut_device) == facts(whole, whole_device)


def test_taking_one_changes_nothing_when_the_board_runs_on(make: Make) -> None:
    plain, plain_device = make()
    plain.run_to(900_000)
    looked, device = make()
    for cycle in (100_000, 300_000, 333_333):
        looked.run_to(cycle)
        take_snapshot(looked)
    looked.run_to(900_000)
    assert facts(looked, device) == facts(plain, plain_device)


def test_a_failed_board_lives_again_when_restored(make: Make) -> None:
    engine, device = make()
    engine.run_to(100_000)
    snapshot = take_snapshot(engine)
    engine._reads[0] = lambda offset, size: engine.fail("broken")
    with pytest.raises(BoardError, match="broken"):
        engine.run_to(200_000)
    engine._reads[0] = device.read
    restore_snapshot(engine, snapshot)
    engine.run_to(200_000)
    assert engine.cycle >= 200_000


def test_it_is_refused_when_the_board_has_other_peripherals(make: Make, boot: Boot) -> None:
    engine, _ = make()
    with pytest.raises(BoardError, match="other peripherals"):
        restore_snapshot(boot(BUSY), take_snapshot(engine))
