"""`neuroflight board logs list`, and the functions that fetch and erase share with it."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from neuroflight.cli.board.state import OnPort, connect
from neuroflight.cli.options import Json
from neuroflight.cli.report import print_facts, print_json, print_table
from neuroflight.toolchain.errors import LinkError

if TYPE_CHECKING:
    from neuroflight.flash.link.client import Client
    from neuroflight.flash.logs.catalogue import Wait
    from neuroflight.flash.logs.messages import LogEntry, LogInfo

HEADS = ("log", "name", "KB")


def look(client: Client) -> tuple[LogInfo, list[LogEntry]]:
    """Read the state of the device, and its logs. Raises LinkError."""
    from neuroflight.flash.logs.catalogue import read_entries, settled_info

    info = settled_info(client, waiting())
    return info, read_entries(client, info, waiting())


def waiting() -> Wait:
    """Return the clock of this computer."""
    from neuroflight.flash.logs.catalogue import Wait

    return Wait(time.monotonic, time.sleep)


def print_logs(logs: Sequence[LogEntry]) -> None:
    """Print a line for each log."""
    rows = [(str(log.number), log.name, f"{log.bytes / 1024:,.0f}") for log in logs]
    print_table("", [HEADS, *rows], numbers={"log", "KB"})


def print_device(info: LogInfo) -> None:
    """Print the state of the device, and the end of the last log."""
    from neuroflight.flash.logs.catalogue import state_words
    from neuroflight.flash.logs.messages import DEVICES

    rows = [("device", DEVICES[info.device]), ("state", state_words(info))]
    if info.capacity_kib:
        room = f"{info.free_kib // 1024:,} MB of {info.capacity_kib // 1024:,}"
        rows.append(("room", f"{room}, for {info.empty} logs at most"))
    if info.frames or info.bytes:
        lost = f"{info.dropped:,} control steps are missing" if info.lossy else "no step is missing"
        which = "this log" if info.logging else "last log"
        rows.append((which, f"{info.bytes:,} bytes, {info.frames:,} frames; {lost}"))
    print_facts(rows)


@dataclass(frozen=True, kw_only=True)
class List(OnPort):
    """A request to list the device of the blackbox and its logs."""

    json: Json = False

    def run(self) -> int:
        """Print device and logs. Returns 0; raises LinkError for a firmware without a blackbox."""
        from neuroflight.flash.logs.catalogue import read_entries, settled_info

        with connect(self.port) as client:
            info = settled_info(client, waiting())
            told = asdict(info) | {
                name: getattr(info, name).name.lower() for name in ("device", "state", "error")
            }
            if not self.json:
                print_device(info)
            logs: list[LogEntry] = []
            why = ""
            try:
                logs = read_entries(client, info, waiting())
            except LinkError as error:  # no failure: the device's state is known
                why = str(error)
        if self.json:
            print_json({"info": told, "logs": [asdict(log) for log in logs], "why_none": why or None})
        elif why:
            print(why)
        elif logs:
            print_logs(logs)
        else:
            print("no log is kept there")
        return 0
