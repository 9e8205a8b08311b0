"""Fetching a log into a file; an interrupted transfer is continued."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from neuroflight.flash.link.client import Client, RefusedError
from neuroflight.flash.logs.catalogue import refusal_words
from neuroflight.flash.logs.copies import find_copy, same_so_far, take_name
from neuroflight.flash.logs.messages import LogEntry
from neuroflight.flash.logs.reading import LogReader
from neuroflight.toolchain.errors import LinkError
from neuroflight.toolchain.files import claimed_file

PART = ".part"
KEPT_BYTES = 1 << 20  # between two syncs: a crash of this computer loses no more
NAME = re.compile(r"[A-Za-z0-9_-]{1,8}(\.[A-Za-z0-9_-]{1,3})?")

Progress = Callable[[int], None]  # bytes that are there


@dataclass(frozen=True)
class Fetched:
    """A log in a file."""

    path: Path
    there: bool  # complete before this fetch
    resumed: int  # bytes that were there from an earlier try


def fetch(
    client: Client, log: LogEntry, folder: Path, clock: Callable[[], float], progress: Progress
) -> Fetched:
    """Fetch `log` into `folder`; no other file is changed. Raises LinkError, OSError; bytes received before
    that stay in NAME.part."""
    if not NAME.fullmatch(log.name):
        raise LinkError(f"{client.name}: log {log.number} is called {log.name!r}, expected an 8.3 name")
    folder.mkdir(parents=True, exist_ok=True)
    try:
        copy = find_copy(client, log, folder, clock)
        if copy is not None:
            return Fetched(copy, there=True, resumed=0)
        part = folder / f"{log.name}{PART}"
        with claimed_file(part, "fetch"):
            resumed = _read_on(client, log, part, clock, progress)
            return Fetched(take_name(part, folder, log.name), there=False, resumed=resumed)
    except RefusedError as error:
        raise refusal_words(client, error) from None


def _read_on(
    client: Client, log: LogEntry, part: Path, clock: Callable[[], float], progress: Progress
) -> int:
    """Fill `part` up to the whole log. Returns the bytes that were there before."""
    resumed = 0
    if part.exists() and same_so_far(client, log, part, clock):
        resumed = part.stat().st_size
    reader = LogReader(client, log.index, resumed, log.bytes, clock)
    with part.open("r+b" if resumed else "wb") as file:
        file.seek(resumed)
        kept = resumed
        try:
            while reader.at < log.bytes:
                file.write(reader.read())
                if reader.at - kept >= KEPT_BYTES:
                    _keep(file.fileno(), file.flush)
                    kept = reader.at
                progress(reader.at)
        finally:
            _keep(file.fileno(), file.flush)
    return resumed


def _keep(handle: int, flush: Callable[[], None]) -> None:
    flush()
    os.fsync(handle)
