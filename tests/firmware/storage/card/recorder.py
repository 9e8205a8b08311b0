"""The firmware's card_log.c on the card of the emulated board."""

from __future__ import annotations

from pathlib import Path

from neuroflight.sim.board.devices.sd_card import CardTiming, SdCard
from tests.firmware.conftest import Core
from tests.firmware.storage.recorder import CYCLES_A_SECOND, DONE, FAILED, LogRecorder, PowerCut

__all__ = ["CYCLES_A_SECOND", "DONE", "FAILED", "PowerCut", "Recorder"]


class Recorder(LogRecorder):
    """A board with a card."""

    def __init__(
        self, core: Core, path: Path, *, seed: int = 0, timing: CardTiming | None = None, erased: int = 0
    ) -> None:
        self.card = SdCard(path, seed=seed, timing=timing, erased=erased)
        self.changed: set[int] = set()  # blocks that were written or erased
        self.refused = 0  # blocks, for their checksum
        self._watch()
        super().__init__(core, self.card, "card_log")

    def _watch(self) -> None:
        """Notes which blocks of the image change."""
        write, erase = self.card.image.write, self.card.image.erase

        def noted_write(block: int, data: bytes) -> None:
            self.changed.add(block)
            write(block, data)

        def noted_erase(first: int, last: int, value: int) -> None:
            self.changed |= {first, last}
            erase(first, last, value)

        self.card.image.write = noted_write  # type: ignore[method-assign]
        self.card.image.erase = noted_erase  # type: ignore[method-assign]

    def passed(self, count: int, got: bytes) -> None:
        self.refused += count == 520 and got[516] & 0x1F == 0x0B

    def known(self) -> None:
        """Until all files were looked at."""
        self.until(lambda: self.lib.card_files_known(self.core.ffi.addressof(self.log, "files")), 60.0)
