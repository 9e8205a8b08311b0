"""A card that is not mounted: an image file or a device. mtools makes files there."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from neuroflight.flash.card.fat32 import Fat32
from neuroflight.flash.card.files import PIECE_BYTES, SECTOR, LogFile, is_blank, is_log_name
from neuroflight.flash.card.folder import in_pieces
from neuroflight.toolchain.errors import CardError

QUIET = {"MTOOLS_SKIP_CHECK": "1"}  # mtools rejects small FAT32 images, such as those of tests, as unusual
CREATE_S = 600.0  # for one file: a card writes 4 GB at 10 MB/s in 400 s


class ImageCard:
    """A FAT32 file system in an image file or on a device."""

    def __init__(self, path: Path) -> None:
        """Check that the file holds a FAT32 file system; raises CardError if not."""
        self.name, self._path = str(path), path
        with self._system() as system:
            self._offset = system.offset

    @contextmanager
    def _system(self) -> Iterator[Fat32]:
        """Open the file system as it is now."""
        with self._path.open("rb") as file:
            yield Fat32(file, self.name)

    def files(self) -> list[LogFile]:
        """See Card."""
        with self._system() as system:
            entries = sorted((e for e in system.files() if is_log_name(e.name)), key=lambda entry: entry.name)
            return [
                LogFile(
                    entry.name,
                    entry.bytes,
                    is_blank(system.read(entry, 0, SECTOR)),
                    len(system.pieces(entry)) <= 1,
                )
                for entry in entries
                if entry.bytes
            ]

    def free_bytes(self) -> int:
        """See Card."""
        with self._system() as system:
            return system.free_bytes()

    def read(self, name: str, offset: int, count: int) -> bytes:
        """See Card."""
        with self._system() as system:
            entry = next(entry for entry in system.files() if entry.name == name)
            return system.read(entry, offset, count)

    def create(self, name: str, size: int, progress: Callable[[int], None]) -> None:
        """See Card."""
        with tempfile.TemporaryDirectory() as folder:
            zeros = Path(folder) / name
            with zeros.open("wb") as file:
                file.truncate(size)  # a hole: it takes no room
            self._mtools("mcopy", "-D", "s", str(zeros), "::")  # -D s: a name that is there is skipped
        made = next((file for file in self.files() if file.name == name), None)
        if made is None or made.bytes != size:
            raise CardError(
                f"{self.name}: mcopy made no {name} of {size:,} bytes; try `fsck.vfat` on the card"
            )
        if not made.whole:
            self._mtools("mdel", f"::{name}")
            raise in_pieces(self.name, name)
        progress(size)

    def _mtools(self, program: str, *words: str) -> None:
        """Run an mtools program to its end. Ctrl-C does not interrupt it: half a file would stay."""
        if shutil.which(program) is None:
            raise CardError(
                f"{self.name}: mtools is not installed, expected {program} to make files in an image or on a "
                "device that is not mounted; install mtools, or mount the card and name its folder"
            )
        where = f"{self.name}@@{self._offset}"
        done = subprocess.run(
            [program, "-i", where, *words],
            env=os.environ | QUIET,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=CREATE_S,
            start_new_session=True,
            check=False,
        )
        if done.returncode:
            why = " ".join(done.stderr.split()) or f"exit code {done.returncode}"
            raise CardError(f"{self.name}: {program} says: {why[:300]}; try `fsck.vfat` on the card")

    def clear(self, name: str, progress: Callable[[int], None]) -> None:
        """See Card. Only bytes of that file are written."""
        with self._system() as system:
            entry = next(entry for entry in system.files() if entry.name == name)
            pieces = system.pieces(entry)
        zeros, done = bytes(PIECE_BYTES), 0
        with self._path.open("r+b") as file:
            for piece in pieces:
                file.seek(piece.at)
                for at in range(0, piece.bytes, PIECE_BYTES):
                    done += file.write(zeros[: piece.bytes - at])
                    progress(done)
            file.flush()
            os.fsync(file.fileno())
