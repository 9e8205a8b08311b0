"""DfuSe files (ST UM0391), for USB DFU through the chip's ROM.

    python -m neuroflight.toolchain.image.dfu ELF DFU

A file is a prefix, one target with an element for each segment, and the suffix of USB DFU 1.1 with its CRC.
dfu-util and ST's own tools erase only sectors that an element touches, so that settings stay.
All numbers are little-endian.
"""

from __future__ import annotations

import argparse
import struct
import sys
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from elftools.common.exceptions import ELFError
from elftools.elf.elffile import ELFFile

from neuroflight.toolchain.errors import BuildError, NeuroflightError
from neuroflight.toolchain.files import write_bytes

VENDOR_ID, PRODUCT_ID = 0x0483, 0xDF11  # STMicroelectronics, device in DFU mode
DEVICE_VERSION = 0xFFFF  # any
DFUSE_VERSION = 0x011A  # in place of USB DFU's own 0x0100
ALTERNATE_FLASH = 0  # the ROM's alternate setting for its internal flash
TARGET_NAME = b"Neuroflight"
_PREFIX = "<5sBIB"  # signature, version, bytes of the file, targets
_TARGET = "<6sBI255sII"  # signature, alternate setting, is named, name, bytes behind this, elements
_ELEMENT = "<II"  # address, bytes
_SUFFIX = "<HHHH3sB"  # device, product, vendor, version, "UFD", bytes of the suffix; then its CRC
_CRC_BYTES = 4
_WORD_BYTES = 4


class Segment(Protocol):
    """Bytes that belong at an address."""

    @property
    def address(self) -> int: ...

    @property
    def data(self) -> bytes: ...


@dataclass(frozen=True)
class Loaded:
    """Bytes that an ELF loads at an address."""

    address: int
    data: bytes


def dfu_file(segments: Sequence[Segment]) -> bytes:
    """Encode the DfuSe file that writes `segments` to flash."""
    elements = b"".join(
        struct.pack(_ELEMENT, segment.address, len(segment.data)) + segment.data for segment in segments
    )
    target = struct.pack(_TARGET, b"Target", ALTERNATE_FLASH, 1, TARGET_NAME, len(elements), len(segments))
    suffix_bytes = struct.calcsize(_SUFFIX) + _CRC_BYTES
    size = struct.calcsize(_PREFIX) + len(target) + len(elements) + suffix_bytes
    content = struct.pack(_PREFIX, b"DfuSe", 1, size, 1) + target + elements
    content += struct.pack(
        _SUFFIX, DEVICE_VERSION, PRODUCT_ID, VENDOR_ID, DFUSE_VERSION, b"UFD", suffix_bytes
    )
    return content + struct.pack("<I", ~zlib.crc32(content) & 0xFFFFFFFF)


def loaded_parts(path: Path) -> tuple[Loaded, ...]:
    """Read the parts that the ELF `path` loads into flash, by address, adjacent ones joined, in whole words.

    Raises BuildError if it is no ELF.
    """
    parts: list[tuple[int, bytes]] = []
    try:
        with path.open("rb") as stream:
            loads = [(s["p_paddr"], s.data()) for s in ELFFile(stream).iter_segments("PT_LOAD")]
    except (OSError, ELFError) as error:
        raise BuildError(f"cannot make a .dfu of {path}: {error}") from error
    for address, data in sorted(load for load in loads if load[1]):
        if parts and parts[-1][0] + len(parts[-1][1]) == address:
            address, data = parts[-1][0], parts.pop()[1] + data
        parts.append((address, data))
    return tuple(Loaded(address, data + -len(data) % _WORD_BYTES * b"\xff") for address, data in parts)


def main(arguments: list[str]) -> int:
    """Write the second file named from the first. Returns 0, or 1 after one line on stderr."""
    parser = argparse.ArgumentParser(prog="dfu", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("elf", type=Path)
    parser.add_argument("dfu", type=Path)
    args = parser.parse_args(arguments)
    try:
        write_bytes(args.dfu, dfu_file(loaded_parts(args.elf)))
    except NeuroflightError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
