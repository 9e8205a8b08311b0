"""Finding files on this computer that hold a log of the firmware."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from neuroflight.flash.link.client import Client
from neuroflight.flash.logs.messages import LogEntry
from neuroflight.flash.logs.reading import read_bytes

PROBE_BYTES = 2048  # compared at both ends; a log's first bytes hold its initial state, which differs
SAME_NAMES_MAX = 1000


def same_so_far(client: Client, log: LogEntry, path: Path, clock: Callable[[], float]) -> bool:
    """Return True if `path` holds the first bytes of `log`; both ends of the file are compared.

    Raises LinkError, OSError.
    """
    size = path.stat().st_size
    if not 0 < size <= log.bytes:
        return False
    count = min(PROBE_BYTES, size)
    with path.open("rb") as file:
        for at in {0, size - count}:
            file.seek(at)
            if file.read(count) != read_bytes(client, log.index, at, count, clock):
                return False
    return True


def find_copy(client: Client, log: LogEntry, folder: Path, clock: Callable[[], float]) -> Path | None:
    """Return the file of `folder` that holds the whole of `log`, or None. Raises LinkError, OSError."""
    for path in sorted(folder.iterdir()) if folder.is_dir() else []:
        if path.is_file() and path.stat().st_size == log.bytes and same_so_far(client, log, path, clock):
            return path
    return None


def take_name(part: Path, folder: Path, name: str) -> Path:
    """Rename the complete file `part` to its name in `folder`, or the next free one: LOG00001-2.BBL."""
    first = Path(name)
    for number in range(1, SAME_NAMES_MAX):
        path = folder / (name if number == 1 else f"{first.stem}-{number}{first.suffix}")
        try:
            os.link(part, path)
        except FileExistsError:
            continue
        except OSError:  # the file system has no links
            if path.exists():
                continue
            part.rename(path)
            return path
        part.unlink()
        return path
    raise FileExistsError(f"{folder} has {SAME_NAMES_MAX} files called like {name}")
