"""The logs on a flash chip, read from its content by what flash_log.h says: an independent second reader."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

from neuroflight.sim.board.devices.flash_chip import FlashMemory

HEAD, BODY, MARK = 1, 2, 3
RECORD = struct.Struct("<4sIHHI")


@dataclass(frozen=True)
class Block:
    sequence: int
    kind: int
    index: int


def record(memory: FlashMemory, page: int) -> Block | None:
    """The record at a page's begin; None: there is no sound one."""
    magic, sequence, kind, index, crc = RECORD.unpack_from(memory.read(page))
    sound = magic == b"NFLG" and crc == zlib.crc32(memory.read(page)[: RECORD.size - 4])
    return Block(sequence, kind, index) if sound else None


def pages_of(memory: FlashMemory, block: int) -> bytes:
    """The log's bytes in a block, up to the first page that is not whole."""
    size, first = memory.kind.page_bytes, block * memory.kind.pages
    data = b""
    for page in range(first + 1, first + memory.kind.pages):
        content = memory.read(page)[:size]
        count, crc = struct.unpack("<HI", content[-6:])
        if count > size - 6 or crc != zlib.crc32(content[:-4]):
            break
        data += content[:count]
    return data


def logs_of(memory: FlashMemory) -> dict[int, bytes]:
    """The logs behind the last mark, by sequence."""
    blocks = [record(memory, block * memory.kind.pages) for block in range(memory.kind.blocks)]
    marked = max((block.sequence for block in blocks if block and block.kind == MARK), default=0)
    parts: dict[int, dict[int, bytes]] = {}
    for number, block in enumerate(blocks):
        if block is not None and block.kind != MARK and block.sequence > marked:
            parts.setdefault(block.sequence, {})[block.index] = pages_of(memory, number)
    return {
        sequence: b"".join(parts[sequence][index] for index in sorted(parts[sequence]))
        for sequence in sorted(parts)
    }
