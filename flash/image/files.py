"""Image files: which image a file holds for which bank, and whether each is whole.

    .nfi                 both banks' images of a build, one behind the other: what an update needs
    .elf, .hex, .bin     the image of bank A (neuroflight-b.elf: of bank B), with or without the boot part

Nothing of a file is executed; its size is limited before it is read.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from flash.rom.segments import Segment, read_segments
from toolchain.contract import (
    FLASH_BANKS,
    IMAGE_HEADER_OFFSET,
    IMAGE_LAYOUT,
    IMAGE_TAIL_BYTES,
    ImageHeader,
    image_checksum,
    image_header,
)
from toolchain.errors import ImageError
from toolchain.files import file_size

BOTH = "neuroflight.nfi"  # beside the other files of a build
SUFFIXES = (".nfi", ".elf", ".hex", ".bin")
NFI_BYTES_MAX = sum(bank.size for bank in FLASH_BANKS)
_WORD_BYTES = 4
_MEND = "build it anew with `make firmware`, or name another file"


@dataclass(frozen=True)
class Image:
    """A whole image for one bank."""

    header: ImageHeader
    data: bytes  # header.image_bytes of them, from the bank's begin

    @property
    def bank(self) -> int:
        """0 for bank A, 1 for bank B."""
        return self.header.bank

    @property
    def sha256(self) -> bytes:
        """Of the image as it lies in flash."""
        return hashlib.sha256(self.data).digest()


@dataclass(frozen=True)
class ImageFile:
    """The images of one build that a file holds: one or two, of different banks."""

    path: Path
    images: tuple[Image, ...]

    @property
    def build(self) -> bytes:
        """What names the build, the same in both banks."""
        return self.images[0].header.build

    @property
    def header(self) -> ImageHeader:
        """One of its images': board, version and build are the same in all."""
        return self.images[0].header

    def of_bank(self, bank: int) -> Image | None:
        """The image for that bank; None: the file has none."""
        return next((image for image in self.images if image.bank == bank), None)


def bank_name(bank: int) -> str:
    """As people call it."""
    return f"bank {'AB'[bank]}" if bank < len(FLASH_BANKS) else f"bank number {bank}"


def read_images(path: Path) -> ImageFile:
    """The images in a file, each checked: header, size, bank and CRC.

    Raises ImageError or LinkError, one line, for what is none, and for one of another layout.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise ImageError(
            f"{path}: got a file of kind {path.suffix!r}, expected an image: "
            f"{', '.join(SUFFIXES)}; name the {BOTH} of a build"
        )
    images = _split(path, _read(path)) if suffix == ".nfi" else _of_banks(path, read_segments(path))
    first = images[0].header
    for image in images[1:]:
        if (image.header.build, image.header.board) != (first.build, first.board):
            raise ImageError(f"{path}: its images are of different builds, expected those of one; {_MEND}")
    return ImageFile(path, images)


def image_for(file: ImageFile, bank: int) -> Image:
    """The file's image for that bank, or that of the .nfi of the same build which lies beside it.

    Raises ImageError where neither is there.
    """
    if (image := file.of_bank(bank)) is not None:
        return image
    have = file.images[0]
    beside = file.path.with_name(BOTH)
    why = f"no {BOTH} lies beside it"
    if beside.is_file():
        both = read_images(beside)
        found, same = both.of_bank(bank), both.of_bank(have.bank)
        if found is not None and same is not None and same.data == have.data:
            return found
        why = f"the {BOTH} beside it is of another build"
    raise ImageError(
        f"{file.path}: it holds the image for {bank_name(have.bank)} alone and the board needs that for "
        f"{bank_name(bank)}, {why}; give the build's {BOTH}, which holds both"
    )


def _read(path: Path) -> bytes:
    try:
        size = file_size(path)  # raises for a pipe or a device, which would not end
        if not 0 < size <= NFI_BYTES_MAX:
            raise ImageError(f"{path}: got {size} bytes, expected images of 1 to {NFI_BYTES_MAX}; {_MEND}")
        with path.open("rb") as file:
            return file.read(NFI_BYTES_MAX)
    except OSError as error:
        raise ImageError(f"{path}: {error.strerror or error}; {_MEND}") from None


def _split(path: Path, content: bytes) -> tuple[Image, ...]:
    """The images that lie one behind the other."""
    images: list[Image] = []
    while content:
        image = _checked(path, content)
        if any(image.bank == other.bank for other in images):
            raise ImageError(f"{path}: got two images for {bank_name(image.bank)}, expected one; {_MEND}")
        images.append(image)
        content = content[image.header.image_bytes :]
    return tuple(images)


def _of_banks(path: Path, segments: Sequence[Segment]) -> tuple[Image, ...]:
    """What the segments put into each bank."""
    images = []
    for bank, region in enumerate(FLASH_BANKS):
        inside = [s for s in segments if region.address <= s.address < region.address + region.size]
        if not inside:
            continue
        content = bytearray(b"\xff" * region.size)
        for segment in inside:
            at = segment.address - region.address
            content[at : at + len(segment.data)] = segment.data
        image = _checked(path, bytes(content[: region.size]))
        if image.bank != bank:
            raise ImageError(
                f"{path}: it lies in {bank_name(bank)} and its header says {bank_name(image.bank)}; {_MEND}"
            )
        images.append(image)
    if not images:
        raise ImageError(f"{path}: nothing of it lies in a bank, expected an image of this board; {_MEND}")
    return tuple(images)


def _checked(path: Path, content: bytes) -> Image:
    """The image that `content` begins with."""
    header = image_header(content)
    if header is None:
        raise ImageError(f"{path}: got no header of a Neuroflight image, expected one; {_MEND}")
    if header.layout != IMAGE_LAYOUT:
        age = "older" if header.layout < IMAGE_LAYOUT else "newer"
        raise ImageError(
            f"{path}: its layout is {header.layout}, {age} than {IMAGE_LAYOUT}, which this tool writes; "
            f"{_MEND} or use this tool in the version that built it"
        )
    least = IMAGE_HEADER_OFFSET + len(header.raw)
    most = min(bank.size for bank in FLASH_BANKS) - IMAGE_TAIL_BYTES
    size = header.image_bytes
    if header.bank >= len(FLASH_BANKS) or not least <= size <= most or size % _WORD_BYTES:
        raise ImageError(
            f"{path}: its header tells of {size} bytes for {bank_name(header.bank)}, expected "
            f"{least} to {most} for bank A or B; {_MEND}"
        )
    if len(content) < size:
        raise ImageError(f"{path}: it ends after {len(content)} of an image's {size} bytes; {_MEND}")
    data = content[:size]
    if (crc := image_checksum(data)) != header.crc:
        raise ImageError(
            f"{path}: the CRC of its image is {crc:08x}, expected {header.crc:08x} as its header says: it is "
            f"damaged; {_MEND}"
        )
    return Image(header, data)
