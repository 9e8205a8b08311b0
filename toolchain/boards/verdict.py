"""The verdict on a board: whether the firmware flies it, and what it flies without."""

from __future__ import annotations

from dataclasses import dataclass

from neuroflight.toolchain.boards.allocation import Allocation, allocate
from neuroflight.toolchain.boards.facts import Board
from neuroflight.toolchain.boards.gyro_kinds import FILES, with_kin
from neuroflight.toolchain.contract import BoardLog
from neuroflight.toolchain.errors import WiringError

LOGS = {BoardLog.NONE: "none", BoardLog.CARD: "SD card", BoardLog.FLASH: "flash chip"}
COMMON = (
    "OSD, LED strip, RSSI input, barometer, camera control, switched supplies (PINIO)"  # no board's is driven
)


@dataclass(frozen=True)
class Verdict:
    """A board and what can be said of it before it is built."""

    board: Board
    allocation: Allocation | None  # None: it cannot be flown
    fault: str  # why; "": it can be

    @property
    def gyros(self) -> tuple[str, ...]:
        """Chips that boards of this name may carry and that the firmware drives."""
        return with_kin(self.board.gyro_kinds)

    @property
    def file(self) -> str:
        """Name the file without which it is not built, as none of its chips measures; "": it is."""
        return next(iter(FILES.values())) if self.gyros and FILES.keys() >= set(self.gyros) else ""

    @property
    def motors(self) -> int:
        """Motor outputs that it drives, or those told where it cannot be flown."""
        return len(self.board.motors if self.allocation is None else self.allocation.motors)

    @property
    def log(self) -> str:
        """Say where it keeps logs."""
        kept = self.allocation is not None and self.allocation.log
        return LOGS[self.board.log_kind if kept else BoardLog.NONE]

    @property
    def without(self) -> tuple[str, ...]:
        """Say what it flies without and why; what no board has is left out."""
        return () if self.allocation is None else self.allocation.left


def judge(board: Board) -> Verdict:
    """Return the verdict on a board."""
    try:
        return Verdict(board, allocate(board), "")
    except WiringError as error:
        return Verdict(board, None, str(error).removeprefix(f"{board.name}: "))
