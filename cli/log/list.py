"""`neuroflight log list FILE|DIR`: the logs there, without decoding them whole."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

from neuroflight.cli.options import Json
from neuroflight.cli.report import print_table
from neuroflight.cli.requests import Argument, Request
from neuroflight.toolchain.errors import NeuroflightError

SUFFIXES = (".bbl", ".bfl", ".txt")
FILES_MAX = 2000  # of a folder
SHOWN = 40  # characters of what a header says


@dataclass(frozen=True)
class LogRow:
    """A log, or a file without one."""

    file: str
    log: int | None  # from 1
    bytes: int
    seconds: float | None  # None: not known
    firmware: str
    craft: str
    note: str


@dataclass(frozen=True, kw_only=True)
class List(Request):
    """A request to list the logs of a file or a folder."""

    path: Annotated[Path, Argument("FILE|DIR", "logs, or a folder with some")]
    json: Json = False

    def run(self) -> int:
        """Print the logs."""
        rows = list(_folder(self.path) if self.path.is_dir() else _file(self.path))
        if self.json:
            print(json.dumps([asdict(row) for row in rows], indent=2))
            return 0
        table = [("file", "log", "size", "length", "firmware", "craft", "")]
        for row in rows:
            length = "" if row.seconds is None else f"{row.seconds:.1f} s"
            number = "" if row.log is None else str(row.log)
            table.append((row.file, number, _size(row.bytes), length, row.firmware, row.craft, row.note))
        print_table("", table, numbers=())
        return 0


def _folder(folder: Path) -> Iterator[LogRow]:
    """Yield the logs of each file in `folder` whose name is a log's. Raises NeuroflightError: it has none."""
    paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES and path.is_file())
    if not paths:
        raise NeuroflightError(f"{folder}: no file {', '.join(f'*{suffix}' for suffix in SUFFIXES)}")
    for path in paths[:FILES_MAX]:
        try:
            yield from _file(path)
        except (NeuroflightError, OSError) as error:
            if path.suffix.lower() != ".txt":  # which may be any text
                reason = f"{error}".removeprefix(f"{path}: ")
                yield LogRow(path.name, None, path.stat().st_size, None, "", "", reason)


def _file(path: Path) -> Iterator[LogRow]:
    from neuroflight.sim.blackbox.firmware import Maker
    from neuroflight.sim.blackbox.headers import read_bytes
    from neuroflight.sim.blackbox.log import glance, is_blank, list_logs
    from neuroflight.toolchain.files import file_size

    size = file_size(path)
    if is_blank(path):
        yield LogRow(path.name, None, size, None, "", "", "empty: a log to come" if size else "empty")
        return
    data = read_bytes(path)
    for one in list_logs(path, data):
        headers = one.headers.values
        craft = headers.get("Craft name", "") or headers.get("nf_aircraft", "")
        notes = list(one.headers.notes)
        seconds = glance(data, one)
        if seconds is None:
            notes.append("no frames that can be read")
        said = headers.get("Firmware revision", "") or headers.get("Firmware type", "")
        version = headers.get("nf_version", "")
        firmware = f"{Maker.NEUROFLIGHT.value} {version}" if version else said
        yield LogRow(
            path.name, one.number, one.size, seconds, firmware[:SHOWN], craft[:SHOWN], "; ".join(notes)
        )


def _size(size: int) -> str:
    return f"{size / 1e6:.1f} MB" if size >= 1e6 else f"{size / 1e3:.0f} kB"
