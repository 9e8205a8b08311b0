"""Function, file and line of an address in the image, from the ELF's symbols and DWARF."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from elftools.elf.elffile import ELFFile

from neuroflight.toolchain.cortex_m7.emulator import Symbol, load_program

NOWHERE = "?"


class Places:
    """Symbols and lines of one ELF file; the lines are read when first asked for."""

    def __init__(self, elf: Path) -> None:
        """Read the symbols. Raises BuildError if `elf` is no ARM program with symbols."""
        self.path = elf
        self.symbols = dict(load_program(elf).symbols)
        functions = sorted(
            (symbol for symbol in self.symbols.values() if symbol.is_function),
            key=lambda symbol: (symbol.address, -symbol.size, symbol.name),
        )
        self.functions: tuple[Symbol, ...] = tuple({symbol.address: symbol for symbol in functions}.values())
        self._starts = [symbol.address for symbol in self.functions]
        self._rows: dict[int, list[tuple[int, str]]] = {}

    def function(self, address: int) -> Symbol | None:
        """Return the function at `address`, or None."""
        found = bisect_right(self._starts, address) - 1
        if found < 0:
            return None
        symbol = self.functions[found]
        return symbol if address < symbol.address + max(symbol.size, 2) else None

    def line(self, address: int) -> str:
        """Return file:line of the instruction at `address`, or "?"."""
        rows = self._unit_rows(address)
        found = bisect_right(rows, address, key=lambda row: row[0]) - 1
        return rows[found][1] if found >= 0 else NOWHERE

    def describe(self, address: int) -> str:
        """Format an address: pc 0x08020304, in gyro_edge_handler+0x1a (gyro_chip.c:120)."""
        symbol = self.function(address)
        if symbol is None:
            return f"pc 0x{address:08X}, in no function"
        return f"pc 0x{address:08X}, in {symbol.name}+0x{address - symbol.address:x} ({self.line(address)})"

    def _unit_rows(self, address: int) -> list[tuple[int, str]]:
        """Return addresses and lines of the source file whose code is at `address`, ascending."""
        if address not in self._rows:
            with self.path.open("rb") as file:
                elf = ELFFile(file)
                # Where one row ends and others begin, the last of these.
                self._rows[address] = sorted(_rows(elf, address), key=lambda row: (row[0], row[1] != NOWHERE))
        return self._rows[address]


def _rows(elf: ELFFile, address: int) -> Iterator[tuple[int, str]]:
    dwarf: Any = elf.get_dwarf_info() if elf.has_dwarf_info() else None  # pyelftools has no types
    offset = None if dwarf is None else _unit_offset(dwarf, address)
    if offset is None:
        return
    program = dwarf.line_program_for_CU(dwarf.get_CU_at(offset))
    if program is None:
        return
    version, files = program["version"], program["file_entry"]
    for entry in program.get_entries():
        state = entry.state
        if state is None:
            continue
        if state.end_sequence:
            yield state.address, NOWHERE
            continue
        number = state.file if version >= 5 else state.file - 1
        name = files[number].name.decode() if 0 <= number < len(files) else NOWHERE
        yield state.address, f"{Path(name).name}:{state.line}"


def _unit_offset(dwarf: Any, address: int) -> int | None:  # noqa: ANN401
    """Return the offset of the debug information for the code at `address`."""
    ranges = dwarf.get_aranges()
    offset: int | None = None if ranges is None else ranges.cu_offset_at_addr(address)
    return offset
