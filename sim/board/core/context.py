"""The interface between the engine and the peripherals of the emulated board.

A peripheral is a class over a window of the address space. It gets a `Context` when it is made, and through
it time, interrupts, memory and the way to say that the image did what a board does not forgive.

    class Watchdog:
        def __init__(self, context: Context) -> None:
            self._context = context
            self._missed = context.alarm("iwdg", self._miss)

        def write(self, offset: int, size: int, value: int) -> None:
            self._missed.set(context.cycle + period)

Time is the count of cycles of a 216 MHz clock since power-up, a whole number that never goes back, whatever
the core's own clock is at that moment. Everything is repeatable: a peripheral keeps no other time, and no
randomness but from a seed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NoReturn, Protocol

from neuroflight.toolchain.errors import LinkError

TIME_HZ = 216_000_000  # of `Context.cycle`


class BoardError(LinkError):
    """An action of the image that the chip does not support, allow or tolerate.

    The message ends in the place: program counter, function, file and line. Behind a port it is what every
    failure of the other side is, a LinkError.
    """


class Peripheral(Protocol):
    """A peripheral: registers behind a window of addresses.

    Offsets count bytes from the window's base, sizes are 1, 2 or 4 bytes, values are unsigned. An access is
    never unaligned (the engine has refused it). Each access happens once, at its exact cycle.
    """

    def read(self, offset: int, size: int) -> int:
        """Return the value that the program reads, with the side effects of reading."""
        ...

    def write(self, offset: int, size: int, value: int) -> None:
        """Take the value that the program writes."""
        ...

    def reset(self) -> None:
        """Return to the state after a system reset. Alarms and interrupt lines are cleared already."""
        ...

    def state(self) -> Any:  # noqa: ANN401 - each peripheral's own
        """Return all that changes, as picklable values, except the engine's alarms and interrupt lines."""
        ...

    def restore(self, state: Any) -> None:  # noqa: ANN401
        """Make `state()`'s value the state again, silently: no interrupt, no alarm, no request."""
        ...


class Alarm(Protocol):
    """A callback at a set time. Snapshots keep it by its name."""

    @property
    def number(self) -> int:
        """Its number in the engine."""
        ...

    @property
    def due(self) -> int | None:
        """Cycle of the callback; None: not set."""
        ...

    def set(self, cycle: int) -> None:
        """Call back at `cycle`, instead of any time set before; at once after this instruction if passed."""
        ...

    def cancel(self) -> None:
        """Cancel the callback."""
        ...


class Context(Protocol):
    """The engine's services for peripherals, valid from a peripheral's constructor on."""

    @property
    def cycle(self) -> int:
        """Present time, in cycles of 216 MHz; inside an access: the time of that access."""
        ...

    def alarm(self, name: str, callback: Callable[[], None]) -> Alarm:
        """Create an alarm, not yet set. `name` is unique on the board ("usart1.tx"). Call this in the
        constructor.

        At one cycle alarms go off in the order of their creation.
        """
        ...

    def irq(self, number: int, asserted: bool) -> None:
        """Set the level of interrupt line `number` (0..103, as in the vendor's table).

        Keep it asserted as long as flag and enable are; the handler runs again if it leaves them so.
        """
        ...

    def nmi(self) -> None:
        """Raise the non-maskable interrupt (clock security system)."""
        ...

    def load(self, address: int, size: int) -> int:
        """Read as a bus master (DMA) from `address`: memory or, of 1, 2 or 4 bytes, a peripheral."""
        ...

    def store(self, address: int, size: int, value: int) -> None:
        """Write as a bus master: to RAM or a peripheral. Fails for flash and unused addresses."""
        ...

    def memory(self, address: int, size: int) -> bytes:
        """Return bytes of flash, RAM or system memory, without side effect."""
        ...

    def set_memory(self, address: int, data: bytes) -> None:
        """Change flash (as its controller does), RAM or system memory; translated code of it is dropped."""
        ...

    def is_cached(self, address: int) -> bool:
        """Return True if the data cache is on and the MPU lets it hold `address`: DMA must not use it."""
        ...

    def core_clock(self, hz: int) -> None:
        """Run the core (and DWT, SysTick) at `hz` from now on. After reset: 16 MHz."""
        ...

    def flash_busy(self, until: int | None) -> None:
        """Mark the flash bank as busy until cycle `until` (None: no longer): fetches from it stall."""
        ...

    def system_reset(self, cause: str) -> None:
        """Reset the chip after this instruction. `cause`: "software", "iwdg", "pin", "power"."""
        ...

    def on_system_reset(self, callback: Callable[[str], None]) -> None:
        """Call `callback(cause)` at every reset before peripherals reset; RCC keeps the cause for its CSR."""
        ...

    def on_flash_store(self, callback: Callable[[int, int, int], None]) -> None:
        """Call `callback(address, size, value)` for what the program stores into flash (0x08000000 on).

        It changes flash by `set_memory` or not at all. Without a callback such a store is a fault.
        """
        ...

    def note(self, message: str) -> None:
        """Add to the report, with cycle and place; the program continues. Equal messages are counted."""
        ...

    def fail(self, message: str) -> NoReturn:
        """Raise BoardError: `message` and the place. `message` names what, got and expected."""
        ...


class Bus(Protocol):
    """The bus that peripherals are attached to; the engine is one."""

    def attach(self, base: int, size: int, peripheral: Peripheral, name: str) -> None:
        """Attach `peripheral` at `base` to `base + size - 1`, both 1 KiB aligned. `name`: "USART1".

        Raises ValueError if the place is taken.
        """
        ...
