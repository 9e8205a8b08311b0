"""GPIO: ports A to D, what drives each pin, and which peripheral a pin may serve.

A peripheral asks `Pins.expect` when it uses a pin: a pin in another mode is the image's mistake, found where
it matters rather than where it was made.
"""

from __future__ import annotations

from collections.abc import Callable

from sim.board.core.context import Context
from sim.board.registers.bus import Device

PORTS = "ABCD"
_MODES = ("an input", "an output", "alternate function", "analog")
_INPUT, _OUTPUT, _ALTERNATE, _ANALOG = range(4)
_PULL_UP, _PULL_DOWN = 1, 2
ANALOG = -1  # in place of an alternate function

# Which pin carries a signal on this board, and its alternate function (data sheet DS11853, alternate function
# mapping; pin definitions for the converter's channels).
SIGNALS: dict[str, tuple[str, int, int]] = {
    "SPI1_SCK": ("A", 5, 5),
    "SPI1_MISO": ("A", 6, 5),
    "SPI1_MOSI": ("A", 7, 5),
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
    "ADC1_IN8": ("B", 0, ANALOG),
    "ADC1_IN10": ("C", 0, ANALOG),
    "ADC1_IN14": ("C", 4, ANALOG),
}


class Port(Device):
    """One GPIO port."""

    kept = ("driven", "levels")

    def __init__(self, context: Context, letter: str) -> None:
        super().__init__(context, f"GPIO{letter}")
        self.letter = letter
        self.driven: dict[int, bool] = {}  # level that the board puts on a pin
        self.levels: dict[int, bool] = {}  # of pins that somebody watches, as last told
        self.listeners: dict[int, Callable[[bool], None]] = {}
        self.before_read: Callable[[], None] = lambda: None
        self.version = 0  # rises with each change of modes or functions

    def reset(self) -> None:
        super().reset()
        self._changed()

    def mode(self, pin: int) -> int:
        return self.words["MODER"] >> 2 * pin & 3

    def function(self, pin: int) -> int:
        register = "AFRL" if pin < 8 else "AFRH"
        return self.words[register] >> 4 * (pin & 7) & 15

    def level(self, pin: int) -> bool:
        """What is on the line: the pin's own level if it drives, the board's, or a pull's."""
        if self.mode(pin) == _OUTPUT and not (
            self.words["OTYPER"] >> pin & 1 and self.words["ODR"] >> pin & 1
        ):
            return bool(self.words["ODR"] >> pin & 1)
        if pin in self.driven:
            return self.driven[pin]
        return self.words["PUPDR"] >> 2 * pin & 3 == _PULL_UP

    def read_idr(self) -> int:
        self.before_read()
        return sum(self.level(pin) << pin for pin in range(16) if self.mode(pin) != _ANALOG)

    def read_bsrr(self) -> int:
        return 0

    def write_bsrr(self, value: int) -> None:
        # Setting wins where both are asked for (RM0431 6.4.7).
        self.words["ODR"] = self.words["ODR"] & ~(value >> 16) | value & 0xFFFF
        if self.listeners:
            self._tell()

    def write_odr(self, value: int) -> None:
        self.keep("ODR", value)
        self._tell()

    def write_moder(self, value: int) -> None:
        self._set("MODER", value)

    def write_otyper(self, value: int) -> None:
        self._set("OTYPER", value)

    def write_pupdr(self, value: int) -> None:
        self._set("PUPDR", value)

    def write_afrl(self, value: int) -> None:
        self._set("AFRL", value)

    def write_afrh(self, value: int) -> None:
        self._set("AFRH", value)

    def _set(self, register: str, value: int) -> None:
        if self.keep(register, value):
            self._changed()

    def _changed(self) -> None:
        self.version += 1
        self._tell()

    def _tell(self) -> None:
        for pin, listener in self.listeners.items():
            level = self.level(pin)
            if level != self.levels.get(pin):
                self.levels[pin] = level
                listener(level)

    def restore(self, state: object) -> None:
        super().restore(state)
        self.version += 1


class Pins:
    """All ports, by pin name such as "PC2"."""

    def __init__(self, context: Context) -> None:
        self.ports = {letter: Port(context, letter) for letter in PORTS}
        self.on_drive: Callable[[str, int, bool], None] = lambda port, pin, level: None
        self._context = context
        self._good: dict[str, int] = {}  # signal: version of its port when it was found right

    def drive(self, name: str, level: bool) -> None:
        """The board puts `level` on a pin."""
        port, pin = self._place(name)
        if port.driven.get(pin) != level:
            port.driven[pin] = level
            self.on_drive(port.letter, pin, level)

    def pulse(self, name: str) -> None:
        """The board lets a pin rise; where it was high still, it falls first."""
        self.drive(name, False)
        self.drive(name, True)

    def watch(self, name: str, listener: Callable[[bool], None]) -> None:
        """`listener(level)` runs whenever the level on a pin that the image drives changes."""
        port, pin = self._place(name)
        port.listeners[pin] = listener
        port.levels[pin] = port.level(pin)

    def level(self, name: str) -> bool:
        """What is on the line."""
        port, pin = self._place(name)
        return port.level(pin)

    def pull(self, name: str) -> bool | None:
        """Which way a pin is pulled; None: not at all."""
        port, pin = self._place(name)
        return {_PULL_UP: True, _PULL_DOWN: False}.get(port.words["PUPDR"] >> 2 * pin & 3)

    def expect(self, signal: str, user: str) -> None:
        """`user` is about to use `signal` (a name of SIGNALS): fail unless its pin is set up for it."""
        letter, pin, wanted = SIGNALS[signal]
        port = self.ports[letter]
        if self._good.get(signal) == port.version:
            return
        mode, function = port.mode(pin), port.function(pin)
        if wanted == ANALOG:
            right, expected = mode == _ANALOG, "analog"
        else:
            right, expected = (mode, function) == (_ALTERNATE, wanted), f"alternate function {wanted}"
        if not right:
            is_ = f"{_MODES[mode]} {function}" if mode == _ALTERNATE else _MODES[mode]
            self._context.fail(f"{user}: P{letter}{pin} is {is_}, expected {expected} ({signal})")
        self._good[signal] = port.version

    def _place(self, name: str) -> tuple[Port, int]:
        return self.ports[name[1]], int(name[2:])
