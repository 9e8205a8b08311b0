"""GPIO: ports A to D, and which peripheral a pin may serve; levels are C's (native/c/pins.c).

A peripheral asks `Pins.expect` when it uses a pin: a pin in another mode is the image's mistake, found where
it matters rather than where it was made.
"""

from __future__ import annotations

from collections.abc import Callable

from neuroflight.sim.board.native.library import Native, NativeDevice

PORTS = "ABCD"
_MODES = ("an input", "an output", "alternate function", "analog")
_ALTERNATE, _ANALOG = 2, 3
ANALOG = -1  # in place of an alternate function

# Which pin carries a signal on this board, and its alternate function (data sheet DS11853, alternate function
# mapping; pin definitions for the converter's channels).
SIGNALS: dict[str, tuple[str, int, int]] = {
    "SPI1_SCK": ("A", 5, 5),
    "SPI1_MISO": ("A", 6, 5),
    "SPI1_MOSI": ("A", 7, 5),
    "SPI3_SCK": ("B", 3, 6),
    "SPI3_MISO": ("B", 4, 6),
    "SPI3_MOSI": ("B", 5, 6),
    **{f"TIM8_CH{i}": ("C", 5 + i, 3) for i in range(1, 5)},
    "TIM3_CH4": ("B", 1, 2),
    "TIM1_CH1": ("A", 8, 1),
    "TIM4_CH3": ("B", 8, 2),
    "TIM5_CH3": ("A", 2, 2),
    "TIM2_CH1": ("A", 15, 1),
    "USART1_TX": ("A", 9, 7),
    "USART1_RX": ("A", 10, 7),
    "USART2_TX": ("A", 2, 7),
    "USART2_RX": ("A", 3, 7),
    "USART3_TX": ("C", 10, 7),
    "USART3_RX": ("C", 11, 7),
    "UART4_TX": ("A", 0, 8),
    "UART4_RX": ("A", 1, 8),
    "UART5_TX": ("C", 12, 8),
    "UART5_RX": ("D", 2, 8),
    "OTG_FS_DM": ("A", 11, 10),
    "OTG_FS_DP": ("A", 12, 10),
    "ADC1_IN8": ("B", 0, ANALOG),
    "ADC1_IN10": ("C", 0, ANALOG),
    "ADC1_IN14": ("C", 4, ANALOG),
}


class Port(NativeDevice):
    """One GPIO port."""

    def __init__(self, native: Native, letter: str) -> None:
        super().__init__(native, f"GPIO{letter}", native.library.PORT, PORTS.index(letter))
        self.letter = letter
        self.listeners: dict[int, Callable[[bool], None]] = {}

    def mode(self, pin: int) -> int:
        return self.words["MODER"] >> 2 * pin & 3

    def function(self, pin: int) -> int:
        register = "AFRL" if pin < 8 else "AFRH"
        return self.words[register] >> 4 * (pin & 7) & 15

    def on_pin(self, pin: int, level: bool) -> None:
        self.listeners[pin](level)


class Pins:
    """All ports, by pin name such as "PC2"."""

    def __init__(self, native: Native) -> None:
        self.ports = {letter: Port(native, letter) for letter in PORTS}
        self._native = native

    def drive(self, name: str, level: bool) -> None:
        self._native.library.native_drive(self._native.handle, *_place(name), level)

    def watch(self, name: str, listener: Callable[[bool], None]) -> None:
        """Call `listener(level)` whenever the level on a pin that the image drives changes."""
        port, pin = _place(name)
        self.ports[PORTS[port]].listeners[pin] = listener
        self._native.library.native_watch(self._native.handle, port, pin)

    def expect(self, signal: str, user: str) -> None:
        """Fail unless the pin of `signal` (a name of SIGNALS) is set up for its use by `user`."""
        letter, pin, wanted = SIGNALS[signal]
        port = self.ports[letter]
        mode, function = port.mode(pin), port.function(pin)
        if wanted == ANALOG:
            right, expected = mode == _ANALOG, "analog"
        else:
            right, expected = (mode, function) == (_ALTERNATE, wanted), f"alternate function {wanted}"
        if not right:
            is_ = f"{_MODES[mode]} {function}" if mode == _ALTERNATE else _MODES[mode]
            port.engine.fail(f"{user}: P{letter}{pin} is {is_}, expected {expected} ({signal})")


def _place(name: str) -> tuple[int, int]:
    return PORTS.index(name[1]), int(name[2:])
