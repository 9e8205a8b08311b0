"""SPI1 as master: bytes between the image and the chip on the bus, each taking its eight clocks.

One alarm marks the end of a transfer by DMA; whoever looks before sees the bytes that have passed until then.
"""

from __future__ import annotations

import random
from collections.abc import Sequence
from typing import Any, NoReturn, Protocol

from sim.board.core.context import TIME_HZ, Context
from sim.board.peripherals.dma import DmaSystem
from sim.board.peripherals.gpio import Pins
from sim.board.peripherals.rcc import Clocks
from sim.board.registers.bus import Device, load_table

FIFO_BYTES = 4
_LEVELS = (0, 1, 2, 3, 3)  # FRLVL and FTLVL by bytes: quarter, half, full (RM0431 SPI status register)
_RXNE, _TXE, _OVR, _BSY = 1 << 0, 1 << 1, 1 << 6, 1 << 7


class SpiSlave(Protocol):
    """A chip on the bus; it knows itself whether it is selected."""

    def exchange(self, sent: Sequence[int], hz: float, mode: int) -> list[int] | None:
        """Bytes in, as many bytes out; None: not selected. `hz`: of the clock, `mode`: 0..3."""
        ...


class Spi(Device):
    """SPI1, frames of 8 bits."""

    kept = ("_sending", "_received", "_last", "_begun", "_overrun", "bit_error_rate", "_apb2")

    def __init__(self, context: Context, dma: DmaSystem, pins: Pins, slave: SpiSlave, seed: int = 0) -> None:
        super().__init__(context, "SPI1")
        self._dma, self._pins, self._slave = dma, pins, slave
        self._irq = load_table().interrupt("SPI1")
        self._alarm = context.alarm("spi1.byte", self._wake)
        self._apb2 = TIME_HZ // 2
        self._random = random.Random(seed)
        self.bit_error_rate = 0.0  # of received bits, as injected by a fault campaign
        self._begin()
        dma.connect("SPI1_TX", self)
        dma.connect("SPI1_RX", self)

    def _begin(self) -> None:
        self._sending: list[int] = []  # the byte in the shift register first
        self._received: list[int] = []
        self._last = 0
        self._begun: int | None = None  # cycle at which the byte in the shift register began
        self._overrun = False

    @property
    def interrupts(self) -> tuple[int, ...]:
        return (self._irq,)

    def reset(self) -> None:
        super().reset()
        self._begin()
        self._alarm.cancel()
        self.context.irq(self._irq, False)

    def set_clock(self, clocks: Clocks) -> None:
        """The clock tree has changed."""
        self.sync()
        self._apb2 = clocks.apb2
        self._plan()

    @property
    def clock_hz(self) -> float:
        """Of SCK, as set."""
        return self._apb2 / (2 << self.get("CR1", "BR"))

    @property
    def byte_cycles(self) -> int:
        """How long a byte takes."""
        return 8 * (2 << self.get("CR1", "BR")) * TIME_HZ // self._apb2

    def sync(self) -> None:
        """Move the bytes that have passed up to now."""
        while self._begun is not None:
            done = (self.context.cycle - self._begun) // self.byte_cycles
            done = min(done, len(self._sending) + self._from_memory())
            self._fetch(done)
            if not done:
                return
            self._exchange(done)
            self._begun = self._begun + done * self.byte_cycles if self._sending else None
            self._update_irq()
        self._fetch(0)

    def dma_changed(self) -> None:
        self.sync()
        self._start()

    # What the image reads and writes

    def write_cr1(self, value: int) -> None:
        self.sync()
        changed = self.keep("CR1", value)
        if changed & self.mask("CR1", "SPE") and not self.get("CR1", "SPE"):
            self._sending, self._begun = [], None  # what is on the wire is lost
        elif changed & ~self.mask("CR1", "SPE") and self._begun is not None:
            self.refuse_busy()
        self._start()

    def write_cr2(self, value: int) -> None:
        self.sync()
        self.keep("CR2", value)
        self._start()
        self._update_irq()

    def read_sr(self) -> int:
        self.sync()
        return self._status()

    def write_sr(self, value: int) -> None:
        """Only the checksum's error can be cleared, which is not modelled."""

    def sized_read_dr(self, size: int) -> int:
        self.sync()
        value = 0
        for i in range(min(size, 2)):  # a half-word takes two frames of 8 bits
            if self._received:
                self._last = self._received.pop(0)
            value |= self._last << 8 * i
        self._overrun = False
        self._update_irq()
        return value

    def sized_write_dr(self, size: int, value: int) -> None:
        self.sync()
        for i in range(min(size, 2)):
            if self._level() >= FIFO_BYTES:
                self.refuse_full()
            self._sending.append(value >> 8 * i & 0xFF)
        self._start()
        self._update_irq()

    # Transfer

    def _from_memory(self) -> int:
        if not self.words["CR1"] & 1 << 6 or not self.words["CR2"] & 2:  # SPE, TXDMAEN
            return 0
        return self._dma.available("SPI1_TX")

    def _level(self) -> int:
        """Bytes in the transmit FIFO, without the one in the shift register."""
        return len(self._sending) - (self._begun is not None)

    def _fetch(self, done: int) -> None:
        """Take from memory what finds room when `done` more bytes have passed."""
        while True:  # a circular stream may begin anew on the way
            room = done + FIFO_BYTES + (self._begun is not None) - len(self._sending)
            count = min(room, self._from_memory())
            if count <= 0:
                return
            self._sending += self._dma.take("SPI1_TX", count)

    def _start(self) -> None:
        """Begin with what waits, if anything does, and set the alarm."""
        if self._begun is None and self.words["CR1"] & 1 << 6:
            self._fetch(0)
            if self._sending:
                self.judge()
                self._begun = self.context.cycle
                self._fetch(0)
        self._plan()

    def _plan(self) -> None:
        self._alarm.cancel()
        if self._begun is None:
            return
        left = len(self._sending) + self._from_memory()
        if self.get("CR2", "RXNEIE") or self.get("CR2", "TXEIE"):
            left = 1
        elif self.words["CR2"] & 1:  # RXDMAEN
            left = min(left, self._dma.available("SPI1_RX") or left)
        else:
            return
        self._alarm.set(self._begun + left * self.byte_cycles)

    def _wake(self) -> None:
        self.sync()
        self._start()

    def _exchange(self, count: int) -> None:
        sent, self._sending = self._sending[:count], self._sending[count:]
        mode = 2 * self.get("CR1", "CPOL") + self.get("CR1", "CPHA")
        answer = self.answer(sent, self.clock_hz, mode)
        if self.words["CR2"] & 1:
            taken = min(self._dma.available("SPI1_RX"), count)
            if taken:
                self._dma.give("SPI1_RX", answer[:taken])
                answer = answer[taken:]
        self._received += answer
        if len(self._received) > FIFO_BYTES:
            del self._received[FIFO_BYTES:]
            self._overrun = True

    def refuse_busy(self) -> NoReturn:
        """CR1 changes meanwhile."""
        self.context.fail("SPI1_CR1 is changed while a transfer is under way, expected SPI1_SR BSY 0")

    def refuse_full(self) -> NoReturn:
        """DR is written once too often."""
        self.context.fail("SPI1_DR is written while its FIFO is full, expected SPI1_SR TXE before")

    def answer(self, sent: Sequence[int], hz: float, mode: int) -> list[int]:
        """What the chip on the bus answers, bit errors included."""
        answer = self._slave.exchange(sent, hz, mode)
        if answer is None:
            answer = [0xFF if self._pins.pull("PA6") else 0x00] * len(sent)
        if self.bit_error_rate:
            answer = [self._with_errors(byte) for byte in answer]
        return answer

    def _with_errors(self, byte: int) -> int:
        for bit in range(8):
            byte ^= (self._random.random() < self.bit_error_rate) << bit
        return byte

    def judge(self) -> None:
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

    def _status(self) -> int:
        level, received = self._level(), len(self._received)
        enough = 1 if self.get("CR2", "FRXTH") else 2
        return (
            _RXNE * (received >= enough)
            | _TXE * (level <= FIFO_BYTES // 2)
            | _OVR * self._overrun
            | _BSY * (self._begun is not None)
            | _LEVELS[received] << 9
            | _LEVELS[max(level, 0)] << 11
        )

    def _update_irq(self) -> None:
        status, enables = self._status(), self.words["CR2"]
        wanted = (
            status & _RXNE and enables & self.mask("CR2", "RXNEIE"),
            status & _TXE and enables & self.mask("CR2", "TXEIE"),
            status & _OVR and enables & self.mask("CR2", "ERRIE"),
        )
        self.context.irq(self._irq, any(wanted))

    def state(self) -> Any:  # noqa: ANN401
        return {**super().state(), "random": self._random.getstate()}

    def restore(self, state: Any) -> None:  # noqa: ANN401
        super().restore(state)
        self._random.setstate(state["random"])
