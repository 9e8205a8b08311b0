"""Description of the chip for a debugger: its registers and its memory map."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby

from neuroflight.sim.board.core.engine import FLASH_ALIAS, ITCM_BYTES, RAM
from neuroflight.toolchain.contract import FLASH_BASE, FLASH_BYTES, FLASH_SECTORS


@dataclass(frozen=True)
class Register:
    """A register by its number in the description, which is its place in the answer to `g`."""

    name: str
    words: tuple[int, ...]  # numbers of `Engine.register`, the low one first
    type: str = "int"

    @property
    def bits(self) -> int:
        return 32 * len(self.words)


_TYPES = {"sp": "data_ptr", "pc": "code_ptr"}
_CORE = (*(f"r{i}" for i in range(13)), "sp", "lr", "pc", "xpsr")
_SYSTEM = ("msp", "psp", "primask", "basepri", "faultmask", "control")
_S0, _FPSCR, _MSP = 17, 49, 50  # of `Engine.register`

# Features and names are GDB's (its manual, G.5.3 "ARM Features"); from d0 to d15 it makes s0 to s31.
FEATURES: dict[str, tuple[Register, ...]] = {
    "org.gnu.gdb.arm.m-profile": tuple(
        Register(name, (i,), _TYPES.get(name, "int")) for i, name in enumerate(_CORE)
    ),
    "org.gnu.gdb.arm.vfp": (
        *(Register(f"d{i}", (_S0 + 2 * i, _S0 + 2 * i + 1), "ieee_double") for i in range(16)),
        Register("fpscr", (_FPSCR,)),
    ),
    "org.gnu.gdb.arm.m-system": tuple(
        Register(name, (_MSP + i,), "data_ptr" if name.endswith("sp") else "int")
        for i, name in enumerate(_SYSTEM)
    ),
}
REGISTERS = tuple(register for feature in FEATURES.values() for register in feature)

# Registers that gdb reads to see through exceptions, and that reading leaves alone: system control block,
# floating-point context (ARMv7-M B3.2, B4.6).
UNCHANGED = (*range(0xE000ED00, 0xE000ED40, 4), 0xE000EF34, 0xE000EF38, 0xE000EF3C)

ROM_BASE, ROM_BYTES = 0x1FF00000, 0x10000
MEMORY = (
    (0, ITCM_BYTES),
    (FLASH_ALIAS, FLASH_BYTES),
    (FLASH_BASE, FLASH_BYTES),
    (ROM_BASE, ROM_BYTES),
    RAM[1],
)
_NO_STORE = "flash takes no store; program it by `load`"
READ_ONLY = (  # of memory, and what a debugger is told who writes there
    *((base, FLASH_BYTES, _NO_STORE) for base in (FLASH_ALIAS, FLASH_BASE)),
    (ROM_BASE, ROM_BYTES, "the chip's ROM takes no store"),
)
REGISTER_SPACES = ((0x40000000, 0x20000000), (0xE0000000, 0x100000))


def readable_bytes(address: int, size: int) -> int:
    """Return how many of `size` bytes at `address` lie in memory."""
    for base, length in MEMORY:
        if base <= address < base + length:
            return min(size, base + length - address)
    return 0


def target_xml() -> str:
    """Return the description of the registers."""
    features = "".join(
        f'<feature name="{name}">'
        + "".join(f'<reg name="{r.name}" bitsize="{r.bits}" type="{r.type}"/>' for r in registers)
        + "</feature>"
        for name, registers in FEATURES.items()
    )
    return (
        '<?xml version="1.0"?><!DOCTYPE target SYSTEM "gdb-target.dtd">'
        f"<target><architecture>arm</architecture>{features}</target>"
    )


def memory_map_xml() -> str:
    """Return the map by which gdb erases and programs flash in sectors, and refuses to store to it."""
    spaces = [("ram", 0, ITCM_BYTES), ("rom", FLASH_ALIAS, FLASH_BYTES), ("rom", ROM_BASE, ROM_BYTES)]
    spaces += [("ram", *RAM[1]), *(("ram", *space) for space in REGISTER_SPACES)]
    rows = [f'<memory type="{kind}" start="0x{base:x}" length="0x{size:x}"/>' for kind, base, size in spaces]
    for size, group in groupby(FLASH_SECTORS, key=lambda sector: sector.size):
        sectors = list(group)
        rows.append(
            f'<memory type="flash" start="0x{sectors[0].address:x}" length="0x{size * len(sectors):x}">'
            f'<property name="blocksize">0x{size:x}</property></memory>'
        )
    return (
        '<?xml version="1.0"?><!DOCTYPE memory-map PUBLIC "+//IDN gnu.org//DTD GDB Memory Map V1.0//EN" '
        f'"http://sourceware.org/gdb/gdb-memory-map.dtd"><memory-map>{"".join(rows)}</memory-map>'
    )
