"""An emulated Cortex-M7 that calls the C functions of a linked program, one at a time.

Nothing of a chip is emulated: a program's segments lie at their addresses, what the caller asks for beside
them is allocated in an arena, a stack has unmapped memory on either side. Whatever else is touched is a
fault that names the function. The core and its floating point are unicorn's, with the model of the M7.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, lru_cache
from io import BytesIO
from pathlib import Path

from elftools.common.exceptions import ELFError
from elftools.elf.constants import P_FLAGS, SH_FLAGS
from elftools.elf.elffile import ELFFile
from elftools.elf.sections import SymbolTableSection
from unicorn import Uc, UcError
from unicorn import arm_const as arm
from unicorn import unicorn_const as uc

from neuroflight.toolchain.contract import Region
from neuroflight.toolchain.errors import BuildError, NeuroflightError
from neuroflight.toolchain.files import file_size

ELF_BYTES_MAX = 64 << 20
XPSR_THUMB = 1 << 24
INSTRUCTIONS_MAX = 10_000_000  # of one call: what runs longer will not come back
PAGE = 4096  # bytes: what the emulator maps
# AAPCS: the first four words.
ARGUMENTS = (arm.UC_ARM_REG_R0, arm.UC_ARM_REG_R1, arm.UC_ARM_REG_R2, arm.UC_ARM_REG_R3)

# Where no memory of the board lies and no linker script puts anything.
ARENA = Region("arena", 0x90000000, 256 * 1024)
STACK = Region("stack", 0x9F000000, 64 * 1024)
RETURN = 0x9FF00000  # where a called function comes back to

ACCESS = {
    uc.UC_MEM_READ_UNMAPPED: "a read",
    uc.UC_MEM_WRITE_UNMAPPED: "a write",
    uc.UC_MEM_FETCH_UNMAPPED: "a jump",
    uc.UC_MEM_READ_PROT: "a read",
    uc.UC_MEM_WRITE_PROT: "a write to what is constant,",
    uc.UC_MEM_FETCH_PROT: "a jump into data,",
}

Blocks = list[tuple[int, int]]  # address and size [bytes] of runs of code, in the order executed


class FaultError(NeuroflightError):
    """A function that touched memory it may not, executed what is no instruction, or did not come back."""


@dataclass(frozen=True)
class Symbol:
    """A name of the program."""

    name: str
    address: int  # bit 0 cleared
    size: int  # bytes
    is_function: bool


@dataclass(frozen=True)
class ProgramSegment:
    """Memory of the program as it is when main begins, at the address where it is used."""

    address: int
    data: bytes  # the rest is zero, unless another segment lies in the gap
    size: int  # bytes
    is_writable: bool
    is_code: bool


@dataclass(frozen=True, eq=False)
class Program:
    """A linked program."""

    path: Path
    segments: tuple[ProgramSegment, ...]
    symbols: Mapping[str, Symbol]
    sections: Mapping[str, int]  # size [bytes] of those that occupy memory

    def symbol(self, name: str) -> Symbol:
        """Return the symbol `name`. Raises BuildError if the program has none."""
        if name not in self.symbols:
            raise BuildError(f"{self.path.name} has no {name}; link a program that does")
        return self.symbols[name]

    def place(self, address: int) -> str:
        """Format `address` as policy_step+0x1a, or as the bare number outside all functions."""
        for symbol in self._functions:
            if symbol.address <= address < symbol.address + max(symbol.size, 1):
                return f"{symbol.name}+0x{address - symbol.address:x}"
        return f"0x{address:08X}"

    @cached_property
    def _functions(self) -> tuple[Symbol, ...]:
        return tuple(symbol for symbol in self.symbols.values() if symbol.is_function)


def load_program(path: Path) -> Program:
    """Load the program in the ELF file `path`. Raises BuildError for any other file.

    Unchanged bytes are not parsed again.
    """
    try:
        if file_size(path) > ELF_BYTES_MAX:
            raise BuildError(f"{path}: {file_size(path)} bytes, expected an ELF of at most {ELF_BYTES_MAX}")
        return _parsed(path, path.read_bytes())
    except OSError as error:
        raise BuildError(f"cannot read the program {path}: {error.strerror}") from error
    except ELFError as error:
        raise BuildError(f"cannot read the program {path}: not an ELF file, {error}") from error


@lru_cache(maxsize=8)
def _parsed(path: Path, content: bytes) -> Program:
    elf = ELFFile(BytesIO(content))
    if elf.get_machine_arch() != "ARM":
        raise BuildError(f"{path} is for {elf.get_machine_arch()}, expected ARM; link it for the Cortex-M7")
    return Program(path, tuple(_segments(elf)), _symbols(elf), _sections(elf))


class CortexM7:
    """The core with a program in its memory. Memory keeps what calls leave in it."""

    def __init__(self, program: Program, memory: Sequence[Region] = ()) -> None:
        """Load `program`. `memory`: regions of a board, page by page, that it may use beside its segments.

        Without `memory` a write to code or constants is a fault; within it everything is allowed.
        """
        self.program = program
        self._uc = Uc(uc.UC_ARCH_ARM, uc.UC_MODE_THUMB | uc.UC_MODE_MCLASS)
        self._uc.ctl_set_cpu_model(arm.UC_CPU_ARM_CORTEX_M7)
        self._map(memory)
        for segment in program.segments:
            self._uc.mem_write(segment.address, segment.data)
        self._free = ARENA.address
        self._bad_access = ""
        self._uc.hook_add(uc.UC_HOOK_MEM_INVALID, self._note_access)

    def allocate(self, size: int) -> int:
        """Allocate `size` zeroed bytes, 64-byte aligned, and return their address; they are never freed."""
        address = self._free
        self._free += -(-size // 64) * 64
        if self._free > ARENA.address + ARENA.size:
            raise FaultError(f"{size} bytes more than the arena of {ARENA.size} bytes holds")
        return address

    def read(self, address: int, size: int) -> bytes:
        """Read `size` bytes of memory."""
        return bytes(self._uc.mem_read(address, size))

    def write(self, address: int, data: bytes) -> None:
        """Put `data` into memory, constants included."""
        self._uc.mem_write(address, data)

    def call(
        self,
        function: str,
        *arguments: int,
        number: float | None = None,
        instructions: int = INSTRUCTIONS_MAX,
    ) -> int:
        """Call `function` with up to four words. Returns r0.

        number: its argument of type float, rounded to one; None: it has none. instructions: after how many
        the call is given up.
        Raises FaultError when the call fails, BuildError when the program has no such function.
        """
        entry = self.program.symbol(function).address
        if len(arguments) > len(ARGUMENTS):
            raise ValueError(
                f"{len(arguments)} arguments of {function}, at most {len(ARGUMENTS)} lie in registers"
            )
        for register, value in zip(ARGUMENTS, arguments, strict=False):
            self._uc.reg_write(register, value)
        if number is not None:
            self._uc.reg_write(arm.UC_ARM_REG_S0, int.from_bytes(struct.pack("<f", number), "little"))
        self._uc.reg_write(arm.UC_ARM_REG_SP, STACK.address + STACK.size)
        self._uc.reg_write(arm.UC_ARM_REG_LR, RETURN | 1)
        self._bad_access = ""
        try:
            self._uc.emu_start(entry | 1, RETURN, count=instructions)
        except UcError as error:
            raise FaultError(f"{function} stopped at {self._here()}: {self._bad_access or error}") from error
        if self._uc.reg_read(arm.UC_ARM_REG_PC) != RETURN:
            raise FaultError(
                f"{function} did not come back within {instructions} instructions, {self._here()}"
            )
        return int(self._uc.reg_read(arm.UC_ARM_REG_R0))

    @contextmanager
    def recording(self) -> Iterator[Blocks]:
        """Note the runs of code that calls execute, in order; the caller clears the list between calls.

        A run ends in a branch or wherever the emulator had a reason of its own, such as the end of a page;
        every instruction in it was executed or, under a condition that did not hold, skipped in its place.
        """
        blocks: Blocks = []
        note = blocks.append
        with self._hooked(uc.UC_HOOK_BLOCK, lambda _uc, address, size, _data: note((address, size))):
            yield blocks

    def stack_bytes(self, function: str, *arguments: int) -> int:
        """Measure the deepest stack of a call: the stack pointer is read before every instruction."""
        top = lowest = STACK.address + STACK.size

        def look(core: Uc, _address: int, _size: int, _data: object) -> None:
            nonlocal lowest
            lowest = min(lowest, core.reg_read(arm.UC_ARM_REG_SP))

        with self._hooked(uc.UC_HOOK_CODE, look):
            self.call(function, *arguments)
        return top - lowest

    def accesses(self, region: Region, function: str, *arguments: int) -> int:
        """Count the reads and writes of a call in `region`."""
        count = 0

        def note(core: Uc, *_: object) -> bool:
            nonlocal count
            count += 1
            # Unicorn has set ITSTATE to the instruction's, and would apply it to the next block.
            core.reg_write(arm.UC_ARM_REG_EPSR, XPSR_THUMB)
            return True

        kind = uc.UC_HOOK_MEM_READ | uc.UC_HOOK_MEM_WRITE
        with self._hooked(kind, note, region.address, region.address + region.size - 1):
            self.call(function, *arguments)
        return count

    @contextmanager
    def _hooked(self, kind: int, callback: object, begin: int = 1, end: int = 0) -> Iterator[None]:
        # Hooks are compiled into translated code, so what was translated without them is thrown away.
        hook = self._uc.hook_add(kind, callback, begin=begin, end=end)
        self._uc.ctl_flush_tb()  # type: ignore[attr-defined]
        try:
            yield
        finally:
            self._uc.hook_del(hook)
            self._uc.ctl_flush_tb()  # type: ignore[attr-defined]

    def _map(self, memory: Sequence[Region]) -> None:
        board = {page for region in memory for page in _pages(region.address, region.size)}
        pages = dict.fromkeys(board, uc.UC_PROT_ALL)
        for segment in self.program.segments:
            allowed = uc.UC_PROT_READ
            allowed |= uc.UC_PROT_WRITE if segment.is_writable else 0
            allowed |= uc.UC_PROT_EXEC if segment.is_code else 0
            for page in _pages(segment.address, segment.size):
                pages[page] = pages.get(page, 0) | allowed
        for region in (ARENA, STACK):
            pages |= dict.fromkeys(_pages(region.address, region.size), uc.UC_PROT_READ | uc.UC_PROT_WRITE)
        pages[RETURN] = uc.UC_PROT_READ | uc.UC_PROT_EXEC
        for address, size, allowed in _joined(pages):
            self._uc.mem_map(address, size, allowed)

    def _note_access(self, _uc: Uc, access: int, address: int, size: int, _value: int, _data: object) -> bool:
        self._bad_access = f"{ACCESS.get(access, 'an access')} of {size} bytes at 0x{address:08X}"
        return False

    def _here(self) -> str:
        return self.program.place(self._uc.reg_read(arm.UC_ARM_REG_PC))


def _segments(elf: ELFFile) -> Iterator[ProgramSegment]:
    for segment in elf.iter_segments("PT_LOAD"):
        size, flags = segment["p_memsz"], segment["p_flags"]
        if size > ELF_BYTES_MAX:
            raise BuildError(f"a segment of {size} bytes in memory, expected at most {ELF_BYTES_MAX}")
        if size:
            yield ProgramSegment(
                segment["p_vaddr"],
                segment.data(),
                size,
                is_writable=bool(flags & P_FLAGS.PF_W),
                is_code=bool(flags & P_FLAGS.PF_X),
            )


def _symbols(elf: ELFFile) -> dict[str, Symbol]:
    table = elf.get_section_by_name(".symtab")
    if not isinstance(table, SymbolTableSection):
        raise BuildError("the program has no symbols; link it without -s")
    found = {}
    for symbol in table.iter_symbols():
        is_function = symbol["st_info"]["type"] == "STT_FUNC"
        if symbol.name and symbol["st_shndx"] != "SHN_UNDEF":
            address = symbol["st_value"] & ~1 if is_function else symbol["st_value"]
            found[symbol.name] = Symbol(symbol.name, address, symbol["st_size"], is_function)
    return found


def _sections(elf: ELFFile) -> dict[str, int]:
    return {s.name: s["sh_size"] for s in elf.iter_sections() if s["sh_flags"] & SH_FLAGS.SHF_ALLOC}


def _pages(address: int, size: int) -> range:
    return range(address & -PAGE, address + size, PAGE)


def _joined(pages: Mapping[int, int]) -> Iterator[tuple[int, int, int]]:
    """Yield neighbouring pages with equal protection as (address, size, protection)."""
    start, end, allowed = 0, 0, -1
    for page, protection in sorted(pages.items()):
        if page == end and protection == allowed:
            end += PAGE
            continue
        if end > start:
            yield start, end - start, allowed
        start, end, allowed = page, page + PAGE, protection
    if end > start:
        yield start, end - start, allowed
