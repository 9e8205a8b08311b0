"""A card that the system has mounted: a folder."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from neuroflight.flash.card.fat32 import DirectoryEntry, Fat32
from neuroflight.flash.card.files import PIECE_BYTES, SECTOR, LogFile, is_blank, is_log_name
from neuroflight.toolchain.errors import CardError

UNFINISHED = ".NEW"  # instead of the suffix, until a file is whole


class FolderCard:
    """The root folder of a mounted FAT32 file system."""

    def __init__(self, folder: Path, device: Path | None) -> None:
        """device: the mounted device, read to see the files' pieces if that is allowed; None: unknown."""
        self.name, self._folder, self._device = str(folder), folder, device

    def files(self) -> list[LogFile]:
        """See Card."""
        paths = sorted(path for path in self._folder.iterdir() if is_log_name(path.name) and path.is_file())
        whole = self._wholeness()
        return [
            LogFile(path.name, size, is_blank(self.read(path.name, 0, SECTOR)), whole.get(path.name.upper()))
            for path in paths
            if (size := path.stat().st_size)
        ]

    def _wholeness(self) -> dict[str, bool]:
        """Return, by file name, whether the file lies in one piece; empty if the device cannot be read."""
        if self._device is None:
            return {}
        try:
            with self._device.open("rb") as device:
                system = Fat32(device, str(self._device))
                return {entry.name: _in_one_piece(system, entry) for entry in system.files()}
        except OSError:
            return {}

    def free_bytes(self) -> int:
        """See Card."""
        facts = os.statvfs(self._folder)
        return facts.f_bavail * facts.f_frsize

    def read(self, name: str, offset: int, count: int) -> bytes:
        """See Card."""
        with (self._folder / name).open("rb") as file:
            file.seek(offset)
            return file.read(count)

    def create(self, name: str, size: int, progress: Callable[[int], None]) -> None:
        """See Card."""
        path = self._folder / name
        if path.exists():
            raise CardError(f"{path}: it is there already, expected a new name; nothing was overwritten")
        aside = path.with_suffix(UNFINISHED)
        aside.unlink(missing_ok=True)  # left by an interrupted run
        try:
            with aside.open("xb") as file:
                _write_zeros(file.fileno(), size, progress)
            aside.rename(path)
        finally:
            aside.unlink(missing_ok=True)
        if self._wholeness().get(name.upper()) is False:
            path.unlink()
            raise in_pieces(self.name, name)

    def clear(self, name: str, progress: Callable[[int], None]) -> None:
        """See Card."""
        path = self._folder / name
        size = path.stat().st_size
        with path.open("r+b") as file:
            _write_zeros(file.fileno(), size, progress)


def _write_zeros(handle: int, size: int, progress: Callable[[int], None]) -> None:
    """Overwrite `size` bytes from the file's position on with zeros and wait until they are stored."""
    zeros, done = bytes(PIECE_BYTES), 0
    while done < size:
        done += os.write(handle, zeros[: size - done])
        progress(done)
    os.fsync(handle)


def _in_one_piece(system: Fat32, entry: DirectoryEntry) -> bool:
    return len(system.pieces(entry)) <= 1


def in_pieces(card: str, name: str) -> CardError:
    """Return the error for a new file that would not lie in one piece."""
    return CardError(
        f"{card}: {name} would lie in several pieces, expected one; it was removed again: the card's room is "
        "scattered, so copy what is on it, format it anew (`mkfs.vfat -F 32`) and repeat this"
    )
