"""GPIO: ports A to E, and which peripheral a pin may serve; levels are C's (native/c/pins.c).

A peripheral asks `Pins.expect` when it uses a pin: a pin in another mode is the image's mistake, found where
it matters rather than where it was made.
"""

from __future__ import annotations

from collections.abc import Callable

from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.native.library import Native, NativeDevice
from neuroflight.sim.board.peripherals.signals import ANALOG, Signals
from neuroflight.toolchain.boards.facts import Pin

PORTS = "ABCDE"
_MODES = ("an input", "an output", "alternate function", "analog")
_ALTERNATE, _ANALOG = 2, 3


class Port(NativeDevice):
    """One GPIO port."""

    def __init__(self, native: Native, letter: str) -> None:
        super().__init__(native, f"GPIO{letter}", native.library.PORT, PORTS.index(letter))
        self.letter = letter
        self.listeners: dict[int, Callable[[bool], None]] = {}
        self.queries = {native.library.QUERY_DRIVEN: self._reject_driven}

    def mode(self, pin: int) -> int:
        return self.words["MODER"] >> 2 * pin & 3

    def function(self, pin: int) -> int:
        register = "AFRL" if pin < 8 else "AFRH"
        return self.words[register] >> 4 * (pin & 7) & 15

    def on_pin(self, pin: int, level: bool) -> None:
        self.listeners[pin](level)

    def _reject_driven(self, pin: int, since: int) -> None:
        self.engine.fail(
            f"P{self.letter}{pin} is an output while its ESC answers, {since * 1e6 / TIME_HZ:.1f} us after "
            f"the end of the frame: both drive the line, expected an input from the frame to the answer's end"
        )


class Pins:
    """All ports, by pin name such as "PC2", and where the board leads the peripherals' signals to."""

    def __init__(self, native: Native, signals: Signals) -> None:
        self.ports = {letter: Port(native, letter) for letter in PORTS}
        self.signals = signals
        self._native = native

    def drive(self, name: str, level: bool) -> None:
        self._native.library.native_drive(self._native.handle, *_place(name), level)

    def watch(self, name: str, listener: Callable[[bool], None]) -> None:
        """Call `listener(level)` whenever the level on a pin that the image drives changes."""
        port, pin = _place(name)
        self.ports[PORTS[port]].listeners[pin] = listener
        self._native.library.native_watch(self._native.handle, port, pin)

    def expect(self, signal: str, user: str) -> None:
        """Fail unless the board leads `signal`, "SPI1_SCK", to a pin, which is set up for it. user: of it."""
        if signal not in self.signals:
            engine = self.ports["A"].engine
            engine.fail(f"{user}, but the board leads {signal} to no pin")
        pin, wanted = self.signals[signal]
        port = self.ports[pin.port]
        mode, function = port.mode(pin.number), port.function(pin.number)
        if wanted == ANALOG:
            right, expected = mode == _ANALOG, "analog"
        else:
            right, expected = (mode, function) == (_ALTERNATE, wanted), f"alternate function {wanted}"
        if not right:
            is_ = f"{_MODES[mode]} {function}" if mode == _ALTERNATE else _MODES[mode]
            port.engine.fail(f"{user}: {pin} is {is_}, expected {expected} ({signal})")


def place(pin: Pin) -> tuple[int, int]:
    """Return the numbers of its port and its own, as C counts."""
    return PORTS.index(pin.port), pin.number


def _place(name: str) -> tuple[int, int]:
    return place(Pin.of(name))
