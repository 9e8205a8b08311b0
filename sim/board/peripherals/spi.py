"""SPI1 to SPI3 as masters: the rules of their set-up, and bit errors. Bytes move in C (native/c/spi.c)."""

from __future__ import annotations

import random

from neuroflight.sim.board.native.library import Native, NativeDevice
from neuroflight.sim.board.peripherals.gpio import PORTS, Pins, place
from neuroflight.sim.board.registers.bus import load_table

SPIS = ("SPI1", "SPI2", "SPI3")  # in C's order


class Spi(NativeDevice):
    """One of SPIS, frames of 8 bits."""

    def __init__(self, native: Native, name: str, pins: Pins) -> None:
        irq, lib = load_table().interrupt(name), native.library
        alarm = f"{name.lower()}.byte"
        super().__init__(native, name, lib.SPI, SPIS.index(name), alarm=alarm, interrupts=(irq,))
        self._pins = pins
        if (signal := pins.signals.get(f"{name}_MISO")) is not None:
            lib.native_miso(native.handle, SPIS.index(name), *place(signal[0]))
        self.queries = {
            lib.QUERY_SEND: lambda a, b: self._validate(),
            lib.QUERY_BUSY: "{name}_CR1 is changed while a transfer is under way, expected {name}_SR BSY 0",
            lib.QUERY_SELECTED: lambda one, other: self.engine.fail(
                f"{name} moves a byte with two chips selected, by {_pin(one)} and {_pin(other)}, expected one"
            ),
            lib.QUERY_FULL: "{name}_DR is written while its FIFO is full, expected {name}_SR TXE before",
        }

    def _validate(self) -> None:
        """Fail unless all is set up for bytes to be sent."""
        name, fail = self.name, self.engine.fail
        if not self.get("CR1", "MSTR"):
            fail(f"{name} sends with CR1 MSTR 0, expected a master")
        if not (self.get("CR1", "SSM") and self.get("CR1", "SSI")):
            fail(
                f"{name} sends with CR1 SSM or SSI 0, expected both 1: "
                "else it takes its own select for a fault"
            )
        if self.get("CR2", "DS") != 7:
            fail(f"{name} sends frames of {self.get('CR2', 'DS') + 1} bits, expected 8")
        if self.get("CR1", "LSBFIRST"):
            fail(f"{name} sends with CR1 LSBFIRST 1, expected the most significant bit first")
        if self.words["CR2"] & 1 and not self.get("CR2", "FRXTH"):
            fail(f"{name} receives by DMA with CR2 FRXTH 0: bytes come in pairs, expected FRXTH 1")
        for line in ("SCK", "MISO", "MOSI"):
            self._pins.expect(f"{name}_{line}", f"{name} sends")


class GyroSpi(Spi):
    """The SPI behind which C finds the gyro chip, and faults of the bits that it receives from there."""

    kept = ("_random", "bit_error_rate", "stuck")

    def __init__(self, native: Native, name: str, pins: Pins, seed: int = 0) -> None:
        super().__init__(native, name, pins)
        self._random = random.Random(seed)
        self._bit_error_rate, self._stuck = 0.0, -1
        native.on_errors = self._with_errors

    @property
    def bit_error_rate(self) -> float:
        """Rate of received bits that flip, as injected by a fault campaign."""
        return self._bit_error_rate

    @bit_error_rate.setter
    def bit_error_rate(self, rate: float) -> None:
        self._bit_error_rate = rate
        self._tell()

    @property
    def stuck(self) -> int:
        """Level of a line from the chip that has come off or is shorted, likewise; -1: none such."""
        return self._stuck

    @stuck.setter
    def stuck(self, level: int) -> None:
        self._stuck = level
        self._tell()

    def _tell(self) -> None:
        self.native.library.native_bit_errors(
            self.native.handle, self._bit_error_rate > 0.0 or self._stuck >= 0
        )

    def _with_errors(self, received: bytes) -> bytes:
        if self._stuck >= 0:
            return bytes([0xFF * self._stuck] * len(received))
        return bytes(
            byte ^ sum((self._random.random() < self._bit_error_rate) << bit for bit in range(8))
            for byte in received
        )


def _pin(code: int) -> str:
    return f"P{PORTS[code >> 4]}{code & 15}"
