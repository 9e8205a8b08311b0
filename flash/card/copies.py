"""Finding copies of a card's logs in a folder: only logs with a copy are emptied."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from neuroflight.flash.card.files import PIECE_BYTES, SECTOR, Card, LogFile, is_blank


def copy_of(card: Card, log: LogFile, folder: Path, progress: Callable[[int], None]) -> Path | None:
    """Return the file of `folder` that holds the whole of `log`, or None.

    It may be as long as the log, or as the card's file with the blank rest behind the log.
    """
    start = card.read(log.name, 0, SECTOR)
    for path in sorted(folder.iterdir()) if folder.is_dir() else []:
        if (
            path.is_file()
            and 0 < path.stat().st_size <= log.bytes
            and _is_copy(card, log, path, start, progress)
        ):
            return path
    return None


def _is_copy(card: Card, log: LogFile, path: Path, start: bytes, progress: Callable[[int], None]) -> bool:
    with path.open("rb") as copy:
        head = copy.read(SECTOR)
        if start[: len(head)] != head:
            return False
        for at in range(0, log.bytes, PIECE_BYTES):
            on_card = card.read(log.name, at, PIECE_BYTES)
            copy.seek(at)
            ours = copy.read(len(on_card))
            if on_card[: len(ours)] != ours or not is_blank(on_card[len(ours) :]):
                return False
            progress(at + len(on_card))
    return True
