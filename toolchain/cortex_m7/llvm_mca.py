"""The cycles of basic blocks on a Cortex-M7, by llvm-mca's model of it with two corrections.

The cost of a block is the marginal one: with the block written n times over, what a repetition adds to
the cycles, (C(300) - C(100)) / 200. That is what a loop's body costs in a loop, and what code that runs on
into other code costs; a lone block would pay for filling and emptying the pipeline each time.
docs/explanation/timing.md says how this was held against published figures, and what the model leaves out.

1. llvm-mca prices a VLDM of 16 registers like one of one, the core moves 64 bits a cycle. So LDM, STM, VLDM,
   VSTM, PUSH and POP of n words are written as ceil(n / 2) accesses of 64 bits: the same registers in the
   same order, so that every wait for a register stays. The last access is a multiple itself, with the
   base's write-back.
2. A block that ends in a branch costs 1 more.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from neuroflight.toolchain.cortex_m7.disassembly import Instruction
from neuroflight.toolchain.errors import BuildError

PRICER = "llvm-mca"
PACKAGE = "llvm"  # the system's package that brings it
TRIPLE = "thumbv7em-none-eabihf"
SHORT, LONG = 100, 3  # iterations of a block, and of the block written LONG times over
BRANCH_CYCLES = 1
MASKS = ("cpsid", "cpsie")  # of interrupts: the model lacks them
MULTIPLE = re.compile(r"(v?)(ldm|stm|push|pop)(ia|db)?")
REFUSED = re.compile(r"note: instruction: *\s*(.*)")
MISREAD = re.compile(r"<stdin>:(\d+):\d+: error: (.*)")

Block = Sequence[Instruction]


class PricingError(BuildError):
    """A block without a price: llvm-mca is missing, or does not know an instruction."""


def find_pricer() -> str | None:
    """Return the name of an installed llvm-mca, or None."""
    return PRICER if shutil.which(PRICER) else None


def pricer_version() -> str:
    """Return the version of llvm-mca, such as "LLVM 14.0.6". Raises PricingError if it is missing."""
    words = _run(["--version"], "").split("LLVM version", 1)
    return f"LLVM {words[1].split()[0]}" if len(words) == 2 else "LLVM of unknown version"


def block_cycles(blocks: Sequence[Block]) -> list[float]:
    """Predict the cycles of each block, branch included. Raises PricingError."""
    texts = [tuple(line for instruction in block for line in assembly(instruction)) for block in blocks]
    distinct = list(dict.fromkeys(text for text in texts if text))
    lines = [".syntax unified", ".thumb"]
    for number, text in enumerate(distinct):
        for copies in (1, LONG):
            lines += [f"@ LLVM-MCA-BEGIN {number}", *(text * copies), f"@ LLVM-MCA-END {number}"]
    totals = _totals(lines) if distinct else []
    marginal = {
        text: (totals[2 * number + 1] - totals[2 * number]) / (SHORT * (LONG - 1))
        for number, text in enumerate(distinct)
    }
    return [
        marginal.get(text, 0.0) + BRANCH_CYCLES * block[-1].is_branch
        for text, block in zip(texts, blocks, strict=True)
    ]


def assembly(instruction: Instruction) -> tuple[str, ...]:
    """Return `instruction` as llvm-mca takes and prices it: none, one or several lines.

    Conditions are left out with their IT, because a skipped instruction takes its place in the pipeline too;
    calls become jumps, because the called function is counted separately; VCMPE and comparing with zero,
    which
    the model lacks, become VCMP of two registers; masks of interrupts become one cycle.
    """
    operation, operands = instruction.operation, instruction.operands
    if re.fullmatch("it[te]*", instruction.mnemonic):
        return ()
    if operation in MASKS:
        return ("nop",)
    if multiple := MULTIPLE.fullmatch(operation):
        return tuple(_multiple(multiple, operands))
    if instruction.is_branch:
        return (_branch(operation, operands),)
    if operation.startswith("vcmp"):
        operation, operands = operation.replace("vcmpe", "vcmp"), operands.replace("#0.0", "s0")
    if operation.startswith("vmov.f32") and "#" in operands:  # printed as the encoded byte
        operands = operands.split(",")[0] + ", #1.0"
    return (f"{operation} {operands}".strip(),)


def _branch(operation: str, operands: str) -> str:
    if operation in ("cbz", "cbnz"):
        return f"{operation} {operands.split(',')[0]}, #4"
    if operation in ("bx", "blx") or operation.startswith("tb"):
        return f"{operation.replace('blx', 'bx')} {operands}"
    if operation.startswith("b"):
        return f"{'b' if operation == 'bl' else operation} #-4"
    return f"{operation} {operands}"


def _multiple(kind: re.Match[str], operands: str) -> Iterator[str]:
    """Yield accesses of 64 bits in place of a load or store of several words."""
    vector, name, _ = kind.groups()
    on_stack = name in ("push", "pop")
    base, registers = ("sp!", operands) if on_stack else operands.split(",", 1)
    words = _words(registers)
    returns = "pc" in words
    words = ["lr" if word == "pc" else word for word in words]
    *pairs, last = (words[start : start + 2] for start in range(0, len(words), 2))
    access = _Access(vector, name in ("ldm", "pop"), base.strip(" !"))
    yield from (access.pair(*pair) for pair in pairs)
    yield access.last(last, writes_back="!" in base)
    if returns:
        yield "bx lr"


@dataclass(frozen=True)
class _Access:
    """Accesses of at most 64 bits that replace one instruction."""

    vector: str  # "v" or ""
    is_load: bool
    base: str

    def pair(self, first: str, second: str) -> str:
        """Write an access of two words without write-back. VLDR of a double needs an even first register."""
        if not self.vector:
            return f"{'ldrd' if self.is_load else 'strd'} {first}, {second}, [{self.base}]"
        if int(first[1:]) % 2 == 0:
            return f"{'vldr' if self.is_load else 'vstr'} d{int(first[1:]) // 2}, [{self.base}]"
        return self.last([first, second], writes_back=False)

    def last(self, words: Sequence[str], *, writes_back: bool) -> str:
        """Write an access of one or two words; a single core register has no multiple."""
        if not self.vector and len(words) == 1:
            return f"{'ldr' if self.is_load else 'str'} {words[0]}, [{self.base}]{', #4' * writes_back}"
        name = f"{self.vector}{'ldm' if self.is_load else 'stm'}ia"
        return f"{name} {self.base}{'!' * writes_back}, {{{', '.join(words)}}}"


def _words(registers: str) -> list[str]:
    """List the 32-bit registers of a list such as {r4-r7, pc}, {s16-s31}, {d8, d9}."""
    words: list[str] = []
    for part in registers.strip(" {}").split(","):
        first, _, last = part.strip().partition("-")
        span = [first] if not last else [f"{first[0]}{i}" for i in range(int(first[1:]), int(last[1:]) + 1)]
        for register in span:
            number = register[1:]
            doubled = register[0] == "d" and number.isdigit()
            words += [f"s{2 * int(number)}", f"s{2 * int(number) + 1}"] if doubled else [register]
    return words


def _totals(lines: Sequence[str]) -> list[int]:
    """Run llvm-mca and return the cycles of each region of the text, in order."""
    options = ["-march=thumb", f"-mtriple={TRIPLE}", "-mcpu=cortex-m7", f"-iterations={SHORT}", "-json"]
    answer = json.loads(_run(options, "\n".join(lines) + "\n"))
    return [int(region["SummaryView"]["TotalCycles"]) for region in answer["CodeRegions"]]


def _run(options: Sequence[str], text: str) -> str:
    if find_pricer() is None:
        raise PricingError(f"{PRICER} is not installed; run: sudo apt-get install {PACKAGE}")
    done = subprocess.run([PRICER, *options], input=text, capture_output=True, text=True)
    if done.returncode != 0 or MISREAD.search(done.stderr):  # what it misreads it may also leave out
        raise PricingError(f"{PRICER} has no price for {_culprit(done.stderr, text.splitlines())}")
    return done.stdout


def _culprit(words: str, lines: Sequence[str]) -> str:
    if refused := REFUSED.search(words):
        return f"`{' '.join(refused[1].split())}`: its model of the Cortex-M7 lacks the instruction"
    if misread := MISREAD.search(words):
        return f"`{lines[int(misread[1]) - 1]}`: {misread[2]}"
    return f"the code: {words.strip().splitlines()[0] if words.strip() else 'no reason given'}"
