"""Where in the sources an address of the image lies: function, file and line, from the ELF's own tables."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

from elftools.elf.elffile import ELFFile

from toolchain.cortex_m7 import Symbol, load_program

NOWHERE = "?"


class Places:
    """Symbols and lines of one ELF file; the lines are read when first asked for."""

    def __init__(self, elf: Path) -> None:
        """Raises BuildError when `elf` is no ARM program with symbols."""
        self.path = elf
        self.symbols = dict(load_program(elf).symbols)
        functions = sorted(
            (symbol for symbol in self.symbols.values() if symbol.is_function),
            key=lambda symbol: (symbol.address, -symbol.size, symbol.name),
        )
        self.functions: tuple[Symbol, ...] = tuple({symbol.address: symbol for symbol in functions}.values())
        self._starts = [symbol.address for symbol in self.functions]

    def function(self, address: int) -> Symbol | None:
        """The function that `address` lies in."""
        found = bisect_right(self._starts, address) - 1
        if found < 0:
            return None
        symbol = self.functions[found]
        return symbol if address < symbol.address + max(symbol.size, 2) else None

    def line(self, address: int) -> str:
        """file:line of the instruction at `address`, or "?"."""
        found = bisect_right(self._line_starts, address) - 1
        return self._lines[found][1] if found >= 0 else NOWHERE

    def describe(self, address: int) -> str:
        """pc 0x08020304, in gyro_edge_handler+0x1a (gyro_chip.c:120)."""
        symbol = self.function(address)
        if symbol is None:
            return f"pc 0x{address:08X}, in no function"
        return f"pc 0x{address:08X}, in {symbol.name}+0x{address - symbol.address:x} ({self.line(address)})"

    @cached_property
    def _lines(self) -> list[tuple[int, str]]:
        with self.path.open("rb") as file:
            elf = ELFFile(file)
            return sorted(_rows(elf.get_dwarf_info())) if elf.has_dwarf_info() else []

    @cached_property
    def _line_starts(self) -> list[int]:
        return [address for address, _ in self._lines]


def _rows(dwarf: Any) -> Iterator[tuple[int, str]]:  # noqa: ANN401 - pyelftools has no types
    for unit in dwarf.iter_CUs():
        program = dwarf.line_program_for_CU(unit)
        if program is None:
            continue
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
