"""Facts of a linked image, read from its ELF: what lies where, for which processor, under which names."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from elftools.common.exceptions import ELFError
from elftools.elf.constants import SH_FLAGS
from elftools.elf.elffile import ELFFile
from elftools.elf.sections import SymbolTableSection

from neuroflight.toolchain.contract import (
    DTCM,
    FLASH_BANK_A,
    FLASH_BASE,
    FLASH_BOOT,
    FLASH_BYTES,
    FLASH_POLICY_SLOTS,
    IMAGE_TAIL_BYTES,
    ITCM,
    NULL_PAGE_BYTES,
    SRAM1,
    SRAM2,
    Region,
)
from neuroflight.toolchain.errors import BuildError
from neuroflight.toolchain.files import file_size

FLASH = Region("flash", FLASH_BASE, FLASH_BYTES)
# As the linker script has them, which leaves the null page out.
RAM = (Region("ITCM", ITCM.address + NULL_PAGE_BYTES, ITCM.size - NULL_PAGE_BYTES), DTCM, SRAM1, SRAM2)

# What an image may take of them (the linker scripts hold it too): of its bank all but the marks at the end.
# The boot part has a sector of its own, the policy a slot; the other slot is only made empty.
BOOT = Region("boot part", FLASH_BOOT.address, FLASH_BOOT.size)
BANK = Region("bank", FLASH_BANK_A.address, FLASH_BANK_A.size - IMAGE_TAIL_BYTES)
SLOT, OTHER_SLOT = (
    Region(name, place.address, place.size)
    for name, place in zip(("policy slot", "other slot"), FLASH_POLICY_SLOTS, strict=True)
)
RAM_USED, RAM_LIMIT = "ram_bytes", "RAM_LIMIT"  # image.ld's names: of RAM beside weights and log


def read_flashable(path: Path) -> bytes:
    """Read a .bin, at most as large as the flash. Raises BuildError otherwise."""
    try:
        size = file_size(path)
        if not 0 < size <= FLASH_BYTES:
            raise BuildError(
                f"{path}: {size} bytes, expected an image of 1 to {FLASH_BYTES}; build it with "
                f"`make firmware TARGET=MATEKF722`"
            )
        return path.read_bytes()
    except OSError as error:
        raise BuildError(
            f"{path}: {error.strerror}; build it with `make firmware TARGET=MATEKF722`, or name another one"
        ) from None


@dataclass(frozen=True)
class Section:
    """A section that occupies memory while the program runs."""

    name: str
    address: int
    size: int  # bytes
    stored: bool  # has bytes in the file (false: zeroed or left alone at start)


@dataclass(frozen=True)
class Segment:
    """Bytes of the file that must be in memory before the program starts, at their load address."""

    address: int
    size: int


@dataclass(frozen=True)
class MemoryUse:
    """The share of a memory region that an image takes."""

    region: str
    used: int  # bytes
    size: int  # bytes


@dataclass(frozen=True)
class Image:
    """The facts of an ELF file."""

    machine: str  # "ARM", "x64", ...
    sections: tuple[Section, ...]
    segments: tuple[Segment, ...]
    symbols: dict[str, int]  # name to value, defined ones


def read_image(path: Path) -> Image:
    """Read the facts of the ELF file `path`. Raises BuildError if it is none."""
    try:
        file_size(path)  # raises for a pipe or a device, which would not end
        with path.open("rb") as file:
            elf = ELFFile(file)
            return Image(
                machine=elf.get_machine_arch(),
                sections=tuple(
                    Section(s.name, s["sh_addr"], s["sh_size"], s["sh_type"] != "SHT_NOBITS")
                    for s in elf.iter_sections()
                    if s["sh_flags"] & SH_FLAGS.SHF_ALLOC and s["sh_size"]
                ),
                segments=tuple(
                    Segment(s["p_paddr"], s["p_filesz"])
                    for s in elf.iter_segments("PT_LOAD")
                    if s["p_filesz"]
                ),
                symbols=_symbols(elf),
            )
    except OSError as error:
        raise BuildError(f"cannot read the image {path}: {error.strerror}") from error
    except ELFError as error:
        raise BuildError(f"cannot read the image {path}: not an ELF file, {error}") from error


def memory_use(image: Image) -> tuple[MemoryUse, ...]:
    """Use of the board's flash and of each RAM. Raises BuildError for a byte outside all of them."""
    flash = _place(((s.address, s.size, "segment") for s in image.segments), (FLASH,))
    ram = [s for s in image.sections if not _inside(s.address, s.size, FLASH)]
    return flash + _place(((s.address, s.size, s.name) for s in ram), RAM)


def image_budgets(image: Image) -> tuple[MemoryUse, ...]:
    """Return the image's use of its limits: boot part, bank, policy slot, RAM beside weights and log.

    Raises BuildError.
    """
    regions = (BOOT, BANK, SLOT, OTHER_SLOT)
    *parts, _ = _place(((s.address, s.size, "segment") for s in image.segments), regions)
    if missing := {RAM_USED, RAM_LIMIT} - image.symbols.keys():
        raise BuildError(f"the image does not tell {missing.pop()}, expected one that image.ld has linked")
    return *parts, MemoryUse("RAM beside weights and log", image.symbols[RAM_USED], image.symbols[RAM_LIMIT])


def _place(spans: Iterable[tuple[int, int, str]], regions: Sequence[Region]) -> tuple[MemoryUse, ...]:
    used = {region.name: 0 for region in regions}
    for address, size, name in spans:
        home = next((region.name for region in regions if _inside(address, size, region)), None)
        if home is None:
            places = ", ".join(region.name for region in regions)
            raise BuildError(f"{name} of {size} bytes at 0x{address:08X} lies outside {places}")
        used[home] += size
    return tuple(MemoryUse(region.name, used[region.name], region.size) for region in regions)


def _inside(address: int, size: int, region: Region) -> bool:
    return region.address <= address and address + size <= region.address + region.size


def _symbols(elf: ELFFile) -> dict[str, int]:
    return {
        symbol.name: symbol["st_value"]
        for section in elf.iter_sections()
        if isinstance(section, SymbolTableSection)
        for symbol in section.iter_symbols()
        if symbol.name and symbol["st_shndx"] != "SHN_UNDEF"
    }
