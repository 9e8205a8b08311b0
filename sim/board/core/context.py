"""The common ground of the emulated board's engine and peripherals: time, errors, and what snapshots keep.

A peripheral is a class over a window of the address space. It gets the engine when it is made, and through it
time, alarms, interrupts, memory and the way to say that the image did what a board does not forgive.

    class Watchdog(Kept):
        def __init__(self, engine: Engine) -> None:
            self._engine = engine
            self._missed = engine.alarm("iwdg", self._miss)

        def write(self, offset: int, size: int, value: int) -> None:
            self._missed.set(self._engine.cycle + period)

Time is the count of cycles of a 216 MHz clock since power-up, a whole number that never goes back, whatever
the core's own clock is at that moment. Everything is repeatable: a peripheral keeps no other time, and no
randomness but from a seed.
"""

from __future__ import annotations

import copy
from typing import Any, Protocol

from neuroflight.toolchain.errors import LinkError

TIME_HZ = 216_000_000  # of `Engine.cycle`


class BoardError(LinkError):
    """An action of the image that the chip does not support, allow or tolerate.

    The message ends in the place: program counter, function, file and line. Behind a port it is what every
    failure of the other side is, a LinkError.
    """


class Kept:
    """A part of the board that is the same again when the attributes named in `kept` are."""

    kept: tuple[str, ...] = ()

    def state(self) -> Any:  # noqa: ANN401 - each part's own
        """Return all that changes, as picklable values, except the engine's alarms and interrupt lines."""
        return {name: copy.deepcopy(getattr(self, name)) for name in self.kept}

    def restore(self, state: Any) -> None:  # noqa: ANN401
        """Make `state()`'s value the state again, silently: no interrupt, no alarm, no request."""
        for name, value in copy.deepcopy(state).items():
            setattr(self, name, value)


class Peripheral(Protocol):
    """Registers behind a window of addresses.

    Offsets count bytes from the window's base, sizes are 1, 2 or 4 bytes, values are unsigned. An access is
    never unaligned (the engine has refused it). Each access happens once, at its exact cycle.
    """

    def read(self, offset: int, size: int) -> int:
        """Return the value that the program reads, with the side effects of reading."""

    def write(self, offset: int, size: int, value: int) -> None:
        """Take the value that the program writes."""

    def reset(self) -> None:
        """Return to the state after a system reset. Alarms and interrupt lines are cleared already."""

    def state(self) -> Any:  # noqa: ANN401
        """See Kept."""

    def restore(self, state: Any) -> None:  # noqa: ANN401
        """See Kept."""
