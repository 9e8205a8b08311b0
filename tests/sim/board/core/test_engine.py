"""The emulated core as a whole: start, counts, accesses of peripherals, alarms, resets, stores to flash."""

from __future__ import annotations

import pytest

from neuroflight.sim.board.core.context import BoardError
from neuroflight.sim.board.core.engine import Engine, Outcome
from neuroflight.sim.board.debug.profile import execution_counts
from tests.sim.board.programs import Boot, attach, ran, results

NOTHING = "HANDLER reset(void) { REST(); } VECTORS();"
# 12 instructions before WFI, of which two are skipped in their place.
COUNTED = """
NAKED reset(void)
{
    __asm volatile(
        "ldr r0, =0x20002000\\n movs r1, #0\\n movs r2, #3\\n"
        "1: adds r1, r1, #5\\n subs r2, r2, #1\\n bne 1b\\n"
        "cmp r1, #99\\n itt eq\\n moveq r1, #1\\n moveq r2, #1\\n"
        "str r1, [r0]\\n nop\\n 2: wfi\\n b 2b\\n");
}
VECTORS();
"""
COUNTED_INSTRUCTIONS = 3 + 3 * 3 + 6 + 1
TOUCHING = """
NAKED reset(void)
{
    __asm volatile(
        "ldr r0, =0x40000000\\n movs r1, #1\\n movs r2, #2\\n movs r3, #3\\n"
        "ldr r5, =0xE000E100\\n movs r4, #1\\n str r4, [r5]\\n"
        "stm r0, {r1, r2, r3}\\n"
        "strb r2, [r0, #7]\\n strh r3, [r0, #10]\\n"
        "ldrd r6, r7, [r0, #16]\\n"
        "2: wfi\\n b 2b\\n");
}
HANDLER handler(void) { REG(DEVICE) = 0; RESULT[0]++; }
VECTORS([16] = handler);
"""


def test_it_starts_through_the_alias_when_powered_up(boot: Boot) -> None:
    engine = boot(NOTHING)
    assert engine.pc == engine.symbols["reset"]
    assert engine.load(0xE000ED08, 4) == 0x00200000  # VTOR
    assert engine.register(13) == 0x20001000
    assert engine.memory(0x20002000, 4) == b"\xa5" * 4


def test_it_sleeps_for_good_when_nothing_can_wake_it(boot: Boot) -> None:
    engine = boot(NOTHING)
    assert engine.run() is Outcome.ASLEEP
    assert engine.sleeping


def test_skipped_instructions_count_when_their_condition_fails(boot: Boot) -> None:
    engine = boot(COUNTED)
    assert ran(engine, 1) == [15]
    assert engine.instructions == COUNTED_INSTRUCTIONS
    counts = execution_counts(engine)
    start = engine.symbols["reset"]
    assert sum(counts.values()) == COUNTED_INSTRUCTIONS
    assert [counts[start + offset] for offset in (0, 8, 10, 12, 14, 16, 18)] == [1, 3, 3, 3, 1, 1, 1]


@pytest.mark.parametrize("slice_length", [1, 2, 3, 7, 1000])
def test_it_is_the_same_run_when_cut_into_slices(boot: Boot, slice_length: int) -> None:
    whole, cut = boot(COUNTED), boot(COUNTED)
    whole.run()
    while cut.run(instructions=slice_length) is not Outcome.ASLEEP:
        pass
    assert (cut.instructions, cut.cycle, cut.trace_hash) == (
        whole.instructions,
        whole.cycle,
        whole.trace_hash,
    )
    assert execution_counts(cut) == execution_counts(whole)


def test_a_limit_is_exact_when_it_lies_inside_a_run(boot: Boot) -> None:
    engine = boot(COUNTED)
    for expected in range(1, 12):
        assert engine.run(instructions=1) is Outcome.LIMIT
        assert engine.instructions == expected


def test_each_access_happens_once_when_it_raises_an_interrupt(boot: Boot) -> None:
    engine = boot(TOUCHING)
    engine.set_memory(0x20002000, bytes(4))
    device = attach(engine)
    engine.run()
    assert device.log == [
        *(("w", 0, 4, 1), ("w", 4, 4, 2), ("w", 8, 4, 3)),  # the interrupt waits for the whole instruction
        ("w", 0, 4, 0),
        *(("w", 7, 1, 2), ("w", 10, 2, 3), ("r", 16, 4, 0), ("r", 20, 4, 0)),
    ]
    assert results(engine, 1) == [1]


def test_accesses_carry_their_exact_time_when_they_share_a_run(boot: Boot) -> None:
    source = """
    HANDLER reset(void) { REG(DEVICE + 4); REG(DEVICE + 4); __asm volatile("nop\\n nop"); REG(DEVICE + 4);
        REST(); }
    VECTORS();
    """
    engine = boot(source, cpi=2)
    device = attach(engine)
    engine.core_clock(108_000_000)
    engine.run()
    first, second, third = device.times
    assert second - first == 4  # one instruction of 2 cycles of 108 MHz
    assert third - second == 12


def test_a_place_is_refused_when_it_is_taken(boot: Boot) -> None:
    engine = boot(NOTHING)
    device = attach(engine)
    for base, size in ((0x40000000, 0x400), (0x40000200, 0x400), (0x20000000, 0x400), (0x4007FC00, 0x800)):
        with pytest.raises(ValueError, match="taken"):
            engine.attach(base, size, device, "OTHER")


def test_the_place_is_named_when_a_peripheral_fails(boot: Boot) -> None:
    engine = boot("HANDLER reset(void) {\n REG(DEVICE + 8) = 1;\n RESULT[0] = 1;\n REST(); }\nVECTORS();")
    device = attach(engine)
    device.write = lambda offset, size, value: engine.fail("no good")  # type: ignore[method-assign]
    engine.attach(0x40000400, 0x400, device, "SECOND")
    engine._writes[0] = device.write
    with pytest.raises(BoardError, match=r"no good; pc 0x0.*, in reset\+0x.* \(program\.c:2\)"):
        engine.run()
    assert engine.load(0x20002000, 4) == 0xA5A5A5A5  # nothing is executed after it


def test_an_exception_of_python_comes_out_when_a_peripheral_raises_one(boot: Boot) -> None:
    engine = boot("HANDLER reset(void) { REG(DEVICE); REST(); } VECTORS();")
    attach(engine)
    engine._reads[0] = lambda offset, size: 1 // 0
    with pytest.raises(ZeroDivisionError):
        engine.run()


def test_alarms_go_off_in_order_when_they_share_a_cycle(boot: Boot) -> None:
    engine = boot('HANDLER reset(void) { for (;;) __asm volatile("nop"); } VECTORS();', cpi=1)
    engine.core_clock(216_000_000)
    seen: list[tuple[str, int]] = []
    one = engine.alarm("one", lambda: seen.append(("one", engine.cycle)))

    def on_two() -> None:
        seen.append(("two", engine.cycle))
        again.set(0)

    two = engine.alarm("two", on_two)
    again = engine.alarm("again", lambda: seen.append(("again", engine.cycle)))
    two.set(1000)
    one.set(1000)
    assert (one.due, again.due) == (1000, None)
    engine.run_to(2000)
    assert seen == [("one", 1000), ("two", 1000), ("again", 1000)]
    assert engine.cycle == 2000


def test_ram_stays_and_flash_stays_when_the_image_resets_the_chip(boot: Boot) -> None:
    source = """
    HANDLER reset(void)
    {
        if (RESULT[0] != 0x1234) {
            RESULT[0] = 0x1234;
            REG(0xE000ED0C) = 0x05FA0004;
            for (;;)
                ;
        }
        RESULT[1] = 1;
        REST();
    }
    VECTORS();
    """
    engine = boot(source)
    causes: list[str] = []
    engine.on_system_reset(causes.append)
    engine.run_to(100_000)
    assert results(engine, 2) == [0x1234, 1]
    assert causes == ["software"]
    engine.power_cycle()
    assert results(engine, 1) == [0xA5A5A5A5]
    assert causes == ["software", "power"]


def test_a_store_to_flash_goes_to_its_controller_when_there_is_one(boot: Boot) -> None:
    source = "HANDLER reset(void) { REG(0x08010000) = 0x12345678; REG(0x08010000) = 0xFFFFFF00;"
    source += "*(volatile uint16_t *)0x08010008 = 0xABCD; RESULT[0] = REG(0x08010000); REST(); } VECTORS();"
    engine = boot(source)
    stores: list[tuple[int, int, int]] = []

    def program(address: int, size: int, value: int) -> None:
        stores.append((address, size, value))
        old = int.from_bytes(engine.memory(address, size), "little")
        engine.set_memory(address, (old & value).to_bytes(size, "little"))

    engine.on_flash_store(program)
    engine.run()
    assert stores == [(0x08010000, 4, 0x12345678), (0x08010000, 4, 0xFFFFFF00), (0x08010008, 2, 0xABCD)]
    assert engine.load(0x20002000, 4) == 0x12345600
    assert engine.memory(0x00210008, 4) == b"\xcd\xab\xff\xff"


def test_two_stores_to_flash_are_an_error_when_one_instruction_makes_them(boot: Boot) -> None:
    source = (
        'HANDLER reset(void) { __asm volatile("strd r0, r1, [%0]" :: "r"(0x08010000)); REST(); } VECTORS();'
    )
    engine = boot(source)
    engine.on_flash_store(lambda address, size, value: None)
    with pytest.raises(BoardError, match="0x08010004, the second store to flash by one instruction"):
        engine.run()
    assert engine.memory(0x08010000, 8) == b"\xff" * 8


def test_fetches_from_flash_wait_when_it_is_busy(boot: Boot) -> None:
    source = (
        'HANDLER reset(void) { REG(DEVICE + 4) = 1; __asm volatile("nop"); REG(DEVICE + 4) = 2; REST(); }'
    )
    engine = boot(source + "VECTORS();")
    device = attach(engine)
    write = device.write

    def busy(offset: int, size: int, value: int) -> None:
        write(offset, size, value)
        if value == 1:
            engine.flash_busy(5_000_000)

    engine._writes[0] = busy
    engine.run_to(3_000_000)
    assert engine.cycle == 3_000_000  # nothing runs past the time asked for
    engine.run()
    assert device.times[0] < 1000
    assert device.times[1] >= 5_000_000


def test_code_is_run_anew_when_flash_is_changed(boot: Boot) -> None:
    source = """
    __attribute__((noinline)) uint32_t value(void) { return 17; }
    HANDLER reset(void) { for (;;) { RESULT[0] = value(); __asm volatile("wfi"); } }
    VECTORS();
    """
    engine = boot(source)
    assert ran(engine, 1) == [17]
    engine.set_memory(engine.symbols["value"], bytes.fromhex("2a20"))  # movs r0, #42
    engine.power_cycle()
    assert ran(engine, 1) == [42]


def test_arguments_are_refused_when_they_make_no_sense() -> None:
    with pytest.raises(ValueError, match="the flash holds"):
        Engine(bytes(0x80001))
    with pytest.raises(ValueError, match="cycles an instruction"):
        Engine(b"", cpi=0)  # type: ignore[arg-type]


def test_it_says_so_when_flash_is_empty() -> None:
    with pytest.raises(BoardError, match="execution at 0xFFFFFFFE"):
        Engine(b"").run()
