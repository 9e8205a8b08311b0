"""Prices of basic blocks: what llvm-mca is asked, the two corrections, and what it cannot price."""

from __future__ import annotations

from pathlib import Path

import pytest

from neuroflight.toolchain.cortex_m7.disassembly import Instruction
from neuroflight.toolchain.cortex_m7.llvm_mca import (
    PricingError,
    assembly,
    block_cycles,
    find_pricer,
    pricer_version,
)

needs_pricer = pytest.mark.skipif(find_pricer() is None, reason="llvm-mca is not installed")


def instruction(text: str, condition: str = "") -> Instruction:
    mnemonic, _, operands = text.partition(" ")
    return Instruction(0, 4, mnemonic, operands, condition, "f", "")


def cycles(*text: str) -> float:
    return block_cycles([[instruction(line) for line in text]])[0]


@pytest.mark.parametrize(
    ("text", "asked"),
    [
        ("vldmia r0!, {s16-s21}", ("vldr d8, [r0]", "vldr d9, [r0]", "vldmia r0!, {s20, s21}")),
        ("vldmia r1, {s13, s14, s15}", ("vldmia r1, {s13, s14}", "vldmia r1, {s15}")),
        ("vstmia r5!, {d4-d5}", ("vstr d4, [r5]", "vstmia r5!, {s10, s11}")),
        ("vldmia r3!, {s14}", ("vldmia r3!, {s14}",)),
        ("vpush {d8}", ("vstmia sp!, {s16, s17}",)),
        ("push {r4, r5, lr}", ("strd r4, r5, [sp]", "str lr, [sp], #4")),
        ("pop {r4-r6, pc}", ("ldrd r4, r5, [sp]", "ldmia sp!, {r6, lr}", "bx lr")),
        ("ldmia.w r2, {r3, r8, ip}", ("ldrd r3, r8, [r2]", "ldr ip, [r2]")),
        ("stmdb sp!, {r4, r5}", ("stmia sp!, {r4, r5}",)),
        ("bne.n 1003a <f+0x2>", ("bne #-4",)),
        ("bl 10134 <tanhf>", ("b #-4",)),
        ("blx r3", ("bx r3",)),
        ("cbz r3, 10016 <f>", ("cbz r3, #4",)),
        ("ite gt", ()),
        ("vcmpe.f32 s0, #0.0", ("vcmp.f32 s0, s0",)),
        ("vmov.f32 s13, #112", ("vmov.f32 s13, #1.0",)),
        ("ldr.w r0, [ip, #4]!", ("ldr r0, [ip, #4]!",)),
        ("vfma.f32 s0, s1, s2", ("vfma.f32 s0, s1, s2",)),
    ],
)
def test_instruction_is_asked_for_in_words_the_pricer_takes_when_it_is_any(
    text: str, asked: tuple[str, ...]
) -> None:
    assert assembly(instruction(text)) == asked


def test_condition_is_left_out_when_the_price_is_asked() -> None:
    assert assembly(instruction("vmovpl.f32 s15, s7", "pl")) == ("vmov.f32 s15, s7",)
    assert assembly(instruction("bxne lr", "ne")) == ("bx lr",)


@needs_pricer
def test_multiples_cost_an_access_of_64_bits_for_two_words_when_nothing_else_waits() -> None:
    assert cycles("vldmia r0, {s16-s31}") == 8
    assert cycles("vldmia r0, {s16-s18}") == 2
    assert cycles("vldmia r0, {s13-s20}") == 4
    assert cycles("vldmia r0!, {s16-s31}") - cycles("vldmia r0!, {s16-s23}") == 4
    assert cycles("ldmia.w r0, {r1, r2, r3, r4, r5, r6}") == 3
    assert cycles("vstmia r0, {s16-s31}") >= 8


@needs_pricer
def test_block_costs_one_more_when_it_ends_in_a_branch() -> None:
    body = [f"movw r{i}, #1" for i in range(4)]
    assert cycles(*body) == 2, "two a cycle"
    assert cycles("b.n 10000") == 2, "one of the model, one of ours"
    assert cycles(*body, "b.n 10000") == 4


@needs_pricer
def test_call_costs_no_more_than_a_jump_when_the_callee_is_counted_itself() -> None:
    assert cycles("bl 10134 <tanhf>") == cycles("b.n 10134")


@needs_pricer
def test_waiting_shows_when_each_instruction_needs_the_last() -> None:
    chained = cycles(*["vmul.f32 s0, s0, s1"] * 4)
    apart = cycles(*(f"vmul.f32 s{i}, s8, s9" for i in range(4)))
    assert apart == 4
    assert chained == 12, "the model's latency of a product is 3"


@needs_pricer
def test_blocks_are_priced_alike_when_they_come_alone_or_together() -> None:
    blocks = [
        [instruction("vldr s0, [r0]"), instruction("vfma.f32 s1, s0, s2")],
        [instruction("it ne")],
        [instruction("vdiv.f32 s0, s1, s2"), instruction("bx lr")],
        [instruction("vldr s0, [r0]"), instruction("vfma.f32 s1, s0, s2")],
    ]
    together = block_cycles(blocks)
    assert together == [block_cycles([block])[0] for block in blocks]
    assert together[0] == together[3]
    assert together[1] == 0
    assert together[2] > 10
    assert block_cycles([]) == []


@needs_pricer
@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("udf #0", "`udf #0`: its model of the Cortex-M7 lacks the instruction"),
        ("frob r0, r1", "`frob r0, r1`: invalid instruction"),
    ],
)
def test_one_line_names_the_instruction_when_it_has_no_price(text: str, words: str) -> None:
    with pytest.raises(PricingError) as caught:
        cycles("adds r0, #1", text, "bx lr")
    assert str(caught.value) == f"llvm-mca has no price for {words}"


@needs_pricer
def test_version_is_told_when_it_is_there() -> None:
    name, number = pricer_version().split()
    assert name == "LLVM"
    assert number[0].isdigit()


def test_one_line_says_what_to_install_when_the_pricer_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert find_pricer() is None
    with pytest.raises(PricingError, match="llvm-mca is not installed; run: sudo apt-get install llvm"):
        cycles("bx lr")
