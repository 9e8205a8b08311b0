"""SPI1 as master: the rules of its set-up, and injected bit errors. Bytes move in C (native/c/spi.c)."""

from __future__ import annotations

import random
from collections.abc import Sequence
from typing import Any, NoReturn, Protocol

from sim.board.native.library import Native, NativeDevice
from sim.board.peripherals.gpio import Pins
from sim.board.registers.bus import load_table


class SpiSlave(Protocol):
    """The chip on the bus."""

    def exchange(self, sent: Sequence[int], transaction: int, hz: float, mode: int) -> bytes:
        """Bytes in, as many bytes out. transaction: its number; hz: of the clock; mode: 0..3."""
        ...


class Spi(NativeDevice):
    """SPI1, frames of 8 bits."""

    def __init__(self, native: Native, pins: Pins, slave: SpiSlave, seed: int = 0) -> None:
        irq = load_table().interrupt("SPI1")
        super().__init__(native, "SPI1", native.library.SPI, alarm="spi1.byte", interrupts=(irq,))
        self._pins = pins
        self._random = random.Random(seed)
        self._bit_error_rate = 0.0
        native.on_exchange = slave.exchange
        native.on_errors = self._with_errors
        lib = native.library
        self.queries = {
            lib.QUERY_SEND: lambda a, b: self.validate(),
            lib.QUERY_BUSY: lambda a, b: self.reject_busy(),
            lib.QUERY_FULL: lambda a, b: self.reject_full(),
        }

    @property
    def bit_error_rate(self) -> float:
        """Of received bits, as injected by a fault campaign."""
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

    def reject_busy(self) -> NoReturn:
        """CR1 changes meanwhile."""
        self.context.fail("SPI1_CR1 is changed while a transfer is under way, expected SPI1_SR BSY 0")

    def reject_full(self) -> NoReturn:
        """DR is written once too often."""
        self.context.fail("SPI1_DR is written while its FIFO is full, expected SPI1_SR TXE before")

    def validate(self) -> None:
        """Fail unless all is set up for bytes to be sent."""
        fail = self.context.fail
        if not self.get("CR1", "MSTR"):
            fail("SPI1 sends with CR1 MSTR 0, expected a master")
        if not (self.get("CR1", "SSM") and self.get("CR1", "SSI")):
            fail(
                "SPI1 sends with CR1 SSM or SSI 0, expected both 1: else it takes its own select for a fault"
            )
        if self.get("CR2", "DS") != 7:
            fail(f"SPI1 sends frames of {self.get('CR2', 'DS') + 1} bits, expected 8")
        if self.get("CR1", "LSBFIRST"):
            fail("SPI1 sends with CR1 LSBFIRST 1, expected the most significant bit first")
        if self.words["CR2"] & 1 and not self.get("CR2", "FRXTH"):
            fail("SPI1 receives by DMA with CR2 FRXTH 0: bytes come in pairs, expected FRXTH 1")
        for signal in ("SPI1_SCK", "SPI1_MISO", "SPI1_MOSI"):
            self._pins.expect(signal, "SPI1 sends")

    def state(self) -> Any:  # noqa: ANN401
        return {"rate": self._bit_error_rate, "random": self._random.getstate()}

    def restore(self, state: Any) -> None:  # noqa: ANN401
        self.bit_error_rate = state["rate"]
        self._random.setstate(state["random"])
