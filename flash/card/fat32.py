"""Reads a FAT32 file system in an image file or on a device: its root directory, and where files lie.

Nothing is written here. Layouts: Microsoft's "FAT File System Specification" (2000) and the partition table
of a PC's first sector. Whatever a card says is checked before it is used: a damaged one is a CardError.
"""

from __future__ import annotations

import struct
from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import BinaryIO

from neuroflight.toolchain.errors import CardError

SECTOR = 512  # bytes; cards have no other
SIGNATURE = b"\x55\xaa"
PARTITIONS_AT, PARTITION_BYTES, PARTITIONS = 446, 16, 4
FAT32_TYPES, GPT_TYPE, EXFAT_TYPE = (0x0B, 0x0C), 0xEE, 0x07
ENTRY_BYTES = 32
CLUSTER_MASK, LAST_CLUSTER, BAD_CLUSTER, FIRST_CLUSTER = 0x0FFFFFFF, 0x0FFFFFF8, 0x0FFFFFF7, 2
FREE = 0
LONG_NAME, VOLUME, FOLDER = 0x0F, 0x08, 0x10  # attributes
DELETED, END_OF_FOLDER = 0xE5, 0x00
ROOT_BYTES_MAX = 2 << 20  # the specification's limit: 65,536 entries
TABLE_PIECE = 1 << 16  # entries of the table that are read at once
TABLE_PIECES_KEPT = 64  # 16 MB
FORMAT = (
    "format it as FAT32: `mkfs.vfat -F 32 DEVICE`, or the SD Association's formatter for cards up to 32 GB"
)


@dataclass(frozen=True)
class DirectoryEntry:
    """A file of the root directory."""

    name: str  # 8.3, in capitals
    bytes: int
    first: int  # cluster; 0: none


@dataclass(frozen=True)
class Piece:
    """Bytes of a file that lie side by side."""

    at: int  # byte in the image or on the device
    bytes: int


class Fat32:
    """The file system in `file`, which stays the caller's."""

    def __init__(self, file: BinaryIO, name: str) -> None:
        """Read the file system's layout; raises CardError if it is no FAT32. name: for messages."""
        self._file, self.name = file, name
        self.offset = _file_system_at(self._read(0, SECTOR), name)  # bytes from the start
        boot = self._read(self.offset, SECTOR)
        _check_kind(boot, name)
        sector, per_cluster, reserved, tables = struct.unpack_from("<HBHB", boot, 11)
        (total,) = struct.unpack_from("<I", boot, 32)
        (table_sectors,) = struct.unpack_from("<I", boot, 36)
        (self._root,) = struct.unpack_from("<I", boot, 44)
        data = reserved + tables * table_sectors  # sectors before the first cluster
        sound = sector == SECTOR and per_cluster and not per_cluster & (per_cluster - 1)
        if not (sound and reserved and tables in (1, 2) and table_sectors and total > data):
            raise CardError(
                f"{name}: its first sector makes no sense, expected a FAT32 file system; {FORMAT}"
            )
        self.cluster_bytes: int = per_cluster * SECTOR
        self._table = self.offset + reserved * SECTOR
        self._data = self.offset + data * SECTOR
        self._end = FIRST_CLUSTER + min((total - data) // per_cluster, table_sectors * SECTOR // 4 - 2)
        self._piece_of_table = lru_cache(TABLE_PIECES_KEPT)(self._read_table)

    def files(self) -> list[DirectoryEntry]:
        """List the root directory's files in its order. Raises CardError for a damaged one."""
        raw = b"".join(
            self._read(piece.at, piece.bytes) for piece in self._pieces(self._root, ROOT_BYTES_MAX)
        )
        found = []
        for at in range(0, len(raw), ENTRY_BYTES):
            entry = raw[at : at + ENTRY_BYTES]
            if entry[0] == END_OF_FOLDER:
                break
            if entry[0] == DELETED or entry[11] & (VOLUME | FOLDER):  # a part of a long name has VOLUME too
                continue
            base, suffix = entry[:8].decode("latin-1").rstrip(), entry[8:11].decode("latin-1").rstrip()
            high, low = struct.unpack_from("<H", entry, 20)[0], struct.unpack_from("<H", entry, 26)[0]
            size = struct.unpack_from("<I", entry, 28)[0]
            found.append(DirectoryEntry(f"{base}.{suffix}" if suffix else base, size, high << 16 | low))
        return found

    def pieces(self, entry: DirectoryEntry) -> list[Piece]:
        """Return the pieces of a file in order. Raises CardError if its chain of clusters is damaged."""
        if entry.bytes == 0:
            return []
        found = list(self._pieces(entry.first, entry.bytes))
        if sum(piece.bytes for piece in found) != entry.bytes:
            raise CardError(
                f"{self.name}: {entry.name} has fewer clusters than its {entry.bytes:,} bytes need; "
                "repair the file system (`fsck.vfat`), or format the card anew"
            )
        return found

    def read(self, entry: DirectoryEntry, offset: int, count: int) -> bytes:
        """Read bytes of a file, fewer at its end."""
        parts, at = [], 0
        for piece in self.pieces(entry):
            low, high = max(offset, at), min(offset + count, at + piece.bytes)
            if low < high:
                parts.append(self._read(piece.at + low - at, high - low))
            at += piece.bytes
        return b"".join(parts)

    def free_bytes(self) -> int:
        """Count the bytes of all free clusters."""
        last = (self._end - 1) // TABLE_PIECE
        free = sum(self._piece_of_table(number).count(FREE) for number in range(last + 1))
        return free * self.cluster_bytes

    def _pieces(self, cluster: int, count: int) -> Iterator[Piece]:
        """Yield the pieces of `count` bytes of the chain that begins at `cluster`, fewer at its end."""
        while count > 0 and cluster < LAST_CLUSTER:
            first, clusters = cluster, 0
            while cluster == first + clusters and clusters * self.cluster_bytes < count:
                clusters += 1
                cluster = self._next(cluster)
            length = min(clusters * self.cluster_bytes, count)
            yield Piece(self._data + (first - FIRST_CLUSTER) * self.cluster_bytes, length)
            count -= length

    def _next(self, cluster: int) -> int:
        """Return the cluster that follows `cluster` in its chain."""
        if not FIRST_CLUSTER <= cluster < self._end:
            raise CardError(
                f"{self.name}: a file lies in cluster {cluster}, expected {FIRST_CLUSTER}..{self._end - 1}; "
                "repair the file system (`fsck.vfat`), or format the card anew"
            )
        number, at = divmod(cluster, TABLE_PIECE)
        return int(self._piece_of_table(number)[at]) & CLUSTER_MASK

    def _read_table(self, number: int) -> array[int]:
        first = number * TABLE_PIECE
        entries = array("I")
        entries.frombytes(self._read(self._table + 4 * first, 4 * min(TABLE_PIECE, self._end - first)))
        return entries

    def _read(self, at: int, count: int) -> bytes:
        self._file.seek(at)
        data = self._file.read(count)
        if len(data) != count:
            raise CardError(
                f"{self.name}: it ends at byte {at + len(data):,}, expected at least {at + count:,}; "
                f"it is cut short, or no FAT32 file system"
            )
        return data


def _file_system_at(sector: bytes, name: str) -> int:
    """Find the first FAT32 file system: its offset [bytes]. Raises CardError for a table without one."""
    if _is_boot_sector(sector):
        return 0
    if sector[510:] != SIGNATURE:
        raise CardError(f"{name}: neither a file system nor a partition table is there; {FORMAT}")
    found = []
    for index in range(PARTITIONS):
        at = PARTITIONS_AT + index * PARTITION_BYTES
        kind, first = sector[at + 4], struct.unpack_from("<I", sector, at + 8)[0]
        if kind in FAT32_TYPES and first:
            return int(first) * SECTOR
        found += [kind] if kind else []
    if GPT_TYPE in found:
        raise CardError(
            f"{name}: it has a partition table of the kind GPT, expected an MBR or none; "
            "the firmware reads no other: the SD Association's formatter makes one"
        )
    kinds = ", ".join(f"0x{kind:02X}" for kind in found) or "none"
    hint = " (exFAT)" if EXFAT_TYPE in found else ""
    raise CardError(f"{name}: it has partitions of type {kinds}{hint}, expected FAT32 (0x0C); {FORMAT}")


def _is_boot_sector(sector: bytes) -> bool:
    """Return True if a file system of any kind begins here; otherwise it may be a partition table."""
    if sector[3:8] in (b"EXFAT", b"NTFS "):
        return True
    (bytes_per_sector,) = struct.unpack_from("<H", sector, 11)
    jump = sector[0] in (0xEB, 0xE9)
    return jump and sector[510:] == SIGNATURE and bytes_per_sector in (512, 1024, 2048, 4096)


def _check_kind(boot: bytes, name: str) -> None:
    """Raise CardError unless the file system that begins with `boot` is FAT32."""
    other = None
    if boot[3:8] in (b"EXFAT", b"NTFS "):
        other = "exFAT" if boot[3:8] == b"EXFAT" else "NTFS"
    elif _is_boot_sector(boot) and struct.unpack_from("<H", boot, 22)[0]:  # sectors of a FAT of 12 or 16 bits
        other = "FAT16 or FAT12"
    if other is not None:
        raise CardError(f"{name}: its file system is {other}, expected FAT32; {FORMAT}")
    if not _is_boot_sector(boot):
        raise CardError(f"{name}: no file system is where one should begin; {FORMAT}")
