"""The file behind an SD card: every block of it is a block of the card, written when the card has it."""

from __future__ import annotations

import errno
import fcntl
import os
import uuid
from pathlib import Path
from typing import Any

from neuroflight.sim.board.core.context import BoardError, Kept
from neuroflight.sim.board.devices.sd_card.registers import BLOCK, CAPACITY_UNIT
from neuroflight.toolchain.errors import LinkError
from neuroflight.toolchain.files import file_size

BYTES_MAX = 2 << 40  # of an SDXC card (Physical Layer Simplified Specification, 5.3.3)
_CHUNK = 2048  # blocks that are looked at together


class CardImage(Kept):
    """A raw image that a computer has formatted, with or without a partition table.

    This process has it alone.
    """

    def __init__(self, path: Path) -> None:
        """Open the file. Raises LinkError if it cannot be a card, cannot be written, or is in use."""
        self.path = path
        try:
            size = file_size(path)
            _check_size(path, size)
            self._file = os.open(path, os.O_RDWR | os.O_CLOEXEC)
        except FileNotFoundError:
            raise LinkError(
                f"card {path}: there is no such file; make one with `truncate -s 256M {path}` and "
                f"`mkfs.vfat -F 32 {path}`"
            ) from None
        except OSError as error:
            raise LinkError(f"card {path}: {error.strerror}; name an image that can be written") from None
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(self._file)
            raise LinkError(
                f"card {path}: another board has this card; wait for its end, or name a copy"
            ) from None
        self.blocks = size // BLOCK
        self._kept: str | None = None  # names what follows, once a snapshot was taken
        self._before: dict[int, bytes] = {}  # blocks that have changed since then, as they were
        self._now: dict[int, bytes] = {}  # and as they are

    def read(self, block: int, count: int = 1) -> bytes:
        return os.pread(self._file, count * BLOCK, block * BLOCK)

    def write(self, block: int, data: bytes) -> None:
        """Change one block. Raises LinkError if the computer cannot store it."""
        if self._kept is not None:
            if block not in self._before:
                self._before[block] = self.read(block)
            self._now[block] = data
        try:
            os.pwrite(self._file, data, block * BLOCK)
        except OSError as error:
            raise LinkError(f"card {self.path}: {error.strerror}; make room for what is written") from None

    def erase(self, first: int, last: int, value: int) -> None:
        """Set every byte of blocks `first` to `last` to `value`, where it is another one."""
        erased = bytes([value]) * BLOCK
        whole, start = erased * _CHUNK, first
        while start <= last:
            if value == 0:
                start = max(start, self._next_data(start))
            count = min(_CHUNK, last + 1 - start)
            there = self.read(start, count) if count > 0 else b""
            if there != whole[: len(there)]:
                for i in range(count):
                    if there[i * BLOCK : (i + 1) * BLOCK] != erased:
                        self.write(start + i, erased)
            start += max(count, 1)

    def _next_data(self, block: int) -> int:
        """Return the first block from `block` on that may be more than zeros: holes of the file are not."""
        try:
            return os.lseek(self._file, block * BLOCK, os.SEEK_DATA) // BLOCK
        except OSError as error:
            if error.errno == errno.ENXIO:
                return self.blocks
            return block  # a file system that does not know

    def close(self) -> None:
        if self._file >= 0:
            os.close(self._file)
        self._file = -1

    def state(self) -> Any:  # noqa: ANN401
        """Return what a later `restore` needs. From the first call on, changes are kept in memory as well."""
        if self._kept is None:
            self._kept = uuid.uuid4().hex
        return (self._kept, dict(self._now))

    def restore(self, state: Any) -> None:  # noqa: ANN401
        """Restore the content. Raises BoardError for a snapshot of another card."""
        kept, then = state
        if kept != self._kept:
            raise BoardError(
                f"card {self.path}: a snapshot of a board with another card; restore it into the board it "
                f"was taken of"
            )
        for block, now in list(self._now.items()):
            wanted = then.get(block, self._before[block])
            if wanted != now:
                self.write(block, wanted)


def _check_size(path: Path, size: int) -> None:
    if size % BLOCK:
        raise LinkError(
            f"card {path}: {size} bytes, expected a multiple of {BLOCK}, the size of a card's block; make "
            f"it so with `truncate -s %512 {path}`"
        )
    if size < CAPACITY_UNIT:
        raise LinkError(f"card {path}: {size} bytes, expected {CAPACITY_UNIT} or more; make a larger image")
    if size > BYTES_MAX:
        raise LinkError(f"card {path}: {size} bytes, expected {BYTES_MAX} at most; make a smaller image")
