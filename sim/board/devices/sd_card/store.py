"""The memory of an SD card: unfinished blocks at a power cut, and worn blocks."""

from __future__ import annotations

from neuroflight.sim.board.core.context import Kept
from neuroflight.sim.board.devices.sd_card.delays import Delays
from neuroflight.sim.board.devices.sd_card.faults import Cut, left_of
from neuroflight.sim.board.devices.sd_card.image import CardImage


class Store(Kept):
    """The card's memory, whose blocks are those of `image`."""

    kept = ("writes", "worn_after", "worn_from", "_unfinished")

    def __init__(self, image: CardImage, delays: Delays, erased: int) -> None:
        """erased: value of erased bytes, 0x00 or 0xFF."""
        self.image, self.erased = image, erased
        self.writes = 0  # blocks that were to be written since the card was made
        self.worn_after: int | None = None  # writes; those that follow fail
        self.worn_from: int | None = None  # block; those from it on fail
        self._delays = delays
        self._unfinished: tuple[int, bytes, bytes, int] | None = None  # block, old, new, until which cycle

    def write(self, block: int, data: bytes) -> bool:
        """Begin to write a block, which `finish_at` ends; return True if it can be written."""
        self.writes += 1
        worn = self.worn_after is not None and self.writes > self.worn_after
        if worn or (self.worn_from is not None and block >= self.worn_from):
            return False
        self._unfinished = (block, self.image.read(block), data, 0)
        self.image.write(block, data)
        return True

    def finish_at(self, cycle: int) -> None:
        """Make the last written block safe from `cycle` on."""
        if self._unfinished is not None:
            self._unfinished = (*self._unfinished[:3], cycle)

    def lose_power(self, cycle: int, cut: Cut | None = None, kept_bytes: int | None = None) -> None:
        """Cut the power at `cycle`: an unfinished block is old, new or torn."""
        if self._unfinished is not None and cycle < self._unfinished[3]:
            block, old, new, _ = self._unfinished
            self.image.write(block, left_of(old, new, cut, kept_bytes, self._delays.choice))
        self._unfinished = None
