"""Image files as segments: which bytes belong at which address of the board's flash.

A file is read whole, its size is limited, and nothing in it is executed. What comes out is sorted, does not
overlap, lies in flash, and leaves out what is erased anyway:

    read_segments(Path("neuroflight.hex"))  ->  (Segment(0x08000000, boot part), Segment(0x08020000, bank A))

`.bin` has no addresses: it is taken to begin at the start of flash, as `neuroflight.bin` does, and the erased
stretches that lie between its parts are left out, so that settings and policy slots there are not touched.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from elftools.common.exceptions import ELFError
from elftools.construct import ConstructError
from elftools.elf.elffile import ELFFile

from neuroflight.toolchain.contract import FLASH_BASE, FLASH_BYTES, FLASH_SECTORS, Region
from neuroflight.toolchain.errors import LinkError
from neuroflight.toolchain.files import file_size

ERASED = 0xFF
GAP_BYTES = 1024  # erased bytes in a row that a .bin may hold without being split
ELF_BYTES_MAX = 8 << 20  # an image with its debug information takes 0.8 MB
HEX_BYTES_MAX = 4 * FLASH_BYTES  # 16 bytes of data take 44 characters
FORMS = ".elf, .hex or .bin"
_ELF_MAGIC = b"\x7fELF"
_MACHINE = "ARM"
_HEX_RECORD_MAX = 1 + 2 * (5 + 255)  # characters


@dataclass(frozen=True)
class Segment:
    """Bytes that belong into flash at `address`."""

    address: int
    data: bytes

    @property
    def end(self) -> int:
        """The address behind it."""
        return self.address + len(self.data)


def content_of(segments: Sequence[Segment], region: Region) -> bytes:
    """Return the bytes that the segments put into a region, from its start on; none where that is nothing."""
    content = bytearray()
    for segment in segments:
        start, end = max(segment.address, region.address), min(segment.end, region.address + region.size)
        if start < end:
            content = content.ljust(end - region.address, bytes([ERASED]))
            data = segment.data[start - segment.address : end - segment.address]
            content[start - region.address : end - region.address] = data
    return bytes(content)


def read_segments(path: Path) -> tuple[Segment, ...]:
    """Read the segments of an image file, by its suffix. Raises LinkError if it is no image."""
    limits = {".elf": ELF_BYTES_MAX, ".hex": HEX_BYTES_MAX, ".bin": FLASH_BYTES}
    suffix = path.suffix.lower()
    if suffix not in limits:
        raise LinkError(f"{path}: got a file of kind {path.suffix!r}, expected an image: {FORMS}")
    content = _read(path, limits[suffix])
    if suffix != ".elf" and content.startswith(_ELF_MAGIC):
        raise LinkError(f"{path}: got an ELF file, expected {suffix[1:]} by its name; rename it to .elf")
    try:
        segments = _PARSERS[suffix](content)
        return joined(segments)
    except ValueError as error:
        raise LinkError(f"{path}: {error}; build it anew or name another image") from None


def elf_segments(content: bytes) -> tuple[Segment, ...]:
    """Return the loadable parts of an ELF file for an ARM processor. Raises ValueError for any other file."""
    try:
        elf = ELFFile(io.BytesIO(content))
        if elf.elfclass != 32 or elf.get_machine_arch() != _MACHINE:
            raise ValueError(
                f"got a program of {elf.elfclass} bits for {elf.get_machine_arch()}, expected one of 32 bits "
                f"for {_MACHINE}"
            )
        segments = []
        for header in elf.iter_segments("PT_LOAD"):
            offset, size = header["p_offset"], header["p_filesz"]
            if offset + size > len(content):
                raise ValueError(f"got an ELF file of {len(content)} bytes that ends before its contents")
            if size:
                segments.append(Segment(header["p_paddr"], content[offset : offset + size]))
        return tuple(segments)
    except (ELFError, ConstructError, ArithmeticError, LookupError, UnicodeError, TypeError) as error:
        why = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(f"got no whole ELF file ({why[:80]}), expected one") from None


def hex_segments(content: bytes) -> tuple[Segment, ...]:
    """Return the data of an Intel HEX file. Raises ValueError that names the wrong line."""
    segments: list[Segment] = []
    base, ended = 0, False
    for number, line in enumerate(content.split(b"\n"), 1):
        line = line.strip()
        if not line:
            continue
        if ended:
            raise ValueError(f"line {number}: got a record behind the end record, expected nothing")
        kind, offset, data = _hex_record(number, line)
        match kind:
            case 0:
                segments.append(Segment(base + offset, data))
            case 1:
                ended = True
            case 2 if len(data) == 2:
                base = int.from_bytes(data, "big") << 4
            case 4 if len(data) == 2:
                base = int.from_bytes(data, "big") << 16
            case 3 | 5 if len(data) == 4:
                pass  # start address, which the vectors contain as well
            case _:
                raise ValueError(f"line {number}: got a record of kind {kind} with {len(data)} bytes")
    if not ended:
        raise ValueError("got an Intel HEX file without an end record, expected a whole one")
    return tuple(segments)


def _hex_record(number: int, line: bytes) -> tuple[int, int, bytes]:
    """Return kind, address below 64 KiB and data of a record."""
    if not line.startswith(b":") or len(line) > _HEX_RECORD_MAX:
        raise ValueError(f"line {number}: got no record of Intel HEX, expected one that begins with ':'")
    try:
        record = bytes.fromhex(line[1:].decode("ascii"))
    except (UnicodeDecodeError, ValueError):
        raise ValueError(f"line {number}: got characters that are no hexadecimal digits") from None
    if len(record) < 5 or len(record) != 5 + record[0]:
        raise ValueError(f"line {number}: got a record of {len(record)} bytes that says another length")
    if sum(record) & 0xFF:
        raise ValueError(f"line {number}: got a wrong checksum")
    return record[3], int.from_bytes(record[1:3], "big"), record[4:-1]


def bin_segments(content: bytes, base: int = FLASH_BASE) -> tuple[Segment, ...]:
    """Return the content of a plain copy of flash from `base` on, without longer erased stretches.

    Raises ValueError if it is empty.
    """
    segments, at = [], 0
    for gap in re.finditer(b"\xff{%d,}" % GAP_BYTES, content):
        if gap.start() > at:
            segments.append(Segment(base + at, content[at : gap.start()]))
        at = gap.end()
    if at < len(content):
        segments.append(Segment(base + at, content[at:]))
    return tuple(segments)


def joined(segments: Iterable[Segment]) -> tuple[Segment, ...]:
    """Sort segments by address and join adjacent ones.

    Raises ValueError for an empty list, bytes outside flash, or an address that two segments claim.
    """
    parts: list[list[Segment]] = []
    for segment in sorted((s for s in segments if s.data), key=lambda s: s.address):
        if segment.address < FLASH_BASE or segment.end > FLASH_BASE + FLASH_BYTES:
            raise ValueError(
                f"got {len(segment.data)} bytes for 0x{segment.address:08X}, expected all of them within "
                f"the board's flash, 0x{FLASH_BASE:08X} to 0x{FLASH_BASE + FLASH_BYTES - 1:08X}"
            )
        end = parts[-1][-1].end if parts else 0
        if segment.address < end:
            raise ValueError(f"got two contents for address 0x{segment.address:08X}, expected one")
        if segment.address == end:
            parts[-1].append(segment)
        else:
            parts.append([segment])
    if not parts:
        raise ValueError("got an image without content, expected bytes for flash")
    return tuple(Segment(part[0].address, b"".join(s.data for s in part)) for part in parts)


def touched_sectors(segments: Iterable[Segment]) -> tuple[int, ...]:
    """Return the numbers of the flash sectors that hold a byte of the segments, ascending."""
    return tuple(
        number
        for number, sector in enumerate(FLASH_SECTORS)
        if any(s.address < sector.address + sector.size and sector.address < s.end for s in segments)
    )


def _read(path: Path, limit: int) -> bytes:
    try:
        size = file_size(path)  # raises for a pipe or a device, which would not end
        if not 0 < size <= limit:
            raise LinkError(
                f"{path}: got {size} bytes, expected an image of 1 to {limit}; build it with "
                f"`make firmware`, or name another one"
            )
        with path.open("rb") as file:
            return file.read(limit)
    except OSError as error:
        raise LinkError(
            f"{path}: {error.strerror or error}; build it with `make firmware`, or name another image"
        ) from None


_PARSERS = {".elf": elf_segments, ".hex": hex_segments, ".bin": bin_segments}
