"""Faults of an SD card, each at a time or at a block write."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from neuroflight.sim.board.core.context import Kept
from neuroflight.sim.board.devices.sd_card.registers import BLOCK


class Cut(Enum):
    """Contents of a block that was being written when the power went."""

    OLD = "old"  # what was there before
    NEW = "new"
    TORN = "torn"  # its first bytes new, the others old


class CardFault(Enum):
    """Kinds of faults, and what their value is."""

    STALL = "stall"  # the present or next operation takes this many seconds longer
    SLOW = "slow"  # from then on every time is multiplied by that
    WORN = "worn"  # every block that is written from so many writes later on is a write error
    WORN_FROM = "worn-from"  # likewise, in blocks from that address on
    ERRORS = "errors"  # from then on a bit turns over in that share of the commands and blocks on the line
    REMOVED = "removed"  # pulled out of its slot
    INSERTED = "inserted"  # put back
    POWER_CUT = "power-cut"  # the board loses its power while this block is written


@dataclass(frozen=True)
class Event:
    """A fault with its time."""

    kind: CardFault
    value: float = 0.0
    cycle: int | None = None  # from then on
    write: int | None = None  # with this block write, counted from 1 since the card was made
    cut: Cut | None = None  # for a power cut; None: by chance
    kept_bytes: int | None = None  # of a torn block, its new ones; None: by chance


class Events(Kept):
    """The pending faults."""

    kept = ("_timed", "_counted")

    def __init__(self) -> None:
        self._timed: list[Event] = []  # the next one first
        self._counted: list[Event] = []

    def add(self, event: Event) -> None:
        assert (event.cycle is None) != (event.write is None), "a fault comes at a cycle or with a write"
        if event.cycle is None:
            self._counted.append(event)
        else:
            self._timed.append(event)
            self._timed.sort(key=lambda timed: timed.cycle or 0)

    @property
    def next_cycle(self) -> int | None:
        """Time of the next one; None: none is due by time."""
        return self._timed[0].cycle if self._timed else None

    def due(self, cycle: int) -> list[Event]:
        """Remove and return the events due at `cycle` or before."""
        came = [event for event in self._timed if (event.cycle or 0) <= cycle]
        self._timed = self._timed[len(came) :]
        return came

    def with_write(self, number: int) -> list[Event]:
        """Remove and return the events of block write `number`."""
        came = [event for event in self._counted if event.write == number]
        self._counted = [event for event in self._counted if event.write != number]
        return came


class LineErrors(Kept):
    """Bit errors between host and card."""

    kept = ("rate", "_random")

    def __init__(self, seed: int) -> None:
        self.rate = 0.0  # share of commands and blocks
        self._random = random.Random(f"line {seed}")

    def damaged(self, data: bytes) -> bytes:
        """Return `data` as it arrives."""
        if not self.rate or self._random.random() >= self.rate:
            return data
        bit = self._random.randrange(8 * len(data))
        return data[: bit // 8] + bytes([data[bit // 8] ^ 0x80 >> bit % 8]) + data[bit // 8 + 1 :]


def left_of(old: bytes, new: bytes, cut: Cut | None, kept: int | None, choose: Callable[[int], int]) -> bytes:
    """Return the block between `old` and `new` at a power cut; choose(n): a number below n."""
    if cut is None:
        cut = list(Cut)[choose(len(Cut))]
    if cut is not Cut.TORN:
        return old if cut is Cut.OLD else new
    part = choose(BLOCK + 1) if kept is None else kept
    return new[:part] + old[part:]
