"""Instructions read off a linked program: all of them, none of the data between, with their conditions."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pytest

from neuroflight.toolchain.cortex_m7.arm_policy import compile_arm
from neuroflight.toolchain.cortex_m7.disassembly import Instruction, disassemble
from neuroflight.toolchain.cortex_m7.emulator import load_program
from neuroflight.toolchain.errors import BuildError

ASSEMBLY = """
    .syntax unified
    .cpu cortex-m7
    .fpu fpv5-sp-d16
    .thumb
    .text
    .global chosen
    .type chosen, %function
    .thumb_func
chosen:
    cmp r0, #0
    itet gt
    movgt r0, #1
    addle.w r0, r1, r2
    vmovgt.f32 s0, s1
    ldr r3, .Lliteral
    it ne
    bxne lr
    cbz r0, .Llast
    tbb [pc, r0]
    .byte 1, 1
.Llast:
    add r0, r0, r3, lsl #2
    pop {r4, pc}
    .align 2
.Lliteral:
    .word 0x47704770
    .size chosen, . - chosen
"""


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("chosen")
    (folder / "chosen.s").write_text(ASSEMBLY)
    compile_arm("-nostdlib", "-Wl,-Ttext=0x10000,-e,chosen", "chosen.s", out=folder / "chosen.elf")
    return folder / "chosen.elf"


@pytest.fixture(scope="module")
def code(program: Path) -> list[Instruction]:
    return list(disassemble(program).values())


def test_instructions_stand_end_to_end_when_no_data_is_between(code: list[Instruction]) -> None:
    assert [i.mnemonic for i in code] == [
        *("cmp", "itet", "movgt", "addle.w", "vmovgt.f32", "ldr", "it", "bxne", "cbz", "tbb"),
        *("add.w", "pop", "nop"),
    ]
    assert code[0].address == 0x10000
    assert all(i.address + i.size == then.address for i, then in pairwise(code[:10]))
    assert {i.function for i in code} == {"chosen"}
    assert code[5].operands.startswith("r3, [pc, #"), "what the disassembler remarks is left out"
    assert "@" not in code[5].operands


def test_conditions_come_from_the_it_before_when_there_is_one(code: list[Instruction]) -> None:
    assert [i.condition for i in code] == ["", "", "gt", "le", "gt", "", "", "ne", "", "", "", "", ""]
    assert [i.operation for i in code[2:5]] == ["mov", "add", "vmov.f32"]
    assert code[7].operation == "bx"


def test_branches_are_known_when_they_hide_in_a_load_or_a_table(code: list[Instruction]) -> None:
    assert [i.mnemonic for i in code if i.is_branch] == ["bxne", "cbz", "tbb", "pop"]


def test_lines_of_c_are_told_when_the_program_has_them(tmp_path: Path) -> None:
    folder = tmp_path / "with a space"
    folder.mkdir()
    (folder / "two.c").write_text(
        "int one(int a)\n{\n    return a + 1;\n}\nint two(int a)\n{\n    return one(a);\n}\n"
    )
    compile_arm("-g", "-O0", "-nostdlib", "-Wl,-Ttext=0x10000,-e,two", "two.c", out=folder / "two.elf")
    program = load_program(folder / "two.elf")
    code = disassemble(folder / "two.elf", lines=True)
    assert code[program.symbol("one").address].line == "two.c:2"
    assert {i.function for i in code.values()} == {"one", "two"}
    assert {i.line for i in disassemble(folder / "two.elf").values()} == {""}


def test_one_line_says_it_when_the_disassembler_is_missing_or_refuses(
    program: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "text.elf").write_text("no")
    with pytest.raises(BuildError, match=r"arm-none-eabi-objdump cannot read .*text\.elf: .*"):
        disassemble(tmp_path / "text.elf")
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(
        BuildError, match="arm-none-eabi-objdump is not installed; run: sudo apt-get install bin"
    ):
        disassemble(program)
