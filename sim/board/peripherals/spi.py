"""SPI1 and SPI3 as masters: the rules of their set-up, and bit errors. Bytes move in C (native/c/spi.c)."""

from __future__ import annotations

import random
from collections.abc import Sequence
from typing import Any, NoReturn, Protocol

from neuroflight.sim.board.native.library import Native, NativeDevice
from neuroflight.sim.board.peripherals.gpio import Pins
from neuroflight.sim.board.registers.bus import load_table


class SpiSlave(Protocol):
    """The chip on the bus."""

    def exchange(self, sent: Sequence[int], transaction: int, hz: float, mode: int) -> bytes:
        """Exchange bytes. transaction: its number; hz: of the clock; mode: 0..3."""
        ...


SPIS = ("SPI1", "SPI3")  # in C's order


class Spi(NativeDevice):
    """One of SPIS, frames of 8 bits."""

    def __init__(self, native: Native, name: str, pins: Pins) -> None:
        irq, lib = load_table().interrupt(name), native.library
        alarm = f"{name.lower()}.byte"
        super().__init__(native, name, lib.SPI, SPIS.index(name), alarm=alarm, interrupts=(irq,))
        self._pins = pins
        self.queries = {
            lib.QUERY_SEND: lambda a, b: self.validate(),
            lib.QUERY_BUSY: lambda a, b: self.reject_busy(),
            lib.QUERY_FULL: lambda a, b: self.reject_full(),
        }

    def reject_busy(self) -> NoReturn:
        """Fail: CR1 is changed during a transfer."""
        self.context.fail(
            f"{self.name}_CR1 is changed while a transfer is under way, expected {self.name}_SR BSY 0"
        )

    def reject_full(self) -> NoReturn:
        """Fail: DR is written while the FIFO is full."""
        self.context.fail(
            f"{self.name}_DR is written while its FIFO is full, expected {self.name}_SR TXE before"
        )

    def validate(self) -> None:
        """Fail unless all is set up for bytes to be sent."""
        name, fail = self.name, self.context.fail
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
    """SPI1 with the gyro chip, and bit errors on received bytes."""

    def __init__(self, native: Native, pins: Pins, slave: SpiSlave, seed: int = 0) -> None:
        super().__init__(native, "SPI1", pins)
        self._random = random.Random(seed)
        self._bit_error_rate = 0.0
        native.on_exchange = slave.exchange
        native.on_errors = self._with_errors

    @property
    def bit_error_rate(self) -> float:
        """Rate of received bits that flip, as injected by a fault campaign."""
        return self._bit_error_rate

    @bit_error_rate.setter
    def bit_error_rate(self, rate: float) -> None:
        self._bit_error_rate = rate
        self.native.library.native_bit_errors(self.native.handle, rate > 0.0)

    def _with_errors(self, received: bytes) -> bytes:
        return bytes(self._with_bit_errors(byte) for byte in received)

    def _with_bit_errors(self, byte: int) -> int:
        for bit in range(8):
            byte ^= (self._random.random() < self._bit_error_rate) << bit
        return byte

    def state(self) -> Any:  # noqa: ANN401
        return {"rate": self._bit_error_rate, "random": self._random.getstate()}

    def restore(self, state: Any) -> None:  # noqa: ANN401
        self.bit_error_rate = state["rate"]
        self._random.setstate(state["random"])
