"""Makes a board's image from the linked one, which is the same for all boards.

    python -m neuroflight.toolchain.image.stamp LINKED TABLE ELF

TABLE is what `toolchain.boards.description` made of the board: the image gets it, and its boot part a copy.
Behind it there may be a gyro chip's configuration (`toolchain.boards.gyro_file`), for the image alone.
The header (toolchain/contract/image_format.py) gets the board's name, the bank that the image lies in, the
number of its build and the CRC-32. The number is made of bank A's content and of the policy that comes with
it in a slot, which gets it too; bank B's image takes it over with `--build-of`, so that all are known as one
build. Stamping twice changes nothing.
"""

from __future__ import annotations

import argparse
import hashlib
import struct
import sys
from dataclasses import dataclass
from pathlib import Path

from elftools.common.exceptions import ELFError
from elftools.elf.elffile import ELFFile

from neuroflight.toolchain.boards.description import BOARD_BYTES, unpack
from neuroflight.toolchain.contract import (
    FLASH_BANKS,
    FLASH_POLICY_SLOTS,
    GYRO_FILE_BYTES,
    IMAGE_BOARD_BYTES,
    IMAGE_BUILD_BYTES,
    IMAGE_TABLE_OFFSET,
    Region,
    bound_policy,
    image_checksum,
    image_field_offset,
    image_header,
)
from neuroflight.toolchain.errors import BuildError, NeuroflightError, WiringError
from neuroflight.toolchain.files import write_bytes

GYRO_FILE_OFFSET = IMAGE_TABLE_OFFSET + (BOARD_BYTES + 7) // 8 * 8  # behind the description (image.ld)
BOOT_TABLE = ".boot_board"  # the boot part's section for its copy of the description


@dataclass(frozen=True)
class _Span:
    """Bytes of the file that lie in a region: from `offset` of it, at `position` of the file."""

    offset: int
    position: int
    size: int


def stamp(linked: Path, table: bytes, out: Path, build_of: Path | None = None) -> None:
    """Write the ELF `linked` as the image of the board that `table` describes.

    table: the description, and behind it what the gyro chip needs, or nothing. build_of: an ELF whose build's
    number is used. Raises BuildError if `linked` is no image for a bank, and WiringError if `table` is no
    description.
    """
    table, gyro_file = table[:BOARD_BYTES], table[BOARD_BYTES:]
    if len(gyro_file) not in (0, GYRO_FILE_BYTES):
        raise WiringError(f"{len(gyro_file)} bytes behind the description, expected 0 or {GYRO_FILE_BYTES}")
    board = unpack(table)["name"].encode()
    bank, spans = _bank_spans(linked)
    file = bytearray(linked.read_bytes())
    image: bytearray = _image(file, spans)
    _check(linked, image, spans)
    slot = _spans(linked, FLASH_POLICY_SLOTS[0])
    policy = bound_policy(_image(file, slot), bytes(IMAGE_BUILD_BYTES)) if slot else b""
    _put(image, "bank", struct.pack("<B", bank))
    _put(image, "board", board.ljust(IMAGE_BOARD_BYTES, b"\0"))
    image[IMAGE_TABLE_OFFSET : IMAGE_TABLE_OFFSET + len(table)] = table
    image[GYRO_FILE_OFFSET : GYRO_FILE_OFFSET + GYRO_FILE_BYTES] = gyro_file.ljust(GYRO_FILE_BYTES, b"\0")
    if (boot := _section(linked, BOOT_TABLE)) is not None:
        file[boot : boot + len(table)] = table
    if build_of is None:
        _put(image, "build", bytes(IMAGE_BUILD_BYTES))
        _put(image, "crc", bytes(4))
        build = hashlib.sha256(image + policy).digest()[:IMAGE_BUILD_BYTES]
    else:
        at = image_field_offset("build")
        build = bytes(_image(build_of.read_bytes(), _bank_spans(build_of)[1])[at : at + IMAGE_BUILD_BYTES])
    _put(image, "build", build)
    _put(image, "crc", struct.pack("<I", image_checksum(image)))
    _store(file, spans, image)
    if policy:
        _store(file, slot, bound_policy(policy, build))
    write_bytes(out, bytes(file))


def _store(file: bytearray, spans: tuple[_Span, ...], content: bytes | bytearray) -> None:
    for span in spans:
        file[span.position : span.position + span.size] = content[span.offset : span.offset + span.size]


def _bank_spans(path: Path) -> tuple[int, tuple[_Span, ...]]:
    """Return the bank that the ELF loads into, and the spans of its bytes that do."""
    for bank, region in enumerate(FLASH_BANKS):
        if spans := _spans(path, region):
            return bank, spans
    raise BuildError(
        f"cannot stamp {path}: nothing of it lies in a bank; link it with bank_a.ld or bank_b.ld"
    )


def _spans(path: Path, region: Region) -> tuple[_Span, ...]:
    """Return the spans of the ELF that it loads into that region."""
    try:
        with path.open("rb") as stream:
            loads = [
                (s["p_paddr"], s["p_offset"], s["p_filesz"]) for s in ELFFile(stream).iter_segments("PT_LOAD")
            ]
    except (OSError, ELFError) as error:
        raise BuildError(f"cannot stamp {path}: {error}") from error
    return tuple(
        _Span(address - region.address, position, size)
        for address, position, size in loads
        if size and region.address <= address < region.address + region.size
    )


def _section(path: Path, name: str) -> int | None:
    """Return where in the file that section of the ELF begins; None: it has none."""
    with path.open("rb") as stream:
        section = ELFFile(stream).get_section_by_name(name)
        return None if section is None else int(section["sh_offset"])


def _image(file: bytes | bytearray, spans: tuple[_Span, ...]) -> bytearray:
    image = bytearray(b"\xff" * max(span.offset + span.size for span in spans))
    for span in spans:
        image[span.offset : span.offset + span.size] = file[span.position : span.position + span.size]
    return image


def _check(path: Path, image: bytearray, spans: tuple[_Span, ...]) -> None:
    header = image_header(image)
    if header is None or header.image_bytes != len(image):
        told = "it has no header" if header is None else f"its header says {header.image_bytes} bytes"
        raise BuildError(
            f"cannot stamp {path}: {told}, it has {len(image)} bytes; "
            "the linker script puts something behind image_end"
        )
    if sum(span.size for span in spans) != len(image):
        raise BuildError(
            f"cannot stamp {path}: there are gaps between its sections, which each tool would fill as it "
            "likes; align the ends of the sections in the linker script"
        )


def _put(image: bytearray, name: str, value: bytes) -> None:
    at = image_field_offset(name)
    image[at : at + len(value)] = value


def main(arguments: list[str]) -> int:
    """Stamp the file that is named. Returns 0, or 1 after one line on stderr."""
    parser = argparse.ArgumentParser(prog="stamp", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("linked", type=Path, metavar="LINKED")
    parser.add_argument("table", type=Path, metavar="TABLE")
    parser.add_argument("elf", type=Path, metavar="ELF")
    parser.add_argument("--build-of", type=Path, metavar="ELF")
    args = parser.parse_args(arguments)
    try:
        stamp(args.linked, args.table.read_bytes(), args.elf, args.build_of)
    except NeuroflightError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
