"""Files for logs on a card: what they are called, which are empty, how many more there shall be."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from neuroflight.toolchain.contract import LOG_FILE_PREFIX, LOG_FILE_SUFFIX, LOG_NUMBER_MAX
from neuroflight.toolchain.errors import CardError

NAME = re.compile(rf"{LOG_FILE_PREFIX}(\d{{5}}){re.escape(LOG_FILE_SUFFIX)}", re.IGNORECASE)
SECTOR = 512  # bytes; the firmware looks at a file's first sector
BLANKS = (0x00, 0xFF)  # bytes of a sector without a log: written as zeros, or erased by the card
MEBIBYTE = 1 << 20
FILES_MAX = 64  # default
PIECE_BYTES = MEBIBYTE  # read, written or compared at a time

Progress = Callable[[str, int, int], None]  # action ("write", "compare", "clear"), bytes done, bytes in all


@dataclass(frozen=True)
class LogFile:
    """A file for logs as it is on the card."""

    name: str
    bytes: int
    blank: bool  # takes the next log
    whole: bool | None  # lies in one piece; None: unknown

    @property
    def number(self) -> int:
        """The number in its name; 0 without one."""
        found = NAME.fullmatch(self.name)
        return int(found[1]) if found else 0


class Card(Protocol):
    """A card that files for logs can be put on. Every method raises CardError or OSError."""

    name: str

    def files(self) -> list[LogFile]:
        """List the log files by name."""

    def free_bytes(self) -> int:
        """Return the number of free bytes."""

    def read(self, name: str, offset: int, count: int) -> bytes:
        """Read bytes of a file, fewer at its end."""

    def create(self, name: str, size: int, progress: Callable[[int], None]) -> None:
        """Create a file of zeros, whole or not at all. progress: called with the bytes written so far."""

    def clear(self, name: str, progress: Callable[[int], None]) -> None:
        """Overwrite all of a file with zeros, where it is."""


def is_blank(sector: bytes) -> bool:
    """Return True if `sector`, the first bytes of a file, is blank: no log begins with it."""
    return any(sector == bytes([blank]) * len(sector) for blank in BLANKS)


def is_log_name(name: str) -> bool:
    """Return True if a file of that name is a log file."""
    return NAME.fullmatch(name) is not None


@dataclass(frozen=True)
class NewFiles:
    """Log files that are to be created."""

    names: list[str]
    size: int  # bytes of each

    @property
    def bytes(self) -> int:
        """Total size of the files."""
        return len(self.names) * self.size


def plan_files(files: Sequence[LogFile], free: int, size: int, empty: int | None) -> NewFiles:
    """Plan the log files to create so that `empty` ones exist; None: enough to fill half of the free room.

    free: bytes that no file has. Raises CardError if the files do not fit.
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
    if first + missing - 1 > LOG_NUMBER_MAX:
        raise CardError(
            f"the names go up to {file_name(LOG_NUMBER_MAX)}, expected room behind the last one's"
        )
    return NewFiles([file_name(first + k) for k in range(missing)], size)


def file_name(number: int) -> str:
    """Return the name of the log file with that number."""
    return f"{LOG_FILE_PREFIX}{number:05d}{LOG_FILE_SUFFIX}"


def behind(progress: Progress, step: str, before: int, total: int) -> Callable[[int], None]:
    """Return a progress callback for one of several files; `before` of `total` bytes were done before it."""
    return lambda done: progress(step, before + done, total)


def carry_out(card: Card, plan: NewFiles, progress: Progress) -> list[LogFile]:
    """Create the planned files and return the files on the card afterwards.

    Raises CardError for a file that got no room in one piece: it and those behind it are not there.
    """
    for index, name in enumerate(plan.names):
        card.create(name, plan.size, behind(progress, "write", index * plan.size, plan.bytes))
    return card.files()
