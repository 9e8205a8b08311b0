"""A die of a flash chip. What it would ignore, or do to other bytes than were meant, is an error."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import NoReturn

from neuroflight.sim.board.core.context import TIME_HZ, Kept
from neuroflight.sim.board.devices.flash_chip.kinds import ChipKind, Range
from neuroflight.sim.board.devices.flash_chip.memory import FlashMemory

RELEASED = 0xFF
BUSY, ENABLED, ERASE_BAD, PROGRAM_BAD, ECC_BAD = 0x01, 0x02, 0x04, 0x08, 0x20
PROTECTED = {False: 0x1C, True: 0x78}  # bits of a NOR chip's status, of a NAND chip's register 0xA0
PARTS_MAX = 4  # times that a NAND page may be programmed between two erases (W25N01GV, 9.5: NOP)
LOOKS = (0x05, 0x0F)  # status, which may be asked for at any time
IDENTIFY, SELECT = 0x9F, 0xC2


class Die(Kept):
    """One die; `first` is its first block among those of the package."""

    kept = (
        *(
            "_status",
            "_busy_until",
            "_frame",
            "_end",
            "_four",
            "_registers",
            "_buffer",
            "_doing",
            "_old",
            "_before",
        ),
        *("slow", "protection", "worn", "decayed", "factory_bad", "_random"),
    )

    def __init__(self, kind: ChipKind, memory: FlashMemory, first: int, seed: int) -> None:
        self.kind, self.memory, self.first = kind, memory, first
        self.blocks = kind.blocks // kind.dies
        self.protection = PROTECTED[True] if kind.nand else 0  # at power-on
        self.slow = 0.0  # 0: all times are typical or somewhat more; 1: all are the longest
        self.worn: set[int] = set()  # blocks that can be neither programmed nor erased
        self.decayed: set[int] = set()  # pages with more wrong bits than can be mended
        self.factory_bad: set[int] = set()
        self.fail: Callable[[str], NoReturn]
        self.on_operation: Callable[[int], bool] = lambda cycle: (
            False
        )  # programs and erases; is it cut short?
        self._random = random.Random(f"flash {seed} {first}")
        self._doing: tuple[str, int] | None = None  # what was last begun: program or erase, page or block
        self._old = b""  # the page as it was before
        self._before: list[bytes] = []  # or the block's pages
        self.power_on()

    def power_on(self) -> None:
        self._status = 0 if self.kind.nand else self.protection
        self._busy_until = 0
        self._four = False
        self._registers = {0xA0: self.protection, 0xB0: 0x18}
        self._buffer = bytes([RELEASED]) * self.kind.whole_page
        self._frame = bytearray()
        self._end = 0
        self._doing = None

    # ---- bytes ----

    def exchange(self, sent: bytes, at: int, length: int, hz: float) -> bytes:
        """Exchange bytes of a transaction, the first of which begins at cycle `at`."""
        if not self._frame:
            self._check(sent[0], at, hz)
        got = bytearray()
        for i, byte in enumerate(sent):
            position = len(self._frame)
            head = self._head(self._frame[0]) if position else 1
            if position >= head and position and self._streams(self._frame[0]):
                got += self._stream(position - head, len(sent) - i, at + i * length)
                self._frame += sent[i:]
                break
            self._frame.append(byte)
            got.append(RELEASED)
        self._end = at + len(sent) * length
        return bytes(got)

    def deselect(self) -> None:
        """Carry out what was sent: the select line rises."""
        frame, self._frame = bytes(self._frame), bytearray()
        if frame:
            self._carry_out(frame, self._end)

    def busy(self, cycle: int) -> bool:
        return cycle < self._busy_until

    def lose_power(self, cycle: int) -> None:
        """Leave what was under way at `cycle` as it may be."""
        self.deselect()
        if self._doing is not None and self.busy(cycle):
            self._tear()
        self._doing = None

    def _check(self, command: int, at: int, hz: float) -> None:
        if hz > self.kind.read_hz:
            self.fail(
                f"the flash chip is clocked at {hz / 1e6:g} MHz, expected {self.kind.read_hz / 1e6:g} at most"
            )
        if self.busy(at) and command not in (*LOOKS, IDENTIFY, SELECT):
            what = "works" if self._doing is None else f"is busy: {self._doing[0]} {self._doing[1]}"
            self.fail(f"the flash chip is sent command 0x{command:02X} while it {what}; it ignores that")

    def _head(self, command: int) -> int:
        """Return the bytes of a command before those that it moves."""
        if command == IDENTIFY:
            return 2 if self.kind.nand else 1
        if command in LOOKS:
            return 2 if self.kind.nand else 1
        if self.kind.nand:
            return 4 if command == 0x03 else 3
        return 5 if self._four else 4

    def _streams(self, command: int) -> bool:
        return command in (IDENTIFY, 0x03, *LOOKS)

    def _stream(self, place: int, count: int, at: int) -> bytes:
        """Answer `count` bytes, the first `place` behind the command's head."""
        command = self._frame[0]
        if command == IDENTIFY:
            told = b"" if self.busy(at) else self.kind.identity
            return (told[place:] + bytes([RELEASED]) * (place + count))[:count]
        if command in LOOKS:
            return bytes([self._register(at)]) * count
        if self.kind.nand:
            column = int.from_bytes(self._frame[1:3], "big") + place
            return self._buffer[column : column + count].ljust(count, b"\xff")
        address = self._address(self._frame) + place
        got = b""
        while len(got) < count:
            page, column = divmod(address + len(got), self.kind.page_bytes)
            got += self.memory.read(self._page(page))[column : column + count - len(got)]
        return got

    def _register(self, at: int) -> int:
        if self.kind.nand and self._frame[1] != 0xC0:
            return self._registers.get(self._frame[1], 0)
        if self.busy(at):
            return self._status | BUSY
        return self._status

    def _address(self, frame: bytes | bytearray) -> int:
        return int.from_bytes(frame[1 : self._head(frame[0])], "big")

    def _page(self, page: int) -> int:
        """Return a page's number in the package."""
        if page >= self.blocks * self.kind.pages:
            self.fail(
                f"the flash chip is asked for page {page}, expected one below {self.blocks * self.kind.pages}"
            )
        return self.first * self.kind.pages + page

    # ---- commands ----

    def _carry_out(self, frame: bytes, at: int) -> None:
        command = frame[0]
        if command in (IDENTIFY, SELECT, *LOOKS) or (command == 0x03):
            return
        if command == 0x06:
            self._status |= ENABLED
        elif self.kind.nand:
            self._carry_out_nand(frame, at)
        elif command == 0xB7 and self.kind.blocks // self.kind.dies > 256:
            self._four = True
        elif command == 0x01 and len(frame) >= 2:
            self._need_enabled("its status written")
            self._protect(frame[1])
            self._work(self.kind.status, at)
        elif command == 0x02:
            self._program_nor(frame, at)
        elif command == 0xD8:
            self._erase(self._address(frame) // (self.kind.page_bytes * self.kind.pages), at)
        else:
            self.fail(
                f"the flash chip is sent 0x{command:02X}, a command that {self.kind.name} does not know"
            )

    def _carry_out_nand(self, frame: bytes, at: int) -> None:
        command, page = frame[0], int.from_bytes(frame[1:4], "big")
        if command in (0x01, 0x1F) and len(frame) == 3:
            self._registers[frame[1]] = frame[2]
        elif command in (0x02, 0x84):
            self._need_enabled("bytes to be programmed")
            column, data = int.from_bytes(frame[1:3], "big"), frame[3:]
            if column + len(data) > self.kind.whole_page:
                self.fail(
                    f"the flash chip is given {len(data)} bytes from byte {column} of a page on: too many"
                )
            rest = bytes([RELEASED]) * self.kind.whole_page if command == 0x02 else self._buffer
            self._buffer = rest[:column] + data + rest[column + len(data) :]
        elif command == 0x13:
            self._status &= ~(ECC_BAD | 0x10)
            if self._page(page) in self.decayed:
                self._status |= ECC_BAD
            self._buffer = self.memory.read(self._page(page))
            if not self._registers[0xB0] & 0x08:
                self.fail("the flash chip is read in continuous mode; set BUF of its register 0xB0")
            self._work(self.kind.load, at)
        elif command == 0x10:
            self._need_enabled("a page programmed")
            self._program(self._page(page), 0, self._buffer, at)
        elif command == 0xD8:
            self._erase(page // self.kind.pages, at)
        else:
            self.fail(
                f"the flash chip is sent 0x{command:02X}, a command that {self.kind.name} does not know"
            )

    def _protect(self, status: int) -> None:
        self.protection = status & 0xFC
        self._status = self.protection

    def _need_enabled(self, what: str) -> None:
        if not self._status & ENABLED:
            self.fail(f"the flash chip is to have {what} without its write enable latch; it ignores that")

    def _need_free(self, what: str) -> None:
        self._need_enabled(what)
        protected = self._registers[0xA0] if self.kind.nand else self._status
        if protected & PROTECTED[self.kind.nand]:
            self.fail(f"the flash chip is to have {what} while its blocks are protected; it ignores that")

    def _program_nor(self, frame: bytes, at: int) -> None:
        page, column = divmod(self._address(frame), self.kind.page_bytes)
        data = frame[self._head(0x02) :]
        if column + len(data) > self.kind.page_bytes:
            self.fail(
                f"the flash chip is to program {len(data)} bytes from byte {column} of page {page} on: "
                f"what is over goes to the page's begin"
            )
        whole = bytes([RELEASED]) * column + data
        self._program(self._page(page), column, whole.ljust(self.kind.whole_page, b"\xff"), at)

    def _program(self, page: int, column: int, data: bytes, at: int) -> None:
        self._need_free(f"page {page} programmed")
        old = self.memory.read(page)
        new = (int.from_bytes(old, "big") & int.from_bytes(data, "big")).to_bytes(len(old), "big")
        spare_only = self.kind.nand and data[: self.kind.page_bytes].count(RELEASED) == self.kind.page_bytes
        if new != bytes(o if d == RELEASED else d for o, d in zip(old, data, strict=True)):
            self.fail(f"the flash chip is to program page {page} over what is there: only erasing sets bits")
        if self.kind.nand and not spare_only:
            self._check_order(page)
        self._doing = ("programming page", page)
        self._status &= ~PROGRAM_BAD
        block = page // self.kind.pages
        if block in self.worn:
            new = new if spare_only else old  # so that it can be marked as bad
            self._status |= PROGRAM_BAD if self.kind.nand else 0
        if self.on_operation(at):
            self._status |= ENABLED
            self._tear_page(page, old, new)
            self._doing = None
            return
        self.memory.put(page, new)
        self._old = old
        self._work(self.kind.program, at)

    def _check_order(self, page: int) -> None:
        times = self.memory.programs.get(page, 0) + 1
        self.memory.programs[page] = times
        if times > PARTS_MAX:
            self.fail(f"the flash chip is to program page {page} a {times}th time since it was erased")
        last = (page // self.kind.pages + 1) * self.kind.pages
        later = [other for other in range(page + 1, last) if self.memory.programs.get(other)]
        if later:
            self.fail(f"the flash chip is to program page {page} after page {later[0]} of the same block")

    def _erase(self, block: int, at: int) -> None:
        self._need_free(f"block {block} erased")
        whole = self._page(block * self.kind.pages) // self.kind.pages
        if whole in self.factory_bad:
            self.fail(f"the flash chip is to erase block {whole}, which its maker has marked as bad")
        self._doing = ("erasing block", whole)
        self._status &= ~ERASE_BAD
        if self.on_operation(at):
            self.memory.tear(whole, self._random)
            self._doing = None
            return
        if whole in self.worn:
            self._status |= ERASE_BAD if self.kind.nand else 0
        else:
            self._before = [self.memory.read(whole * self.kind.pages + i) for i in range(self.kind.pages)]
            self.memory.erase(whole)
        self._work(self.kind.erase, at)

    def _work(self, times: Range, at: int) -> None:
        low, high = times
        share = max(self.slow, 0.3 * self._random.random() ** 4)
        self._busy_until = at + round((low + (high - low) * share) * TIME_HZ)
        self._status &= ~ENABLED

    # ---- a power cut ----

    def _tear(self) -> None:
        assert self._doing is not None
        what, number = self._doing
        if what.startswith("programming"):
            self._tear_page(number, self._old, self.memory.read(number))
            return
        for i, page in enumerate(self._before):
            self.memory.put(number * self.kind.pages + i, page)
        self.memory.tear(number, self._random)

    def _tear_page(self, page: int, old: bytes, new: bytes) -> None:
        """Clear some of the bits that were to become 0."""
        share = self._random.choice((0.0, 0.01, 0.5, 0.99, 1.0))
        chosen = bytes(
            sum((self._random.random() < share) << bit for bit in range(8))
            if share % 1.0
            else round(255 * share)
            for _ in old
        )
        self.memory.put(
            page, bytes(o & ~(c & (o ^ n)) & 0xFF for o, n, c in zip(old, new, chosen, strict=True))
        )
