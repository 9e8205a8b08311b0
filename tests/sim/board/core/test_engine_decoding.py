"""What the engine believes an instruction to be, held against the disassembler."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from cffi import FFI
from elftools.elf.elffile import ELFFile

from neuroflight.sim.board.core.library import BASE, load_library
from neuroflight.toolchain.cortex_m7.disassembly import Instruction, disassemble

ACCESS, DIVIDE, MASKS, WAIT, CONTROL = range(5)  # enum special_kind of engine.h
SP, PC, NO_INDEX = 13, 15, 15
NO_FLOAT = 0xFFFF
REGISTERS = {**{f"r{i}": i for i in range(16)}, "sl": 10, "fp": 11, "ip": 12, "sp": 13, "lr": 14, "pc": 15}
PLAIN = {"ldr": 4, "str": 4, "ldrh": 2, "ldrsh": 2, "strh": 2, "ldrb": 1, "ldrsb": 1, "strb": 1}
ALWAYS = ("ldrd", "strd", "ldrex", "strex", "ldmia", "ldmdb", "stmia", "stmdb")
FLOATS = ("vldr", "vstr", "vldmia", "vldmdb", "vstmia", "vstmdb")
CONDITIONS = "eq|ne|cs|cc|mi|pl|vs|vc|hi|ls|ge|lt|gt|le"
MNEMONIC = re.compile(
    rf"({'|'.join(sorted((*PLAIN, *ALWAYS, *FLOATS), key=len, reverse=True))})({CONDITIONS})?(\.\w+)*$"
)

VARIED = """
struct s { uint8_t b; uint16_t h; uint32_t w[300]; float f[200]; double d; int8_t c; int16_t e; };
__attribute__((noinline)) uint32_t many(struct s *s, struct s *t, uint32_t i, float x)
{
    for (uint32_t k = 0; k < i; ++k) {
        s->w[k] = t->w[i - k] / (i + 1) + (uint32_t)((int32_t)t->b / (int32_t)(k + 1));
        s->f[k] = t->f[k + i] * x + s->f[199];
        s->h = (uint16_t)(t->h + s->e);
        t->c = (int8_t)(s->c + s->b);
        t->w[k] ^= s->w[k] << 3;
    }
    s->d = t->d;
    return s->w[299] + ((uint8_t *)s)[i] + ((uint16_t *)t)[i] + (uint32_t)((int8_t *)t)[i] + s->w[i << 2];
}
HANDLER reset(void)
{
    FPU_ON();
    __asm volatile("cpsid i\\n cpsie f\\n msr basepri, r0\\n mrs r0, control\\n mrs r1, ipsr\\n"
        "ldrex r2, [r3, #4]\\n strex r2, r4, [r3]\\n stmdb r5, {r0, r1}\\n ldr.w r0, [r1, #-3]!\\n"
        "ldrsh.w r0, [r1], #6\\n pld [r2]\\n it eq\\n ldreq r0, [r1, r2, lsl #3]\\n"
        "vpush {s0}\\n vstr s1, [r5, #-4]\\n vldmia r5!, {s0-s3}\\n"
        "ldr r0, [sp, #4]\\n strd r2, r3, [r4, #-8]!\\n vmov r0, s1\\n vmsr fpscr, r0\\n"
        "push {r4, lr}\\n ldr r0, [pc, #4]\\n nop\\n nop");
    many((void *)0x20003000, (void *)0x20004000, 3, 1.0f);
    REST();
}
VECTORS();
"""


@cache
def decoder() -> Any:
    """The library with block_decode, which is not for Python: its structs come from engine.h."""
    ffi, text = FFI(), (BASE / "engine.h").read_text()
    for name in ("special", "block"):
        ffi.cdef(text[text.index(f"struct {name} {{") :].partition("};\n")[0] + "};")
    ffi.cdef("struct block *block_decode(const uint8_t *code, uint32_t size, uint32_t opening);")
    return ffi.dlopen(str(load_library().path))


def decode(code: bytes) -> Any:
    """The engine's block of `code`."""
    return decoder().block_decode(code, len(code), 0)


def expected_access(instruction: Instruction) -> tuple[int, int, bool] | None:
    """Base register, alignment, and whether that is always needed, of an access that needs a look."""
    found = MNEMONIC.match(instruction.mnemonic)
    if found is None:
        return None
    base = re.search(r"\[(\w+)", instruction.operands) or re.match(r"(\w+)!?,", instruction.operands)
    assert base is not None, instruction
    number = REGISTERS[base[1]]
    return None if number in (SP, PC) else (number, PLAIN.get(found[1], 4), found[1] not in PLAIN)


def check_all(elf: Path) -> set[str]:
    """Compare all code of `elf`; returns the mnemonics that were seen."""
    seen = set()
    with elf.open("rb") as file:
        sections = [
            (section["sh_addr"], section.data())
            for section in ELFFile(file).iter_sections()
            if section["sh_flags"] & 2 and section["sh_type"] == "SHT_PROGBITS"
        ]
    for address, instruction in disassemble(elf).items():
        base, data = next((b, d) for b, d in sections if b <= address < b + len(d))
        block = decode(data[address - base : address - base + instruction.size])
        special = block.specials[0] if block.special_count else None
        kind = special.kind if special else None
        access = (special.base, special.align, bool(special.always)) if special and kind == ACCESS else None
        root = instruction.mnemonic.split(".")[0]
        assert block.count == 1, instruction
        assert access == expected_access(instruction), instruction
        assert (block.float_offset != NO_FLOAT) == root.startswith("v"), instruction
        assert (kind == DIVIDE) == (root in ("sdiv", "udiv")), instruction
        assert (kind == MASKS) == (root in ("cpsid", "cpsie", "msr")), instruction
        assert (kind == WAIT) == (root == "wfi"), instruction
        assert (kind == CONTROL) == (root == "mrs" and "CONTROL" in instruction.operands.upper()), instruction
        assert block.calls == (root in ("bl", "blx")), instruction
        immediate = re.search(r"\[\w+(?:, #(-?\d+))?\]!?$", instruction.operands)
        if special and access and immediate and special.index == NO_INDEX:
            assert special.immediate == int(immediate[1] or 0), instruction
        seen.add(root)
    return seen


def test_every_instruction_is_seen_as_it_is_when_compiled(compile_program: Callable[[str], Any]) -> None:
    seen = check_all(compile_program(VARIED).elf)
    assert {"ldrd", "strd", "vldr", "vstr", "udiv", "sdiv", "ldrsb", "strh", "bl"} <= seen


@pytest.mark.slow
def test_every_instruction_of_the_image_is_seen_as_it_is(board_image: Path) -> None:
    assert len(check_all(board_image)) > 60


def test_an_access_is_looked_at_once_when_its_base_stays(compile_program: Callable[[str], Any]) -> None:
    def looks(*halfwords: int) -> list[int]:
        block = decode(b"".join(word.to_bytes(2, "little") for word in halfwords))
        return [block.specials[i].offset for i in range(block.special_count)]

    load, next_word, half = 0x6808, 0x6848, 0x8808  # ldr r0, [r1]; ldr r0, [r1, #4]; ldrh r0, [r1]
    assert looks(load, next_word, half, load) == [0]
    assert looks(half, load) == [0, 2]  # two bytes' alignment is not four
    assert looks(load, 0x3104, load) == [0]  # adds r1, #4
    assert looks(load, 0x3102, load) == [0, 4]  # adds r1, #2
    assert looks(load, 0x4611, load) == [0, 4]  # mov r1, r2
    assert looks(0x6809, 0x6809) == [0, 2]  # ldr r1, [r1]
    assert looks(0xBF08, load, load) == [2, 4]  # it eq: the first may not have been executed
    assert looks(0xC903, load) == [0, 2]  # ldm r1, {r0, r1}
    assert looks(load, 0xF101, 0x0108, load) == [0]  # add.w r1, r1, #8
    assert looks(load, 0xF101, 0x0106, load) == [0, 6]  # add.w r1, r1, #6
    assert looks(load, 0xF851, 0x0B02, load) == [0, 6]  # ldr r0, [r1], #2
