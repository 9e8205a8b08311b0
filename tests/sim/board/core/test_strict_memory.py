"""Accesses and set-ups that the emulator rejects: the error says what, where and in which line."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from neuroflight.sim.board.core.context import BoardError
from neuroflight.sim.board.core.engine import Engine, Outcome
from tests.sim.board.programs import Boot, attach

SINNING = """
extern const uint32_t itcm_load[];
extern uint32_t itcm_start[], itcm_end[];
__attribute__((section(".itcm"), noinline, used)) void in_itcm(void) { RESULT[5] = 1; }
static void copy(void)
{
    const uint32_t *from = itcm_load;
    for (uint32_t *to = itcm_start; to != itcm_end; ++to)
        *to = *from++;
    __asm volatile("dsb\\n isb");
}
__attribute__((noinline)) void sinner(volatile uint32_t zero)
{
    switch (REG(0x08007000)) {
    ACTS
    }
    RESULT[7] = zero;
}
HANDLER reset(void)
{
    REG(0xE000ED98) = 0; REG(0xE000ED9C) = 0; REG(0xE000EDA0) = 1u << 28 | 7u << 1 | 1u; REG(0xE000ED94) = 5;
    if (REG(0x08007004))
        FPU_ON();
    copy();
    RESULT[7] = 0;
    sinner(0);
    RESULT[6] = 0x600D;
    REST();
}
VECTORS();
"""
CALL_ITCM = "((void (*)(void))((uint32_t)in_itcm + zero))();"
SINS = {
    "unmapped read": (
        "RESULT[0] = REG(0x60000000 + zero);",
        "read of 4 bytes at 0x60000000, where nothing is",
    ),
    "unmapped write": ("REG(0x30000000 + zero) = 1;", "write of 4 bytes at 0x30000000, where nothing is"),
    "below DTCM": ("REG(0x1FFFFFFC + zero) = 1;", "0x1FFFFFFC, below DTCM: the stack overflows"),
    "no peripheral": (
        "REG(0x40000400 + zero) = 1;",
        "write of 0x1 (4 bytes) to 0x40000400, where no modelled",
    ),
    "no register of the core": ("RESULT[0] = REG(0xE000EF50 + zero);", "read of 0xE000EF50"),
    "vectors moved without a barrier": (
        "REG(0xE000ED08 + zero) = 0x20000000;",
        "without a DSB right after it",
    ),
    "vectors moved before a lesser barrier": (
        'REG(0xE000ED08 + zero) = 0x20000000; __asm volatile("dmb\\n isb");',
        "without a DSB right after it",
    ),
    "reserved bits of the core": ("REG(0xE000ED08 + zero) = 0x08000040;", "sets reserved bits"),
    "no key": ("REG(0xE000ED0C + zero) = 4;", "without its key"),
    "no such interrupt": ("ENABLE(104 + zero);", "interrupt 104 in the NVIC, the chip has 104"),
    "half a register": ("*(volatile uint16_t *)(0xE000ED08 + zero) = 1;", "takes words only"),
    "null pointer": (
        "RESULT[0] = *(volatile uint8_t *)(zero + 0x44);",
        "access at 0x00000044, in the null page",
    ),
    "null pointer, written": (
        "*(volatile uint32_t *)(zero + 8) = 1;",
        "access at 0x00000008, in the null page",
    ),
    "code in RAM": ("((void (*)(void))(0x20003001 + zero))();", "execution at 0x20003000, in RAM"),
    "code nowhere": ("((void (*)(void))(0x70000001 + zero))();", "execution at 0x70000000, where nothing is"),
    "code in the null page": (
        "((void (*)(void))(0x21 + zero))();",
        "execution at 0x00000020, in the null page",
    ),
    "null function": ("((void (*)(void))zero)();", "a branch to 0x00000000, which is no Thumb address"),
    "no Thumb address": ("((void (*)(void))(0x08000400 + zero))();", "0x08000400, which is no Thumb address"),
    "undefined": ('__asm volatile("udf #3");', "undefined instruction"),
    "breakpoint": ('__asm volatile("bkpt #3");', "a BKPT instruction"),
    "write to ITCM": (CALL_ITCM + " REG(0x3000 + zero) = 1;", "0x00003000, in ITCM after its copy"),
    "write to flash": ("REG(0x08008000 + zero) = 1;", "a store of 0x1 (4 bytes) to flash at 0x08008000"),
    "write to the alias": ("REG(0x00208000 + zero) = 1;", "0x00208000, in memory that is read-only"),
    "unaligned LDRD": (
        '__asm volatile("ldrd r2, r3, [%0]" :: "r"(0x20003002 + zero) : "r2", "r3");',
        "0x20003002",
    ),
    "unaligned LDM": (
        '__asm volatile("ldm %0, {r2, r3}" :: "r"(0x20003001 + zero) : "r2", "r3");',
        "0x20003001",
    ),
    "unaligned STM": ('__asm volatile("stm %0, {r2, r3}" :: "r"(0x20003003 + zero));', "0x20003003"),
    "unaligned VLDR": ('__asm volatile("vldr s0, [%0, #4]" :: "r"(0x20003002 + zero));', "0x20003006"),
    "unaligned VLDM": ('__asm volatile("vldm %0, {s0-s3}" :: "r"(0x20003002 + zero));', "0x20003002"),
    "unaligned VSTR behind a good one": (
        '__asm volatile("mov r2, %0\\n vstr s0, [r2]\\n add r2, r2, #2\\n vstr s0, [r2]" '
        ':: "r"(0x20003000 + zero) : "r2");',
        "0x20003002",
    ),
    "unaligned peripheral": ("RESULT[0] = REG(0x40000002 + zero);", "unaligned access at 0x40000002"),
    "unaligned with the trap on": (
        "REG(0xE000ED14) |= 8; RESULT[0] = *(volatile uint16_t *)(0x20003001 + zero);",
        "unaligned access at 0x20003001, this instruction needs 2",
    ),
    "division with the trap on": ("REG(0xE000ED14) |= 16; RESULT[0] = 5 / zero;", "division by zero"),
    "return outside a handler": ('__asm volatile("bx %0" :: "r"(0xFFFFFFF9 + zero));', "outside a handler"),
    "memory closed by the MPU": (
        "REG(0xE000ED9C) = 0x2003C000 | 0x11; REG(0xE000EDA0) = 13u << 1 | 1;",
        "MPU region 1 (MPU_RASR 0x0000001B) closes 0x2003C000 to 0x2003FFFF",
    ),
    "memory made read-only by the MPU": (
        "REG(0xE000ED9C) = 0x20000000 | 0x12; REG(0xE000EDA0) = 6u << 24 | 15u << 1 | 1;",
        "MPU region 2 (MPU_RASR 0x0600001F) closes 0x20000000 to 0x2000FFFF",
    ),
    "code closed by the MPU": (
        "REG(0xE000ED9C) = 0x08000000 | 0x13; REG(0xE000EDA0) = 1u << 28 | 3u << 24 | 18u << 1 | 1;",
        "MPU region 3 (MPU_RASR 0x13000025) closes 0x08000000 to 0x0807FFFF",
    ),
    "stack overflow by an interrupt": (
        '__asm volatile("mov sp, %0\\n cpsie i" :: "r"(0x20000010 + zero)); ENABLE(0); PEND(0); '
        '__asm volatile("dsb");',
        "stack overflow: an exception frame at 0x1FFFFF",
    ),
}


REGION = "REG(0xE000ED9C) = 0x20010000 | 0x11; REG(0xE000EDA0) = 3u << 24 | %s | 16u << 1 | 1; CACHE_ON"
CACHE_ON = 'REG(0xE000ED14) |= 1u << 16; __asm volatile("dsb");'
ALLOWED = {
    "unaligned load while no trap is set": "RESULT[0] = REG(0x20003001 + zero);",
    "division": "RESULT[0] = 5 / (zero ? zero : 1);",
    "byte of a peripheral": "RESULT[0] = *(volatile uint8_t *)(0x40000003 + zero);",
    "aligned words": '__asm volatile("vldr s0, [%0, #8]\\n ldrd r2, r3, [%0, #4]" '
    ':: "r"(0x20003000 + zero) : "r2", "r3");',
    "code in ITCM": CALL_ITCM + CALL_ITCM + " RESULT[0] = REG(0x200 + zero);",
    "flash made read-only by the MPU": "REG(0xE000ED9C) = 0x08000000 | 0x11; "
    "REG(0xE000EDA0) = 6u << 24 | 18u << 1 | 1;",
    "alias and unique id": "RESULT[0] = REG(0x00208000 + zero) + REG(0x1FF07A10 + zero);",
}
OTHERS = {
    "a float": '__asm volatile("vmov.f32 s0, #1.0");',
    "a skipped float": '__asm volatile("cmp %0, #1\\n it eq\\n vmoveq.f32 s0, #1.0" :: "r"(zero) : "cc");',
    "cache": CACHE_ON,
    "not cacheable": (REGION % "1u << 19").replace("CACHE_ON", CACHE_ON),
    "write back": (REGION % "3u << 16").replace("CACHE_ON", CACHE_ON),
    "shared": (REGION % "7u << 16").replace("CACHE_ON", CACHE_ON),
}
ACTS = {name: sin[0] for name, sin in SINS.items()} | ALLOWED | OTHERS


@pytest.fixture
def sinner(boot: Boot) -> Callable[..., Engine]:
    """The one program of all sins, about to commit one. Its line is 100 more than its number."""
    cases = [
        f'case {number}: {{\n#line {100 + number} "sins.c"\n{act}\n}} break;'
        for number, act in enumerate(ACTS.values())
    ]

    def make(act: str, *, fpu: bool = True) -> Engine:
        engine = boot(SINNING.replace("ACTS", "\n".join(cases)))
        attach(engine)
        words = (list(ACTS).index(act), int(fpu))
        engine.set_memory(0x08007000, b"".join(word.to_bytes(4, "little") for word in words))
        return engine

    return make


@pytest.mark.parametrize("sin", SINS)
def test_the_error_names_the_sin_when_the_image_commits_it(sinner: Callable[..., Engine], sin: str) -> None:
    engine = sinner(sin)
    with pytest.raises(BoardError) as caught:
        engine.run()
    assert SINS[sin][1] in str(caught.value)
    assert "in sinner+0x" in str(caught.value)
    assert f"(sins.c:{100 + list(ACTS).index(sin)})" in str(caught.value)
    assert engine.load(0x20002018, 4) != 0x600D


@pytest.mark.parametrize("act", ALLOWED)
def test_the_image_goes_on_when_it_does_what_the_chip_allows(sinner: Callable[..., Engine], act: str) -> None:
    engine = sinner(act)
    assert engine.run() is Outcome.ASLEEP
    assert engine.load(0x20002018, 4) == 0x600D


def test_a_float_is_an_error_when_cpacr_does_not_allow_it(sinner: Callable[..., Engine]) -> None:
    assert sinner("a float").run() is Outcome.ASLEEP
    with pytest.raises(BoardError, match=r"floating-point instruction while CPACR = 0x00000000.* in sinner"):
        sinner("a float", fpu=False).run()


def test_a_float_is_no_error_when_its_condition_fails(sinner: Callable[..., Engine]) -> None:
    assert sinner("a skipped float", fpu=False).run() is Outcome.ASLEEP


def test_the_failure_stays_when_it_is_run_again(sinner: Callable[..., Engine]) -> None:
    engine = sinner("undefined")
    messages = []
    for _ in range(2):
        with pytest.raises(BoardError) as caught:
            engine.run()
        messages.append(str(caught.value))
    assert messages[0] == messages[1]


def test_it_starts_anew_when_power_returns_after_a_failure(sinner: Callable[..., Engine]) -> None:
    engine = sinner("undefined")
    with pytest.raises(BoardError, match="undefined"):
        engine.run()
    engine.set_memory(0x08007000, list(ACTS).index("aligned words").to_bytes(4, "little"))
    engine.power_cycle()
    assert engine.run() is Outcome.ASLEEP


@pytest.mark.parametrize(
    ("act", "cached"), [("cache", True), ("not cacheable", False), ("write back", True), ("shared", False)]
)
def test_sram_is_cached_when_no_region_says_otherwise(
    sinner: Callable[..., Engine], act: str, cached: bool
) -> None:
    engine = sinner(act)
    assert not engine.is_cached(0x20010000)
    engine.run()
    assert engine.is_cached(0x20010000) is cached
    assert engine.is_cached(0x2003C000)
    assert not engine.is_cached(0x20003000)
