"""The STM32F722 in its 64-pin package: which pin can serve what, and which DMA stream hears which request.

Sources: of alternate functions, converter inputs and pads the data sheet's tables, as STMicroelectronics
publishes them in STM32_open_pin_data; of DMA requests RM0431, chapter 8, as modm-devices carries them. All of
these tables were compared with those by a program, and Betaflight's DMA table by eye.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from neuroflight.toolchain.boards.facts import Pin

PORTS = "ABCD"  # with pads that boards use; H has the crystal's
PADS = frozenset(
    Pin(port, number)
    for port, numbers in {
        "A": range(16),
        "B": range(16),
        "C": (0, 1, 2, 3, 4, *range(6, 16)),  # PC5 is a pad of larger packages
        "D": (2,),
    }.items()
    for number in numbers
)
USB_PINS = (Pin("A", 11), Pin("A", 12))


def _pins(text: str) -> dict[Pin, int]:
    """Return pins and alternate functions of a text such as `PA5 5, PB3 5`."""
    return {Pin.of(pin): int(number) for pin, number in (one.split() for one in text.split(","))}


# Signal -> pins that can carry it, each with its alternate function.
FUNCTIONS: Mapping[str, Mapping[Pin, int]] = {
    "SPI1_SCK": _pins("PA5 5, PB3 5"),
    "SPI1_MISO": _pins("PA6 5, PB4 5"),
    "SPI1_MOSI": _pins("PA7 5, PB5 5"),
    "SPI2_SCK": _pins("PA9 5, PB10 5, PB13 5"),
    "SPI2_MISO": _pins("PB14 5, PC2 5"),
    "SPI2_MOSI": _pins("PB15 5, PC1 5, PC3 5"),
    "SPI3_SCK": _pins("PB3 6, PC10 6"),
    "SPI3_MISO": _pins("PB4 6, PC11 6"),
    "SPI3_MOSI": _pins("PB2 7, PB5 6, PC12 6"),
    "UART1_TX": _pins("PA9 7, PB6 7"),
    "UART1_RX": _pins("PA10 7, PB7 7"),
    "UART2_TX": _pins("PA2 7"),
    "UART2_RX": _pins("PA3 7"),
    "UART3_TX": _pins("PB10 7, PC10 7"),
    "UART3_RX": _pins("PB11 7, PC11 7"),
    "UART4_TX": _pins("PA0 8, PC10 8"),
    "UART4_RX": _pins("PA1 8, PC11 8"),
    "UART5_TX": _pins("PC12 8"),
    "UART5_RX": _pins("PD2 8"),
    "UART6_TX": _pins("PC6 8"),
    "UART6_RX": _pins("PC7 8"),
}
ADC_CHANNELS: Mapping[Pin, int] = {  # inputs of ADC1
    **{Pin("A", number): number for number in range(8)},
    **{Pin("B", number): 8 + number for number in range(2)},
    **{Pin("C", number): 10 + number for number in range(5)},
}


@dataclass(frozen=True, order=True)
class Stream:
    """A DMA stream, set to one of its eight requests."""

    controller: int  # 1 or 2
    stream: int  # 0 to 7
    channel: int  # 0 to 7: the request

    def __str__(self) -> str:
        """Return DMA2 S3, its name without the request."""
        return f"DMA{self.controller} S{self.stream}"

    @property
    def place(self) -> tuple[int, int]:
        """The stream itself, which serves one request at a time."""
        return self.controller, self.stream

    @property
    def code(self) -> int:
        """Return its number in a board's description: 0x100 controller + 0x10 stream + channel."""
        return self.controller << 8 | self.stream << 4 | self.channel


def _streams(*places: tuple[int, int, int]) -> tuple[Stream, ...]:
    return tuple(Stream(*place) for place in places)


# Request -> the streams that can hear it, those first that leave most room to others.
REQUESTS: Mapping[str, tuple[Stream, ...]] = {
    "ADC1": _streams((2, 0, 0), (2, 4, 0)),
    "SPI1_RX": _streams((2, 2, 3), (2, 0, 3)),
    "SPI1_TX": _streams((2, 3, 3), (2, 5, 3)),
    "SPI2_RX": _streams((1, 3, 0)),
    "SPI2_TX": _streams((1, 4, 0)),
    "SPI3_RX": _streams((1, 0, 0), (1, 2, 0)),
    "SPI3_TX": _streams((1, 7, 0), (1, 5, 0)),
    "UART1_RX": _streams((2, 5, 4), (2, 2, 4)),
    "UART1_TX": _streams((2, 7, 4)),
    "UART2_RX": _streams((1, 5, 4)),
    "UART2_TX": _streams((1, 6, 4)),
    "UART3_RX": _streams((1, 1, 4)),
    "UART3_TX": _streams((1, 3, 4), (1, 4, 7)),
    "UART4_RX": _streams((1, 2, 4)),
    "UART4_TX": _streams((1, 4, 4)),
    "UART5_RX": _streams((1, 0, 4)),
    "UART5_TX": _streams((1, 7, 4)),
    "UART6_RX": _streams((2, 1, 5), (2, 2, 5)),
    "UART6_TX": _streams((2, 6, 5), (2, 7, 5)),
    # Compare events of the timer that paces the motors' ports: only DMA2 reaches those (RM0431, bus matrix).
    "TIM1_CH1": _streams((2, 1, 6), (2, 3, 6)),
    "TIM1_CH2": _streams((2, 2, 6)),
    "TIM1_CH3": _streams((2, 6, 6)),
    "TIM1_CH4": _streams((2, 4, 6)),
}
