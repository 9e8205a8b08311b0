"""Image files: which image a file holds for which bank, its policy, and whether each is whole.

    .nfi                 both banks' images of a build and their policy: what an update needs
    .elf, .hex, .bin     the image of bank A with its policy (neuroflight-b.elf: of bank B, without), with or
                         without the boot part

Nothing of a file is executed; its size is limited before it is read.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from neuroflight.flash.rom.image_check import policy_for
from neuroflight.flash.rom.segments import Segment, content_of, read_segments
from neuroflight.toolchain.contract import (
    FLASH_BANKS,
    FLASH_POLICY_SLOTS,
    IMAGE_HEADER_OFFSET,
    IMAGE_LAYOUT,
    IMAGE_TAIL_BYTES,
    ImageHeader,
    PolicyHeader,
    bound_policy,
    image_checksum,
    image_header,
)
from neuroflight.toolchain.errors import ImageError
from neuroflight.toolchain.files import file_size

BOTH = "neuroflight.nfi"  # of the file beside a build's other files
SUFFIXES = (".nfi", ".elf", ".hex", ".bin")
NFI_BYTES_MAX = sum(part.size for part in (*FLASH_BANKS, FLASH_POLICY_SLOTS[0]))
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
        """SHA-256 of the image as it lies in flash."""
        return hashlib.sha256(self.data).digest()


@dataclass(frozen=True)
class Policy:
    """The whole policy that comes with the images of a build."""

    file: str  # that it is from
    header: PolicyHeader
    data: bytes  # header.total_bytes of them, with the number 0

    @property
    def sha256(self) -> str:
        """SHA-256 of its ONNX file."""
        return self.header.policy_sha256

    @property
    def size(self) -> int:
        """Bytes of its blob."""
        return len(self.data)

    @property
    def build(self) -> bytes:
        """Build of the images that it comes with; no other image flies it."""
        return self.header.build

    def blob(self, sequence: int) -> bytes:
        """Return the policy's bytes with that sequence number."""
        return bound_policy(self.data, self.build, sequence)


@dataclass(frozen=True)
class ImageFile:
    """The images of one build that a file holds: one or two, of different banks."""

    path: Path
    images: tuple[Image, ...]
    policy: Policy | None  # None: the file has none

    @property
    def build(self) -> bytes:
        """Identity of the build, the same in both banks."""
        return self.images[0].header.build

    @property
    def header(self) -> ImageHeader:
        """One of its images': board, version and build are the same in all."""
        return self.images[0].header

    def of_bank(self, bank: int) -> Image | None:
        """Return the image for that bank, or None."""
        return next((image for image in self.images if image.bank == bank), None)


def bank_name(bank: int) -> str:
    """Return the name of a bank for messages."""
    return f"bank {'AB'[bank]}" if bank < len(FLASH_BANKS) else f"bank number {bank}"


def read_images(path: Path) -> ImageFile:
    """Read the images of a file and their policy, checking header, size, bank and CRC of each.

    Raises ImageError or LinkError for a file that is no image or has another layout.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise ImageError(
            f"{path}: got a file of kind {path.suffix!r}, expected an image: "
            f"{', '.join(SUFFIXES)}; name the {BOTH} of a build"
        )
    if suffix == ".nfi":
        images, rest = _split(path, _read(path))
        if not rest:
            raise ImageError(f"{path}: it ends behind its images, expected their policy; {_MEND}")
    else:
        segments = read_segments(path)
        images, rest = _of_banks(path, segments), content_of(segments, FLASH_POLICY_SLOTS[0])
    first = images[0].header
    for image in images[1:]:
        if (image.header.build, image.header.board) != (first.build, first.board):
            raise ImageError(f"{path}: its images are of different builds, expected those of one; {_MEND}")
    return ImageFile(path, images, _policy(path, first, rest) if rest else None)


def image_for(file: ImageFile, bank: int) -> tuple[Image, Policy]:
    """Return the file's image for that bank and its policy, or those of the same build's .nfi beside it.

    Raises ImageError if neither has them.
    """
    if (image := file.of_bank(bank)) is not None and file.policy is not None:
        return image, file.policy
    have = file.images[0]
    beside = file.path.with_name(BOTH)
    why = f"no {BOTH} lies beside it"
    if beside.is_file():
        both = read_images(beside)
        found, same, policy = both.of_bank(bank), both.of_bank(have.bank), both.policy
        if found is not None and policy is not None and same is not None and same.data == have.data:
            return found, policy
        why = f"the {BOTH} beside it is of another build"
    lacks = "its policy" if have.bank == bank else f"that for {bank_name(bank)}"
    raise ImageError(
        f"{file.path}: it holds the image for {bank_name(have.bank)} alone and the board needs {lacks}, "
        f"{why}; give the build's {BOTH}, which holds all of them"
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


def _split(path: Path, content: bytes) -> tuple[tuple[Image, ...], bytes]:
    """Split `content` into the images at its start and the bytes behind them."""
    images: list[Image] = []
    while not images or image_header(content) is not None:
        image = _checked(path, content)
        if any(image.bank == other.bank for other in images):
            raise ImageError(f"{path}: got two images for {bank_name(image.bank)}, expected one; {_MEND}")
        images.append(image)
        content = content[image.header.image_bytes :]
    return tuple(images), content


def _of_banks(path: Path, segments: Sequence[Segment]) -> tuple[Image, ...]:
    """Return the images that the segments put into the banks."""
    images = []
    for bank, region in enumerate(FLASH_BANKS):
        if not (content := content_of(segments, region)):
            continue
        image = _checked(path, content)
        if image.bank != bank:
            raise ImageError(
                f"{path}: it lies in {bank_name(bank)} and its header says {bank_name(image.bank)}; {_MEND}"
            )
        images.append(image)
    if not images:
        raise ImageError(f"{path}: nothing of it lies in a bank, expected an image of this board; {_MEND}")
    return tuple(images)


def _checked(path: Path, content: bytes) -> Image:
    """Check the image at the start of `content`."""
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


def _policy(path: Path, image: ImageHeader, content: bytes) -> Policy:
    """Check the policy at the start of `content`, which `image` has to be able to fly."""
    try:
        header, data = policy_for(image, content)
    except ValueError as error:
        raise ImageError(f"{path}: behind its images: {error}; {_MEND}") from None
    return Policy(path.name, header, data)
