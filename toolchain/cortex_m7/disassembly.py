"""The instructions of a linked program, as the binutils of its compiler read them."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from neuroflight.toolchain.errors import BuildError

DISASSEMBLER = "arm-none-eabi-objdump"
PACKAGE = "binutils-arm-none-eabi"  # the system's package that brings it

FUNCTION = re.compile(r"^[0-9a-f]+ <(.+)>:$")
SOURCE = re.compile(r"^(.*\.[chS]):(\d+)( \(discriminator \d+\))?$")
INSTRUCTION = re.compile(r"^ *([0-9a-f]+):\t([0-9a-f]{4}(?: [0-9a-f]{4})?) *\t(\S+)(?:\t(.*))?$")
COMMENT = re.compile(r"\s*[;@].*$")
IF_THEN = re.compile(r"it[te]*")
OPPOSITE = {"eq": "ne", "cs": "cc", "mi": "pl", "vs": "vc", "hi": "ls", "ge": "lt", "gt": "le"}
OPPOSITE |= {no: yes for yes, no in OPPOSITE.items()}
BRANCH = re.compile(r"(b|bl|bx|blx)(eq|ne|cs|cc|mi|pl|vs|vc|hi|ls|ge|lt|gt|le)?|cbn?z|tb[bh]")


@dataclass(frozen=True)
class Instruction:
    """One instruction where it stands."""

    address: int
    size: int  # bytes
    mnemonic: str  # with condition and width: "vldmia", "bne.n", "vmovpl.f32"
    operands: str
    condition: str  # that an IT instruction before it lays on it; "" for none
    function: str
    line: str  # of the C it comes from, as "policy.c:37"; "" when the program does not tell

    @property
    def text(self) -> str:
        """Text of the instruction."""
        return f"{self.mnemonic} {self.operands}".strip()

    @property
    def operation(self) -> str:
        """The mnemonic without condition and width: "vldmia", "bne", "vmov.f32"."""
        name, dot, types = self.mnemonic.removesuffix(".n").removesuffix(".w").partition(".")
        return name.removesuffix(self.condition) + dot + types

    @property
    def is_branch(self) -> bool:
        """True if the next instruction may be elsewhere."""
        to_pc = re.search(r"\bpc\}", self.operands) or self.operands.startswith("pc,")
        return bool(to_pc or BRANCH.fullmatch(self.operation))

    @property
    def is_conditional(self) -> bool:
        """True if it may be skipped."""
        return bool(self.condition)


def disassemble(program: Path, *, lines: bool = False) -> dict[int, Instruction]:
    """Disassemble the ELF file `program`: every instruction by its address, ascending, without data.

    lines: look up the line of C of each, if the program was compiled with -g.
    Raises BuildError if the disassembler is missing or fails.
    """
    if shutil.which(DISASSEMBLER) is None:
        raise BuildError(f"{DISASSEMBLER} is not installed; run: sudo apt-get install {PACKAGE}")
    command = [DISASSEMBLER, "-d", "-w", "-z", *(["-l"] if lines else []), str(program)]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        raise BuildError(f"{DISASSEMBLER} cannot read {program}: {done.stderr.strip()[:200]}")
    found = {instruction.address: instruction for instruction in _parse(done.stdout.splitlines())}
    return dict(sorted(found.items()))


def _parse(listing: Sequence[str]) -> Iterator[Instruction]:
    function = line = ""
    conditions: list[str] = []
    for text in listing:
        if (match := INSTRUCTION.match(text)) is None:
            if name := FUNCTION.match(text):
                function, line = name[1], ""
            elif source := SOURCE.match(text):
                line = f"{Path(source[1]).name}:{source[2]}"
            continue
        address, raw, mnemonic, operands = match.groups()
        if mnemonic.startswith("."):
            continue
        operands = COMMENT.sub("", operands or "").strip()
        instruction = Instruction(
            int(address, 16), 4 if " " in raw else 2, mnemonic, operands, "", function, line
        )
        if IF_THEN.fullmatch(mnemonic):
            conditions = [operands if then == "t" else OPPOSITE[operands] for then in mnemonic[1:]]
        elif conditions:
            instruction = replace(instruction, condition=conditions.pop(0))
        yield instruction
