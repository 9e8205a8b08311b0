"""Card images as a computer makes them (mkfs.vfat, mtools), and what it finds on them afterwards."""

from __future__ import annotations

import os
import shutil
import struct
import subprocess
from functools import cache
from pathlib import Path

BLOCK = 512
SIZE = 64 << 20  # of a card whose clusters have a block: about the least that is FAT32


def run(*command: str | Path) -> bytes:
    """Run a program of another house; its output. Raises CalledProcessError."""
    found = shutil.which(str(command[0]), path=os.environ["PATH"] + ":/usr/sbin:/sbin")
    assert found, f"{command[0]} is missing; run: make peers"
    return subprocess.run([found, *command[1:]], check=True, capture_output=True).stdout


@cache
def zeros(size: int) -> bytes:
    return bytes(size)


def make_image(
    path: Path, files: dict[str, bytes | int], *, start: int = 0, cluster_sectors: int = 1
) -> Path:
    """A card formatted FAT32 with `files` in its root directory: contents, or sizes of empty ones [bytes].

    start: block of the file system within the first MiB, behind a partition table; 0: without one.
    """
    size = SIZE * cluster_sectors
    with path.open("wb") as file:
        file.truncate(size + (1 << 20 if start else 0))
    options = ("-F", "32", "-s", str(cluster_sectors), "--offset", str(start))
    run("mkfs.vfat", *options, path, str(size // 1024))
    if start:
        entry = struct.pack("<B3sB3sII", 0, b"\0\0\0", 0x0C, b"\0\0\0", start, size // BLOCK)
        with path.open("r+b") as file:
            file.seek(446)
            file.write(entry + bytes(48) + b"\x55\xaa")
    for name, content in files.items():
        source = path.with_name(f"{name}.new")
        source.write_bytes(zeros(content) if isinstance(content, int) else content)
        run("mcopy", "-i", f"{path}@@{start * BLOCK}", source, f"::{name}")
        source.unlink()
    return path


def copy_image(source: Path, path: Path) -> Path:
    """Another card with the same content; holes stay holes."""
    run("cp", "--sparse=always", source, path)
    return path


def content(path: Path, name: str, start: int = 0) -> bytes:
    """A file of the card, as a computer reads it."""
    return run("mcopy", "-i", f"{path}@@{start * BLOCK}", f"::{name}", "-")


def check(path: Path) -> None:
    """The file system is sound. Raises CalledProcessError."""
    run("fsck.vfat", "-n", path)


class Image:
    """The bytes of a card, read as they are asked for."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __getitem__(self, place: slice) -> bytes:
        with self._path.open("rb") as file:
            file.seek(place.start)
            return file.read(place.stop - place.start)


class Volume:
    """A FAT32 file system, read without a doubt about what it says of itself."""

    def __init__(self, path: Path) -> None:
        self.image = Image(path)
        start = 0
        if int.from_bytes(self.image[11:13], "little") != BLOCK:
            start = int.from_bytes(self.image[454:458], "little")
        boot = self.image[start * BLOCK : (start + 1) * BLOCK]
        self.cluster_blocks = boot[13]
        reserved, fats = int.from_bytes(boot[14:16], "little"), boot[16]
        self.fat = start + reserved
        self.data = self.fat + fats * int.from_bytes(boot[36:40], "little")
        self.root = int.from_bytes(boot[44:48], "little") & 0x0FFFFFFF

    def chain(self, cluster: int, most: int) -> list[int]:
        """The clusters from `cluster` on, `most` at most, up to where a circle begins anew."""
        found: dict[int, None] = {}
        while 2 <= cluster < 0x0FFFFFF8 and len(found) < most and cluster not in found:
            found[cluster] = None
            at = self.fat * BLOCK + 4 * cluster
            cluster = int.from_bytes(self.image[at : at + 4], "little") & 0x0FFFFFFF
        return list(found)

    def blocks(self, clusters: list[int]) -> list[int]:
        """The blocks of the card in `clusters`."""
        starts = [self.data + (cluster - 2) * self.cluster_blocks for cluster in clusters]
        return [start + i for start in starts for i in range(self.cluster_blocks)]

    def directory(self) -> set[int]:
        """Blocks of the root directory."""
        return set(self.blocks(self.chain(self.root, 1000)))

    def entries(self) -> list[tuple[int, bytes]]:
        """Where each entry of the root directory stands in the image, and what it is."""
        at = [block * BLOCK + 32 * i for block in self.blocks(self.chain(self.root, 1000)) for i in range(16)]
        return [(place, self.image[place : place + 32]) for place in at]

    def file(self, entry: bytes) -> list[int]:
        """Blocks of a file, those that its size covers."""
        size = int.from_bytes(entry[28:32], "little")
        count = -(-size // BLOCK // self.cluster_blocks)
        first = int.from_bytes(entry[26:28] + entry[20:22], "little") & 0x0FFFFFFF
        return self.blocks(self.chain(first, count))[: size // BLOCK]


def places(path: Path, names: tuple[str, ...]) -> set[int]:
    """The blocks of the card that belong to these files."""
    volume = Volume(path)
    wanted = {name.replace(".", "").encode().ljust(11) for name in names}
    return {
        block
        for _, entry in volume.entries()
        if entry[:11] in wanted and entry[11] != 0x0F
        for block in volume.file(entry)
    }
