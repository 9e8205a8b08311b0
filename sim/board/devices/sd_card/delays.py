"""Times of an SD card: ranges, drawn with a seed.

A card's maker promises limits only: 1 s to start, 100 ms to read, 250 ms to write, more to erase (Physical
Layer Simplified Specification 4.2.3, 4.6.2). What cards take in between differs; these ranges are our choice
of what a firmware must live with, not the measurement of a card.
"""

from __future__ import annotations

import random
from dataclasses import dataclass

from neuroflight.sim.board.core.context import TIME_HZ, Kept
from neuroflight.sim.board.devices.sd_card.registers import AU_BYTES, BLOCK

Range = tuple[float, float]  # least and most [s]


@dataclass(frozen=True)
class CardTiming:
    """Times of a card [s]."""

    start: Range = (0.05, 0.25)  # from the first ACMD41 to readiness
    write: Range = (0.5e-3, 2e-3)  # busy after a block
    pause: Range = (20e-3, 120e-3)  # longer now and then: the card tidies up
    pause_share: float = 1 / 500  # of the blocks
    wake: Range = (1e-3, 8e-3)  # more, for the first access after a rest
    rest: float = 0.5  # without an access, after which the card has to wake
    stop: Range = (0.1e-3, 1e-3)  # busy after the end of several blocks
    read: Range = (0.2e-3, 1e-3)  # from a command to its data
    next_read: Range = (20e-6, 80e-6)  # to the next one of several blocks
    register: Range = (20e-6, 100e-6)  # from a command to a register's data
    erase: Range = (2e-3, 6e-3)
    erase_unit: Range = (0.2e-3, 0.4e-3)  # more, for each allocation unit


class Delays(Kept):
    """A source of random times, in cycles of 216 MHz."""

    kept = ("factor", "_random", "_last")

    def __init__(self, timing: CardTiming, seed: int) -> None:
        self.timing = timing
        self.factor = 1.0  # of all times: a slow card
        self._random = random.Random(seed)
        self._last = 0  # cycle of the end of the last access

    def start(self) -> int:
        return self._draw(self.timing.start)

    def write(self, at: int) -> int:
        """Draw the busy time after a block that came at cycle `at`; short times are more frequent."""
        low, high = self.timing.write
        took = self._wake(at) + self._cycles(low + (high - low) * self._random.random() ** 2)
        if self._random.random() < self.timing.pause_share:
            took += self._draw(self.timing.pause)
        self._last = at + took
        return took

    def stop(self, at: int) -> int:
        return self._ending(at, self._draw(self.timing.stop))

    def read(self, at: int, *, first: bool) -> int:
        """Draw the time until a block's data come."""
        if first:
            return self._ending(at, self._wake(at) + self._draw(self.timing.read))
        return self._ending(at, self._draw(self.timing.next_read))

    def register(self) -> int:
        return self._draw(self.timing.register)

    def erase(self, at: int, blocks: int) -> int:
        """Draw the busy time while `blocks` blocks are erased."""
        units = -(-blocks * BLOCK // AU_BYTES)
        low, high = self.timing.erase_unit
        took = self._draw(self.timing.erase) + self._draw((units * low, units * high))
        return self._ending(at, self._wake(at) + took)

    def choice(self, count: int) -> int:
        """Draw a number from 0 to below `count`."""
        return self._random.randrange(count)

    def _wake(self, at: int) -> int:
        rested = at - self._last > self.timing.rest * TIME_HZ
        return self._draw(self.timing.wake) if rested else 0

    def _ending(self, at: int, took: int) -> int:
        self._last = at + took
        return took

    def _draw(self, times: Range) -> int:
        return self._cycles(self._random.uniform(*times))

    def _cycles(self, seconds: float) -> int:
        return round(seconds * self.factor * TIME_HZ)
