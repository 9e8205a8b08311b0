"""`neuroflight board logs fetch`: logs from the firmware into files."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from neuroflight.cli.board.interrupts import one_interrupt
from neuroflight.cli.board.logs import look
from neuroflight.cli.board.state import OnPort, connect
from neuroflight.cli.options import Json
from neuroflight.cli.output import check_folder
from neuroflight.cli.report import Account
from neuroflight.cli.requests import Argument, Option
from neuroflight.toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from neuroflight.flash.logs.messages import LogEntry


@dataclass(frozen=True, kw_only=True)
class Fetch(OnPort):
    """A request to fetch logs from the firmware into files."""

    numbers: Annotated[
        tuple[int, ...],
        Argument("NUMBER", "of a log, as `board logs list` has it; default: the last one"),
    ] = ()
    all: Annotated[bool, Option(None, "every log that DIR does not hold already")] = False
    out: Annotated[Path, Option("DIR", "folder for the files (default: this one)")] = Path()
    json: Json = False

    def run(self) -> int:
        """Fetch. Returns 0; raises NeuroflightError of one line for what cannot be done."""
        from neuroflight.flash.logs.fetch import fetch

        if self.all and self.numbers:
            raise NeuroflightError("fetch got --all and numbers, expected one of them")
        check_folder(self.out, "--out")
        told, files = Account(self.json), []
        with one_interrupt(), connect(self.port) as client:
            _, logs = look(client)
            if not logs:
                raise NeuroflightError(f"{client.name}: no log is kept there; nothing was written")
            for log in _chosen(self, logs):
                if log.bytes == 0:
                    told.say(f"log {log.number}: {log.name} is empty: nothing was written")
                    continue
                began = time.monotonic()
                with _bar(log) as progress:
                    fetched = fetch(client, log, self.out, time.monotonic, progress)
                took = max(time.monotonic() - began, 1e-3)
                facts = {"log": log.number, "bytes": log.bytes, "seconds": took, **asdict(fetched)}
                files.append(facts | {"path": str(fetched.path)})
                if fetched.there:
                    told.say(f"log {log.number}: {fetched.path} holds it already")
                    continue
                rate = (log.bytes - fetched.resumed) / took / 1000
                went_on = f", went on from byte {fetched.resumed:,}" if fetched.resumed else ""
                speed = f"{log.bytes:,} bytes in {took:.1f} s, {rate:.1f} kB/s{went_on}"
                told.say(f"log {log.number}: {fetched.path}, {speed}")
        return told.end(files)


def _chosen(args: Fetch, logs: Sequence[LogEntry]) -> list[LogEntry]:
    if args.all:
        return list(logs)
    if not args.numbers:
        return [logs[-1]]
    by_number = {log.number: log for log in logs}
    for number in args.numbers:
        if number not in by_number:
            raise NeuroflightError(
                f"got log {number}, expected 1 to {len(logs)}; `neuroflight board logs list` shows them"
            )
    return [by_number[number] for number in dict.fromkeys(args.numbers)]


@contextmanager
def _bar(log: LogEntry) -> Iterator[Callable[[int], None]]:
    """Show bytes, their rate and the time that is left on a terminal; elsewhere nothing."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        DownloadColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
        TransferSpeedColumn,
    )

    columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn(), TransferSpeedColumn())
    console = Console(stderr=True)
    hidden = not console.is_terminal
    with Progress(*columns, TimeRemainingColumn(), console=console, transient=True, disable=hidden) as bars:
        task = bars.add_task(log.name, total=log.bytes)
        yield lambda done: bars.update(task, completed=done)
