"""The slot on the board: connection of an SD card with SPI3, its select line, the supply and snapshots."""

from __future__ import annotations

from typing import Any

from neuroflight.sim.board.core.context import BoardError, Kept
from neuroflight.sim.board.devices.sd_card.card import SdCard
from neuroflight.sim.board.devices.sd_card.faults import CardFault
from neuroflight.sim.board.native.library import Native
from neuroflight.sim.board.peripherals.gpio import Pins

CS = "PC1"  # pins.c knows it too


class CardSlot(Kept):
    """A slot with a card or, by default, without: then C answers 0xFF to every byte."""

    def __init__(self, native: Native, pins: Pins, card: SdCard | None) -> None:
        self._native, self._engine = native, native.engine
        self.card = card
        pins.drive(CS, True)  # a resistor holds it high
        if card is None:
            return
        self._in_c = native.library.native_card(native.handle)
        native.on_card = self._exchange
        card.fail = self._engine.fail
        card.on_power_cut = lambda: self._engine.system_reset("power")

    def power_on(self) -> None:
        """Handle a gap of the supply."""
        if self.card is not None:
            self.card.power_on(self._engine.cycle)
            self._in_c.until = 0

    def strike(self, kind: CardFault, value: float = 0.0) -> None:
        """Inject a fault now. Raises BoardError without a card."""
        if self.card is None:
            raise BoardError(f"the fault {kind.value} of a card: the board has none; put one in with --card")
        self._native.library.native_card_sync(self._native.handle)
        self.card.schedule(kind, value, cycle=self._engine.cycle)
        self._in_c.until = 0

    def _exchange(self, sent: bytes, cycle: int, length: int, hz: float, mode: int) -> bytes:
        assert self.card is not None
        library, handle, in_c = self._native.library, self._native.handle, self._in_c
        selected = bool(library.native_card_selected(handle))
        transaction = int(library.native_card_transaction(handle))
        got = self.card.exchange(sent, cycle, length, hz, mode, selected=selected, transaction=transaction)
        in_c.answer, in_c.until = self.card.steady(cycle + len(sent) * length, selected=selected)
        in_c.transaction = transaction
        return got

    def close(self) -> None:
        if self.card is not None:
            self.card.close()

    def state(self) -> Any:  # noqa: ANN401
        return None if self.card is None else self.card.state()

    def restore(self, state: Any) -> None:  # noqa: ANN401
        if (state is None) != (self.card is None):
            raise BoardError("a snapshot of a board with a card into one without, or the other way round")
        if self.card is not None:
            self.card.restore(state)
