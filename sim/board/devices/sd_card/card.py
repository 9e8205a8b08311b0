"""An SD card on its SPI lines: bytes in, bytes out, its power, and faults.

Time is the cycle at which each byte begins. Between two bytes nothing of the card is computed: events
meanwhile take effect, at their own cycle, when the next byte passes.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

from neuroflight.sim.board.core.context import TIME_HZ, BoardError, Kept
from neuroflight.sim.board.core.engine import NEVER
from neuroflight.sim.board.devices.sd_card.delays import CardTiming, Delays
from neuroflight.sim.board.devices.sd_card.faults import CardFault, Cut, Event, Events, LineErrors
from neuroflight.sim.board.devices.sd_card.image import CardImage
from neuroflight.sim.board.devices.sd_card.protocol import COMMAND_BYTES, Protocol, State
from neuroflight.sim.board.devices.sd_card.registers import BUSY, RELEASED
from neuroflight.sim.board.devices.sd_card.store import Store

START_HZ, FULL_HZ = 400_000, 25_000_000  # SCK at most, until the card is initialised and then (6.5, 7.5)
START_CLOCKS = 74  # with the select line high, before the first command (6.4.1)
SUPPLY = TIME_HZ // 1000  # from power to those clocks, 1 ms at least (6.4.1) [cycles]


def _raise(message: str) -> NoReturn:
    raise BoardError(message)


class SdCard(Kept):
    """One SDHC card. It has its image file alone until `close`."""

    kept = ("_fitted", "_powered", "_hot", "_powered_at", "_clocks", "_frame", "_transaction")

    def __init__(
        self, path: Path, *, seed: int = 0, timing: CardTiming | None = None, erased: int = 0x00
    ) -> None:
        """path: of a raw image. seed: of times and faults. erased: value of erased bytes, 0x00 or 0xFF.

        Raises LinkError for a file that cannot be a card.
        """
        assert erased in (0x00, 0xFF)
        self.image = CardImage(path)
        self.fail: Callable[[str], NoReturn] = _raise  # called with an error of the host; does not return
        self.on_power_cut: Callable[[], None] = lambda: None  # a scripted one: the board loses its power
        self._delays = Delays(timing or CardTiming(), seed)
        self._store = Store(self.image, self._delays, erased)
        self._line, self._events = LineErrors(seed), Events()
        self._protocol = Protocol(self._store, self._delays, self._line, seed)
        self._protocol.before_write = self._happen_with_write
        self._parts: tuple[Kept, ...] = (
            *(self.image, self._delays, self._store, self._line, self._events, self._protocol),
        )
        self._fitted, self._powered = True, True
        self._hot = False  # inserted with the power on, without a command since
        self._powered_at = 0
        self._clocks = 0  # with the select line high, since then
        self._frame = b""  # of a command that is not complete
        self._transaction: int | None = None

    @property
    def writes(self) -> int:
        """Blocks that were to be written since the card was made, refused ones included."""
        return self._store.writes

    @property
    def fitted(self) -> bool:
        return self._fitted

    def schedule(
        self,
        kind: CardFault,
        value: float = 0.0,
        *,
        cycle: int | None = None,
        write: int | None = None,
        cut: Cut | None = None,
        kept_bytes: int | None = None,
    ) -> None:
        """Let a fault come at `cycle`, or with block write number `write`, counted from 1; see CardFault.

        cut, kept_bytes: what a power cut leaves of the block; None: by chance.
        """
        self._events.add(Event(kind, value, cycle, write, cut, kept_bytes))

    def power_off(self, cycle: int) -> None:
        if self._powered:
            self._store.lose_power(cycle)
        self._powered = False

    def power_on(self, cycle: int) -> None:
        """Switch the supply on, also after a gap so short that only unfinished work is lost."""
        self.power_off(cycle)
        self._powered, self._powered_at, self._hot = True, cycle, False
        self._clocks, self._frame = 0, b""
        self._protocol.now = State()

    def close(self) -> None:
        self.image.close()

    # ---- bytes ----

    def exchange(
        self, sent: bytes, cycle: int, length: int, hz: float, mode: int, *, selected: bool, transaction: int
    ) -> bytes:
        """Exchange bytes.

        cycle: at which the first one begins; length: of each [cycles]; hz: of the clock; mode: 0 to 3.
        transaction: a number that changes with every edge of the select line.
        """
        if transaction != self._transaction:
            self._transaction, self._frame = transaction, b""
            self._protocol.deselect()
        got, place = bytearray(), 0
        while place < len(sent):
            at = cycle + place * length
            part = sent[place : place + self._happen(at, length)]
            if not (self._fitted and self._powered):
                got += bytes([RELEASED]) * len(part)
            else:
                got += self._hear(part, at, length, hz, mode, selected=selected)
            place = len(got)
        return bytes(got)

    def steady(self, cycle: int, *, selected: bool) -> tuple[int, int]:
        """Return the byte that answers 0xFF from `cycle` on, and until which cycle; 0: unknown."""
        state, until = self._protocol.now, self._events.next_cycle
        limit = NEVER if until is None else until
        if not (self._fitted and self._powered):
            return RELEASED, limit
        if not state.spi or self._frame or state.wanted:
            return RELEASED, 0
        if not selected:
            return RELEASED, limit
        if state.out:
            return RELEASED, 0
        if cycle < state.busy_until:
            return BUSY, min(limit, state.busy_until)
        if state.reading:
            return RELEASED, min(limit, state.data_at)
        return RELEASED, limit

    def _hear(self, sent: bytes, at: int, length: int, hz: float, mode: int, *, selected: bool) -> bytes:
        """Answer some of `sent`, one byte at least."""
        if self._hot and hz > START_HZ:
            return bytes([RELEASED]) * len(sent)  # the host cannot know yet that it has to begin anew
        self._check(hz, mode)
        if selected:
            return self._answer(sent, at, length)
        if at >= self._powered_at + SUPPLY:
            self._clocks += 8 * len(sent)
        return bytes([RELEASED]) * len(sent)

    def _check(self, hz: float, mode: int) -> None:
        if mode not in (0, 3):
            self.fail(f"the SD card is addressed in SPI mode {mode}, expected 0 or 3")
        limit = START_HZ if self._protocol.now.idle else FULL_HZ
        if hz > limit:
            when = "before it is initialised" if self._protocol.now.idle else "after its initialisation"
            self.fail(
                f"the SD card is clocked at {hz / 1e6:g} MHz {when}, expected {limit / 1e6:g} MHz at most"
            )

    def _answer(self, sent: bytes, at: int, length: int) -> bytes:
        """Answer some of `sent`, with the card selected and correctly clocked."""
        state = self._protocol.now
        if state.wanted:
            part = sent[: state.wanted]
            self._protocol.receive(part, at + len(part) * length)
            return bytes([RELEASED]) * len(part)
        quiet = len(sent) - len(sent.lstrip(b"\xff"))
        if not quiet or self._frame:
            return self._listen(sent[0], at, length)
        if state.out:
            part, state.out = state.out[:quiet], state.out[quiet:]
            return part
        if at < state.busy_until:
            left = state.busy_until - at
            if left < length:  # it lets go of the line within the byte
                return bytes([0xFF >> -(-8 * left // length)])
            return bytes([BUSY]) * min(quiet, left // length)
        if state.reading:
            if at < state.data_at:
                return bytes([RELEASED]) * min(quiet, -(-(state.data_at - at) // length))
            self._protocol.next_data(at)
            return self._answer(sent, at, length)
        return bytes([RELEASED]) * quiet

    def _listen(self, byte: int, at: int, length: int) -> bytes:
        """Take a byte that may begin a command or block, while an answer is sent."""
        state = self._protocol.now
        busy = not state.out and at < state.busy_until
        got, state.out = state.out[:1] or bytes([BUSY if busy else RELEASED]), state.out[1:]
        if self._frame:
            self._frame += bytes([byte])
            if len(self._frame) == COMMAND_BYTES:
                frame, self._frame = self._frame, b""
                if state.spi or self._clocks >= START_CLOCKS:
                    self._protocol.command(frame, at + length)
                    self._hot = self._hot and not self._protocol.now.spi
        elif state.writing and not busy and self._protocol.token(byte, at + length):
            pass
        elif byte & 0xC0 == 0x40:
            self._frame = bytes([byte])
        return got

    # ---- what goes wrong ----

    def _happen(self, at: int, length: int) -> int:
        """Apply the events due at cycle `at`; return the bytes of `length` cycles until the next one."""
        due = self._events.next_cycle
        if due is None:
            return 1 << 30
        if due <= at:
            for event in self._events.due(at):
                self._apply(event, at if event.cycle is None else event.cycle)
            due = self._events.next_cycle
        return 1 << 30 if due is None else max(1, -(-(due - at) // length))

    def _happen_with_write(self, address: int, data: bytes, at: int) -> bool:
        """Apply the events of a block write; return False without power or card."""
        for event in self._events.with_write(self._store.writes + 1):
            if event.kind is CardFault.POWER_CUT:
                self._cut(event, address, data, at)
            else:
                self._apply(event, at)
        return self._fitted and self._powered

    def _cut(self, event: Event, address: int, data: bytes, at: int) -> None:
        if self._store.write(address, data):
            self._store.finish_at(NEVER)
            self._store.lose_power(at, event.cut, event.kept_bytes)
        self._powered = False
        self.on_power_cut()

    def _apply(self, event: Event, at: int) -> None:
        value = event.value
        match event.kind:
            case CardFault.STALL:
                self._protocol.stall(at, round(value * TIME_HZ))
            case CardFault.SLOW:
                self._delays.factor = value
            case CardFault.WORN:
                self._store.worn_after = self._store.writes + int(value)
            case CardFault.WORN_FROM:
                self._store.worn_from = int(value)
            case CardFault.ERRORS:
                self._line.rate = value
            case CardFault.REMOVED:
                self.power_off(at)
                self._fitted = False
            case CardFault.INSERTED:
                self.power_on(at)
                self._fitted = self._hot = True
            case CardFault.POWER_CUT:
                self.power_off(at)
                self.on_power_cut()

    def state(self) -> Any:  # noqa: ANN401
        return (tuple(part.state() for part in self._parts), super().state())

    def restore(self, state: Any) -> None:  # noqa: ANN401
        for part, kept in zip(self._parts, state[0], strict=True):
            part.restore(kept)
        super().restore(state[1])
