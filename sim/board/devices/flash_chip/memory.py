"""The memory of a flash chip: pages whose bits only an erased block sets again, and wear."""

from __future__ import annotations

import fcntl
import os
import random
from pathlib import Path
from typing import Any

from neuroflight.sim.board.core.context import Kept
from neuroflight.sim.board.devices.flash_chip.kinds import ChipKind
from neuroflight.toolchain.errors import LinkError


class FlashMemory(Kept):
    """All pages of a chip, a NAND chip's with their spare bytes; in a file, if there is one, in order."""

    kept = ("_pages", "erases", "programs")

    def __init__(self, kind: ChipKind, path: Path | None = None) -> None:
        """path: made, blank, where there is none. Raises LinkError for a file that cannot be this chip."""
        self.kind, self.path = kind, path
        self.blank = b"\xff" * kind.whole_page
        self.erases: dict[int, int] = {}  # of each block, since the chip was made
        self.programs: dict[int, int] = {}  # of each page, since it was erased
        self._pages: dict[int, bytes] = {}  # but for blank ones
        self._file = -1 if path is None else self._open(path)

    def _open(self, path: Path) -> int:
        pages = self.kind.blocks * self.kind.pages
        size = pages * self.kind.whole_page
        try:
            file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        except OSError as error:
            raise LinkError(f"flash chip {path}: {error.strerror}; name a file that can be written") from None
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(file)
            raise LinkError(
                f"flash chip {path}: another board has this chip; wait for its end, or name a copy"
            ) from None
        there = os.fstat(file).st_size
        if there not in (0, size):
            os.close(file)
            raise LinkError(
                f"flash chip {path}: {there} bytes, expected {size} of a {self.kind.name}; name another "
                f"file, or one that does not exist yet"
            )
        if not there:
            for _ in range(self.kind.blocks):
                os.write(file, self.blank * self.kind.pages)
        for block in range(self.kind.blocks if there else 0):
            content = os.pread(
                file, self.kind.pages * self.kind.whole_page, block * self.kind.pages * self.kind.whole_page
            )
            if content.count(0xFF) == len(content):
                continue
            for number in range(self.kind.pages):
                page = content[number * self.kind.whole_page :][: self.kind.whole_page]
                if page != self.blank:
                    self._pages[block * self.kind.pages + number] = page
        return file

    def read(self, page: int) -> bytes:
        """Return a page with its spare bytes."""
        return self._pages.get(page, self.blank)

    def is_blank(self, block: int) -> bool:
        first = block * self.kind.pages
        return not any(first + number in self._pages for number in range(self.kind.pages))

    def put(self, page: int, content: bytes) -> None:
        """Set a page, whatever was there: of tests, and what a power cut leaves."""
        if content == self.blank:
            self._pages.pop(page, None)
        else:
            self._pages[page] = bytes(content)
        if self._file >= 0:
            try:
                os.pwrite(self._file, content, page * self.kind.whole_page)
            except OSError as error:
                raise LinkError(
                    f"flash chip {self.path}: {error.strerror}; make room for what is written"
                ) from None

    def erase(self, block: int) -> None:
        """Set all bits of a block."""
        self.erases[block] = self.erases.get(block, 0) + 1
        for page in range(block * self.kind.pages, (block + 1) * self.kind.pages):
            self.programs.pop(page, None)
            if page in self._pages:
                self.put(page, self.blank)

    def tear(self, block: int, chance: random.Random) -> None:
        """Leave a block as an erasing that was cut short may: any bits, some pages blank."""
        share = chance.random()
        for page in range(block * self.kind.pages, (block + 1) * self.kind.pages):
            old = self.read(page)
            if chance.random() < share:
                continue
            mix = [b"\xff" * len(old), chance.randbytes(len(old)), bytes(len(old)), old]
            self.put(page, chance.choice(mix))

    def close(self) -> None:
        if self._file >= 0:
            os.close(self._file)
        self._file = -1

    def state(self) -> Any:  # noqa: ANN401
        return {"_pages": dict(self._pages), "erases": dict(self.erases), "programs": dict(self.programs)}

    def restore(self, state: Any) -> None:  # noqa: ANN401
        then = state["_pages"]
        for page in self._pages.keys() | then.keys():
            content = then.get(page, self.blank)
            if content != self.read(page):
                self.put(page, content)
        self.erases, self.programs = dict(state["erases"]), dict(state["programs"])
