"""USART1 to 3, UART4 and UART5: bytes that take their time on a line of a stated format.

The other end speaks a format of its own. Where it is not the image's, a byte arrives broken with a framing
error, as on a wire; `mismatches` counts them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.core.engine import Engine
from neuroflight.sim.board.peripherals.dma import DmaSystem
from neuroflight.sim.board.peripherals.gpio import Pins
from neuroflight.sim.board.registers.bus import Device, load_table

_PE, _FE, _ORE, _IDLE, _RXNE, _TC, _TXE = (1 << i for i in (0, 1, 3, 4, 5, 6, 7))
_BUSY, _TEACK = 1 << 16, 1 << 21
_STOP_BITS = (1.0, 0.5, 2.0, 1.5)  # CR2 STOP
_BAUD_TOLERANCE = 0.03  # between both ends (RM0431, tolerance of the receiver: 3.3 % and more)
# What may only change while the USART is off (RM0431, register descriptions).
_FIXED = {
    "CR1": ("M0", "M1", "OVER8", "PCE", "PS"),
    "CR2": ("STOP", "RXINV", "TXINV", "SWAP"),
    "CR3": ("HDSEL", "ONEBIT", "OVRDIS", "DDRE"),
    "BRR": ("BRR",),
}


# What interrupts: the bit of CR1 that lets it, and flags of ISR.
_CAUSES = {"RXNEIE": _RXNE | _ORE, "IDLEIE": _IDLE, "TCIE": _TC, "TXEIE": _TXE, "PEIE": _PE}


@dataclass(frozen=True)
class Format:
    """Format of bytes on a line."""

    baud: float
    data_bits: int = 8
    parity: str = "N"  # N, E or O
    stop_bits: float = 1.0
    inverted: bool = False

    def __str__(self) -> str:
        """Format it, such as 100000 baud 8E2 inverted."""
        inverted = " inverted" if self.inverted else ""
        return f"{self.baud:.0f} baud {self.data_bits}{self.parity}{self.stop_bits:g}{inverted}"

    @cached_property
    def byte_cycles(self) -> int:
        """Duration of a byte on the line [cycles]."""
        bits = 1 + self.data_bits + (self.parity != "N") + self.stop_bits
        return round(bits * TIME_HZ / self.baud)

    def understands(self, sender: Format) -> bool:
        """Return True if a receiver of this format gets the bytes of `sender`."""
        return (
            abs(sender.baud / self.baud - 1.0) <= _BAUD_TOLERANCE
            and (sender.data_bits, sender.parity, sender.inverted)
            == (self.data_bits, self.parity, self.inverted)
            and sender.stop_bits >= self.stop_bits
        )


SBUS = Format(100_000, parity="E", stop_bits=2.0, inverted=True)
CRSF = Format(416_666)


class Usart(Device):
    """One USART."""

    kept = (
        "words", "_arriving", "_line_free", "_idle_at", "_received", "_holding", "_shifting", "_sent_at",
        "_mismatches", "_lost", "sent",
    )  # fmt: skip

    def __init__(
        self, engine: Engine, name: str, dma: DmaSystem, pins: Pins, clock: Callable[[str], int]
    ) -> None:
        super().__init__(engine, name)
        self._pins, self._clock = pins, clock
        self._irq = load_table().interrupt(name)
        self._rx = engine.alarm(f"{name.lower()}.rx", self._arrive)
        self._tx = engine.alarm(f"{name.lower()}.tx", self._sent)
        self._idle = engine.alarm(f"{name.lower()}.idle", self._update)
        self.on_sent: Callable[[int], None] = lambda byte: None  # a byte has left the board
        # The program in the ROM polls: it takes a byte by its pin, to measure it, or finds one to read.
        self.on_measured: Callable[[int, Format], bool] = lambda byte, sender: False
        self.on_received: Callable[[], None] = lambda: None
        self._mismatches = self._lost = self.sent = 0
        # What would interrupt when bytes come or the line rests, of CR1 and CR3.
        self._own_interrupts = (self.mask("CR1", "RXNEIE", "IDLEIE", "PEIE"), self.mask("CR3", "EIE"))
        self._receiver = self.mask("CR1", "UE", "RE")
        self._receiving_dma = self.mask("CR3", "DMAR")
        self._causes = tuple((flags, self.mask("CR1", name)) for name, flags in _CAUSES.items())
        self._format_key, self._format = (0, 0, 0, 0), SBUS  # the registers and clock of that format
        self._arriving: list[tuple[int, int, Format, bool]] = []  # end, byte, format, parity is wrong
        self._line_free = 0  # cycle at which the last byte of `_arriving` ends
        self._begin()
        self._receive, self._send = (dma.connect(f"{name}_{way}", self) for way in ("RX", "TX"))

    def _begin(self) -> None:
        self._idle_at: int | None = None  # cycle at which the line has rested for a byte
        self._received = 0
        self._holding: int | None = None  # TDR, while the shift register is busy
        self._shifting: int | None = None
        self._sent_at = 0  # cycle at which the byte in the shift register has gone

    def reset(self) -> None:
        super().reset()
        self._begin()
        self._tx.cancel()
        self._idle.cancel()
        self._plan_arrival()  # bytes on the line come all the same
        self.engine.irq(self._irq, False)

    @property
    def format(self) -> Format:
        """Format set by the image."""
        words = self.words
        key = (words["BRR"], words["CR1"], words["CR2"], self._clock(self.name))
        if key != self._format_key:
            self._format_key, self._format = key, self._set_format()
        return self._format

    def _set_format(self) -> Format:
        divider, clock = self.words["BRR"], self._clock(self.name)
        if self.get("CR1", "OVER8"):
            divider = divider & 0xFFF0 | (divider & 7) << 1
            clock *= 2
        if divider < 16:
            self.engine.fail(f"{self.name}_BRR is 0x{self.words['BRR']:X}, expected 16 or more")
        word = 8 + self.get("CR1", "M0") - self.get("CR1", "M1")
        checked = self.get("CR1", "PCE")
        parity = ("EO"[self.get("CR1", "PS")]) if checked else "N"
        inverted = bool(self.get("CR2", "RXINV"))
        return Format(clock / divider, word - checked, parity, _STOP_BITS[self.get("CR2", "STOP")], inverted)

    # For the loop

    @property
    def arriving(self) -> int:
        """Bytes on the line that have not arrived completely."""
        self.sync()
        return len(self._arriving)

    @property
    def mismatches(self) -> int:
        """Bytes that came in another format."""
        self.sync()
        return self._mismatches

    @property
    def lost(self) -> int:
        """Bytes that arrived while the receiver was off or had not been read."""
        self.sync()
        return self._lost

    def feed(self, data: bytes, format: Format, *, end: int | None = None, broken: Sequence[int] = ()) -> int:
        """Put bytes on the line, one after another; return the cycle at which the last one ends.

        `end`: that cycle, if it is given; not before the bytes already on the line allow.
        `broken`: indices of bytes with a wrong parity bit (or, without parity, a broken stop bit).
        """
        time = format.byte_cycles
        begin = max(self._line_free, self.engine.cycle)
        if end is not None:
            begin = max(begin, end - time * len(data))
        for i, byte in enumerate(data):
            self._arriving.append((begin + (i + 1) * time, byte, format, i in broken))
        self._line_free = begin + time * len(data)
        self._plan_arrival()
        return self._line_free

    def sync(self) -> None:
        """Receive the bytes that have arrived by now."""
        if self._arriving and self._arriving[0][0] <= self.engine.cycle:
            self._arrive()

    def dma_changed(self) -> None:
        self.sync()
        if self.words["ISR"] & _RXNE:
            self._hand_over()
        self._load()
        self._plan_arrival()
        self._update()

    # What the image reads and writes

    def write_cr1(self, value: int) -> None:
        self.sync()
        was_on = self.words["CR1"] & 1
        changed = self.words["CR1"] ^ value
        if was_on and value & 1:
            self._reject_fixed("CR1", changed)
        self.keep("CR1", value)
        if not self.words["CR1"] & 1:
            self._begin()
            self._tx.cancel()
            self.words["ISR"] = self.block.registers["ISR"].reset
        ready = self.words["CR1"] & 1 and self.get("CR1", "TE")
        self.words["ISR"] = self.words["ISR"] & ~_TEACK | (_TEACK if ready else 0)
        if changed & self.words["CR1"] & 1:
            _ = self.format  # validated when the USART goes on
        self._load()
        self._plan_arrival()
        self._update()

    def write_cr2(self, value: int) -> None:
        self._write_fixed("CR2", value)

    def write_cr3(self, value: int) -> None:
        self.sync()
        self._write_fixed("CR3", value)
        self.dma_changed()
        self._plan_arrival()

    def write_brr(self, value: int) -> None:
        self._write_fixed("BRR", value)

    def write_rqr(self, value: int) -> None:
        self.sync()
        if value & self.mask("RQR", "RXFRQ"):
            self.words["ISR"] &= ~_RXNE
        if value & self.mask("RQR", "TXFRQ"):
            self._holding = None
            self.words["ISR"] |= _TXE
        self._update()

    def read_isr(self) -> int:
        self.sync()
        self._update()
        if self._arriving:
            end, _, sender, _ = self._arriving[0]
            if end - sender.byte_cycles <= self.engine.cycle:
                return self.words["ISR"] | _BUSY
        return self.words["ISR"]

    def write_icr(self, value: int) -> None:
        self.sync()
        self._update()
        # Flags are cleared by bits in their own places (RM0431, interrupt flag clear register).
        self.words["ISR"] &= ~(value & 0x15F)
        self._update()

    def read_rdr(self) -> int:
        self.sync()
        self.words["ISR"] &= ~_RXNE
        self._update()
        return self._received

    def write_tdr(self, value: int) -> None:
        if not self.words["CR1"] & 1 or not self.get("CR1", "TE"):
            self.engine.fail(f"{self.name}_TDR is written while UE or TE is 0")
        if not self.words["ISR"] & _TXE:
            self.engine.fail(f"{self.name}_TDR is written while ISR TXE is 0: a byte would be lost")
        self._holding = value & 0xFF
        self.words["ISR"] &= ~(_TXE | _TC)
        self._load()
        self._update()

    # Receiving

    def _plan_arrival(self) -> None:
        """Set the alarm for the next byte; a byte for DMA without an interrupt may be received later."""
        due = self._arriving[0][0] if self._arriving else None
        quiet = self._takes_by_dma() and not self._interrupts()
        self._receive.wake(self._rx, due if quiet else None)
        if due is not None and not quiet:
            self._rx.set(due)

    def _interrupts(self) -> int:
        return self.words["CR1"] & self._own_interrupts[0] or self.words["CR3"] & self._own_interrupts[1]

    def _takes_by_dma(self) -> bool:
        on = self.words["CR1"] & self._receiver == self._receiver and self._receives_by_dma()
        return bool(on and not self.words["ISR"] & _RXNE and self._receive.available)

    def _arrive(self) -> None:
        now, count = self.engine.cycle, 0
        if self._takes_by_dma():
            own, sender = self.format, self._arriving[0][2]
            for end, _, format, broken in self._arriving:
                if end > now or format is not sender or broken:
                    break
                count += 1
            if self._receive.circular and own.understands(sender):
                self._take(count, own)
        while self._arriving and self._arriving[0][0] <= now:
            self._take_next()
        self._plan_arrival()

    def _take(self, count: int, own: Format) -> None:
        """Write the next bytes, in a format that is understood, to memory."""
        self._pins.expect(f"{self.name}_RX", f"{self.name} receives")
        taken, self._arriving = self._arriving[:count], self._arriving[count:]
        time = own.byte_cycles
        for end, byte, sender, _ in taken:
            if self._idle_at is not None and end - sender.byte_cycles >= self._idle_at:
                self.words["ISR"] |= _IDLE
            self._idle_at = end + time
            self._received = self._with_parity(byte, own)
        if taken:
            self._receive.give([byte for _, byte, _, _ in taken])
            self._update()

    def _with_parity(self, byte: int, own: Format, broken: bool = False) -> int:
        parity = byte.bit_count() & 1 ^ (own.parity == "O") ^ broken
        return byte | (parity << own.data_bits if own.parity != "N" else 0)

    def _take_next(self) -> None:
        now, byte, sender, broken = self._arriving.pop(0)
        if self.on_measured(byte, sender):
            return
        if not self.words["CR1"] & 1 or not self.get("CR1", "RE"):
            self._lost += 1
            return
        self._pins.expect(f"{self.name}_RX", f"{self.name} receives")
        own = self.format
        flags = 0
        if not own.understands(sender):
            self._mismatches += 1
            self.engine.note(f"{self.name} listens at {own}, but is sent {sender}")
            byte, flags = byte ^ 0xFF, _FE
        elif broken:
            flags = _PE if own.parity != "N" else _FE
        self._idle_at = now + own.byte_cycles
        if self.words["ISR"] & _RXNE:
            self._lost += 1
            if not self.get("CR3", "OVRDIS"):
                self.words["ISR"] |= _ORE
                self._update()
                return
        self._received = self._with_parity(byte, own, broken)
        self.words["ISR"] |= flags | _RXNE
        self._hand_over()
        self._update()
        self.on_received()

    def _receives_by_dma(self) -> int:
        return self.words["CR3"] & self._receiving_dma

    def _hand_over(self) -> None:
        """Let DMA take the byte that was received, if it takes any."""
        if self._receives_by_dma() and self._receive.available:
            self.words["ISR"] &= ~_RXNE
            self._receive.give([self._received])

    # Sending

    def _load(self, begin: int | None = None) -> None:
        """Fill the data register from memory and the shift register from that, at `begin` or now."""
        if not self.words["CR1"] & 1 or not self.get("CR1", "TE"):
            return
        for _ in range(2):
            if self._holding is None and self.get("CR3", "DMAT") and self._send.available:
                self._holding = self._send.take(1)[0] & 0xFF
                self.words["ISR"] &= ~(_TXE | _TC)
            if self._shifting is None and self._holding is not None:
                self._pins.expect(f"{self.name}_TX", f"{self.name} sends")
                self._shifting, self._holding = self._holding, None
                self.words["ISR"] |= _TXE
                self._sent_at = (self.engine.cycle if begin is None else begin) + self.format.byte_cycles
                self._tx.set(self._sent_at)

    def _sent(self) -> None:
        byte, self._shifting = self._shifting, None
        assert byte is not None
        self.sent += 1
        self._load(self._sent_at)
        if self._shifting is None:
            self.words["ISR"] |= _TC
        self.on_sent(byte)
        self._update()

    # Flags and interrupt

    def _update(self) -> None:
        words = self.words
        if self._idle_at is not None:
            if self.engine.cycle >= self._idle_at:
                busy = (
                    self._arriving and self._arriving[0][0] - self._arriving[0][2].byte_cycles < self._idle_at
                )
                self._idle_at = None
                if not busy:
                    words["ISR"] |= _IDLE
            elif self.get("CR1", "IDLEIE"):
                self._idle.set(self._idle_at)
        flags, lets = words["ISR"], words["CR1"]
        wanted = flags & (_FE | _ORE) and self.get("CR3", "EIE") and self.get("CR3", "DMAR")
        for raised, enable in self._causes:
            wanted = wanted or (flags & raised and lets & enable)
        self.engine.irq(self._irq, bool(wanted))

    def _write_fixed(self, register: str, value: int) -> None:
        if self.words["CR1"] & 1:
            self._reject_fixed(register, self.words[register] ^ value)
        self.keep(register, value)

    def _reject_fixed(self, register: str, changed: int) -> None:
        names = [f for f in _FIXED[register] if changed & self.mask(register, f)]
        if names:
            self.engine.fail(f"{self.name}_{register} {', '.join(names)} changes while UE is 1, expected 0")
