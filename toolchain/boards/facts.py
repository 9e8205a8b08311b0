"""The wiring of a flight controller with an STM32F722: facts, before anything is chosen.

`toolchain.boards` decides from them which DMA stream and compare channel serves what; the emulated board is
wired by them alone, so that a wrong choice shows.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from neuroflight.toolchain.contract import BoardLog

Turn = tuple[int, int, int]  # roll, pitch, yaw [deg], -180 to 180, in the sense of Betaflight's align_board_*
NOT_TURNED: Turn = (0, 0, 0)
_PIN = re.compile(r"P?([A-H])([0-9]{1,2})")


@dataclass(frozen=True, order=True)
class Pin:
    """A pin of the processor."""

    port: str  # A to H
    number: int  # 0 to 15

    def __str__(self) -> str:
        """Return its name, PB4."""
        return f"P{self.port}{self.number}"

    @property
    def code(self) -> int:
        """Return its number in a board's description: port << 4 | number."""
        return (ord(self.port) - ord("A")) << 4 | self.number

    @staticmethod
    def of(text: str) -> Pin:
        """Return the pin that is called PB4, B4 or B04. Raises ValueError, one line."""
        found = _PIN.fullmatch(text)
        if found is None or int(found[2]) > 15:
            raise ValueError(f"pin {text[:60]!r}, expected a port A to H and a number 0 to 15, as PB4")
        return Pin(found[1], int(found[2]))


@dataclass(frozen=True)
class Bus:
    """An SPI and its pins."""

    sck: Pin
    miso: Pin
    mosi: Pin


@dataclass(frozen=True)
class Uart:
    """The pins of a USART or UART that the board brings out; None: not this one."""

    tx: Pin | None
    rx: Pin | None


@dataclass(frozen=True)
class GyroPlace:
    """The place of a gyro chip."""

    spi: int  # 1 to 3; 0: not told, so that it can only be held deselected
    select: Pin
    ready: Pin | None  # its data-ready line; None: not told
    alignment: int  # quarter turns clockwise seen from above, and 4 for a chip on the underside


@dataclass(frozen=True)
class Chip:
    """A further chip on an SPI."""

    spi: int
    select: Pin


@dataclass(frozen=True)
class Board:
    """A kind of board. None, 0 or an empty tuple: it has none, or nobody tells."""

    name: str
    maker: str  # four letters
    gyro_kinds: tuple[str, ...]  # chips that boards of this name carry, in the ecosystem's words: MPU6000
    gyros: tuple[GyroPlace, ...]  # that first which its maker has in use
    buses: dict[int, Bus]
    uarts: dict[int, Uart]
    receiver: int | None  # UART that its maker wires the receiver to
    motors: tuple[Pin, ...]  # in the order of motors
    log_kind: BoardLog
    log_chip: Chip | None
    flash_kinds: tuple[str, ...]  # of a flash chip: W25Q128FV
    osd: Chip | None
    led: Pin | None
    led_high: bool  # high lights it
    beeper: Pin | None
    beeper_high: bool  # high sounds
    usb_supply: Pin | None
    volts: Pin | None
    amps: Pin | None
    volts_scale: int  # [0.1], volts at the pack for one at the pin
    amps_scale: int  # [0.1 mV/A]
    turn_deg: Turn = NOT_TURNED  # of the whole board, by its maker
