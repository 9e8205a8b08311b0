"""Flash chips on the firmware's bus."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from neuroflight.sim.board.devices.flash_chip import ChipKind, FlashChip
from tests.firmware.conftest import Core
from tests.firmware.storage.recorder import LogRecorder


class Recorder(LogRecorder):
    """A board with a flash chip, which is small unless said."""

    look = 40
    chip: FlashChip

    def scanned(self) -> None:
        """Until it is known what is on the chip, and an erasing that was cut short has ended."""
        self.until(lambda: self.state.name != "STARTING", 300.0)


MakeRecorder = Callable[..., Recorder]


@pytest.fixture
def board(scripted: Core) -> Iterator[MakeRecorder]:
    """Puts a new chip of that kind onto a new board, or one that is given."""
    with contextlib.ExitStack() as stack:

        def fit(
            chip: FlashChip | ChipKind | str = "W25Q16", path: Path | None = None, **options: Any
        ) -> Recorder:
            chip = chip if isinstance(chip, FlashChip) else FlashChip(chip, path, **options)
            recorder = Recorder(scripted, chip, "flash_log")
            stack.callback(recorder.close)
            return recorder

        yield fit
