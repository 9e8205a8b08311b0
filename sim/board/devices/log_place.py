"""The place of what keeps logs, an SD card or a flash chip: its SPI, select line, supply and snapshots."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from neuroflight.sim.board.core.context import BoardError, Kept
from neuroflight.sim.board.devices.flash_chip import FlashChip
from neuroflight.sim.board.devices.sd_card import CardFault, SdCard
from neuroflight.sim.board.native.library import Native
from neuroflight.sim.board.peripherals.gpio import Pins, place
from neuroflight.toolchain.boards.facts import Board
from neuroflight.toolchain.contract import BoardLog
from neuroflight.toolchain.errors import LinkError

LogChip = SdCard | FlashChip
_KINDS: dict[BoardLog, type[LogChip]] = {BoardLog.CARD: SdCard, BoardLog.FLASH: FlashChip}
_DRIVERS = {  # kinds by the driver that a public configuration names; M25P16 takes any NOR chip
    "PY25Q128HA": "PY25Q128HA",
    "W25M512": "W25M512",
    "W25M02G": "W25M02G",
    "W25N02K": "W25N02K",
    "W25N01G": "W25N01G",
    "W25N": "W25N01G",
}
_WORDS = {BoardLog.NONE: "nothing", BoardLog.CARD: "an SD card", BoardLog.FLASH: "a flash chip"}


def open_log_chip(board: Board, path: Path) -> LogChip:
    """Return what keeps the board's logs, its content in the file `path`; a flash chip's is made if need be.

    Of several flash chips that boards of that name carry the first is taken. Raises LinkError for a file that
    cannot be it, and for a board that keeps none.
    """
    if board.log_kind == BoardLog.CARD:
        return SdCard(path)
    if board.log_kind == BoardLog.FLASH:
        return FlashChip(_DRIVERS.get(board.flash_kinds[0] if board.flash_kinds else "", "W25Q128"), path)
    raise LinkError(
        f"{board.name}: got {path} to keep logs in, but the board has neither a card nor a flash chip"
    )


class LogPlace(Kept):
    """Place of an SD card or flash chip; empty by default: then C answers 0xFF to every byte."""

    def __init__(self, native: Native, pins: Pins, board: Board, chip: LogChip | None) -> None:
        """Fit `chip`. Raises BoardError for one that the board has no place for."""
        self._native, self._engine = native, native.engine
        self.chip = chip
        where = board.log_chip
        if chip is not None and (where is None or not isinstance(chip, _KINDS[board.log_kind])):
            got = next(_WORDS[kind] for kind, of in _KINDS.items() if isinstance(chip, of))
            raise BoardError(
                f"{board.name}: got {got}, expected {_WORDS[board.log_kind]}, which keeps its logs"
            )
        if where is None:
            return
        pins.drive(str(where.select), True)  # a resistor holds it high
        lib = native.library
        lib.native_chip(native.handle, lib.CHIP_LOG, where.spi - 1, *place(where.select))
        if chip is None:
            return
        self._in_c = native.library.native_card(native.handle)
        native.on_card = self._exchange
        chip.fail = self._engine.fail
        chip.on_power_cut = lambda: self._engine.system_reset("power")

    def power_on(self) -> None:
        """Handle a gap of the supply."""
        if self.chip is not None:
            self.chip.power_on(self._engine.cycle)
            self._in_c.until = 0

    def strike(self, kind: CardFault, value: float = 0.0) -> None:
        """Inject a fault now. Raises BoardError without a card."""
        if not isinstance(self.chip, SdCard):
            raise BoardError(f"the fault {kind.value} of a card: the board has none; put one in with --card")
        self._native.library.native_card_sync(self._native.handle)
        self.chip.schedule(kind, value, cycle=self._engine.cycle)
        self._in_c.until = 0

    def _exchange(self, sent: bytes, cycle: int, length: int, hz: float, mode: int) -> bytes:
        assert self.chip is not None
        library, handle, in_c = self._native.library, self._native.handle, self._in_c
        selected = bool(library.native_card_selected(handle))
        transaction = int(library.native_card_transaction(handle))
        got = self.chip.exchange(sent, cycle, length, hz, mode, selected=selected, transaction=transaction)
        in_c.answer, in_c.until = self.chip.steady(cycle + len(sent) * length, selected=selected)
        in_c.transaction = transaction
        return got

    def close(self) -> None:
        if self.chip is not None:
            self.chip.close()

    def state(self) -> Any:  # noqa: ANN401
        return None if self.chip is None else self.chip.state()

    def restore(self, state: Any) -> None:  # noqa: ANN401
        if (state is None) != (self.chip is None):
            raise BoardError("a snapshot of a board with a card into one without, or the other way round")
        if self.chip is not None:
            self.chip.restore(state)
