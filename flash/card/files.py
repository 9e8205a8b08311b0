"""Files for logs on a card: what they are called, which are empty, how many more there shall be."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from neuroflight.toolchain.contract import LOG_FILE_PREFIX, LOG_FILE_SUFFIX
from neuroflight.toolchain.errors import CardError

NAME = re.compile(rf"{LOG_FILE_PREFIX}(\d{{5}}){re.escape(LOG_FILE_SUFFIX)}", re.IGNORECASE)
NUMBER_MAX = 99_999
SECTOR = 512  # bytes; the firmware looks at a file's first sector
BLANKS = (0x00, 0xFF)  # what a sector without a log is full of: written empty, erased by the card
MEBIBYTE = 1 << 20
FILE_BYTES = 64 * MEBIBYTE  # at 100 kB/s a flight of 11 minutes
FILE_BYTES_MAX = 4095 * MEBIBYTE  # FAT32 has 4 GB less one byte
FILES_MAX = 64  # unless told
PIECE_BYTES = MEBIBYTE  # that are read, written or compared at a time

Progress = Callable[[str, int, int], None]  # what is done ("write", "compare", "clear"), bytes, of so many


@dataclass(frozen=True)
class LogFile:
    """A file for logs as it is on the card."""

    name: str
    bytes: int
    blank: bool  # takes the next log
    whole: bool | None  # lies in one piece; None: cannot be seen from here

    @property
    def number(self) -> int:
        """That of its name, 0: none."""
        found = NAME.fullmatch(self.name)
        return int(found[1]) if found else 0


class Card(Protocol):
    """A card that files for logs can be put on. Every method raises CardError or OSError."""

    name: str

    def files(self) -> list[LogFile]:
        """The files for logs, by name."""

    def free_bytes(self) -> int:
        """What no file has."""

    def read(self, name: str, offset: int, count: int) -> bytes:
        """Bytes of a file, fewer at its end."""

    def create(self, name: str, size: int, progress: Callable[[int], None]) -> None:
        """A new file of that many zeros; whole, or not there. progress: gets the bytes written so far."""

    def clear(self, name: str, progress: Callable[[int], None]) -> None:
        """Overwrite all of a file with zeros, where it is."""


def is_blank(sector: bytes) -> bool:
    """Whether no log begins with `sector`, all or the first bytes of one."""
    return any(sector == bytes([blank]) * len(sector) for blank in BLANKS)


def is_log_name(name: str) -> bool:
    """Whether it is a file for logs."""
    return NAME.fullmatch(name) is not None


@dataclass(frozen=True)
class Plan:
    """Files that are to be made."""

    names: list[str]
    size: int  # bytes of each

    @property
    def bytes(self) -> int:
        """Of all."""
        return len(self.names) * self.size


def make_plan(files: Sequence[LogFile], free: int, size: int, empty: int | None) -> Plan:
    """What is missing to `empty` files that take a log; None: so many that they fill half of the room.

    free: bytes that no file has. Raises CardError where they find no room.
    """
    blank = [file for file in files if file.blank and file.whole is not False]
    room = free // size
    if empty is None:
        half = (free + sum(file.bytes for file in blank)) // 2 // size
        empty = min(max(half, 1), FILES_MAX)
    missing = max(0, empty - len(blank))
    if missing > room:
        raise CardError(
            f"{free // MEBIBYTE:,} MB are free, expected {missing * size // MEBIBYTE:,} MB for {missing} "
            f"files of {size // MEBIBYTE} MB; delete something, or give fewer --files or a smaller --size"
        )
    first = max((file.number for file in files), default=0) + 1
    if first + missing - 1 > NUMBER_MAX:
        raise CardError(f"the names go up to {file_name(NUMBER_MAX)}, expected room behind the last one's")
    return Plan([file_name(first + k) for k in range(missing)], size)


def file_name(number: int) -> str:
    """The name of a file for logs."""
    return f"{LOG_FILE_PREFIX}{number:05d}{LOG_FILE_SUFFIX}"


def behind(progress: Progress, step: str, before: int, total: int) -> Callable[[int], None]:
    """Progress of one of several files: `before` bytes of the `total` were done when it began."""
    return lambda done: progress(step, before + done, total)


def carry_out(card: Card, plan: Plan, progress: Progress) -> list[LogFile]:
    """Make the files. Returns what is on the card afterwards.

    Raises CardError for a file that got no room in one piece: it and those behind it are not there.
    """
    for index, name in enumerate(plan.names):
        card.create(name, plan.size, behind(progress, "write", index * plan.size, plan.bytes))
    return card.files()
