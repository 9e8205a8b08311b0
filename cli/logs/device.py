"""What `neuroflight log` list, fetch and erase have in common: a port, and a table of the logs there."""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

from neuroflight.cli.flash.tables import print_facts, print_table

if TYPE_CHECKING:
    from neuroflight.flash.link.client import Client
    from neuroflight.flash.logs.catalogue import Wait
    from neuroflight.flash.logs.messages import LogEntry, LogInfo

HEADS = ("log", "name", "KB")


def add_port(parser: argparse.ArgumentParser, *, required: bool) -> None:
    """Declare the port."""
    from neuroflight.cli.flash.state import PORT_HELP

    parser.add_argument("--port", required=required, metavar="PORT", help=PORT_HELP)


def look(client: Client) -> tuple[LogInfo, list[LogEntry]]:
    """The device and its logs. Raises LinkError."""
    from neuroflight.flash.logs.catalogue import read_entries, settled_info

    info = settled_info(client, waiting())
    return info, read_entries(client, info, waiting())


def waiting() -> Wait:
    """This computer's time."""
    from neuroflight.flash.logs.catalogue import Wait

    return Wait(time.monotonic, time.sleep)


def print_logs(logs: Sequence[LogEntry]) -> None:
    """A line each."""
    rows = [(str(log.number), log.name, f"{log.bytes / 1024:,.0f}") for log in logs]
    print_table(HEADS, rows, frozenset({"log", "KB"}))


def print_device(info: LogInfo) -> None:
    """What the device does, and what became of the last log."""
    from neuroflight.flash.logs.catalogue import state_words
    from neuroflight.flash.logs.messages import DEVICES

    rows = [("device", DEVICES[info.device]), ("state", state_words(info))]
    if info.capacity_kib:
        rows.append(
            (
                "room",
                f"{info.empty} empty files, {info.free_kib // 1024:,} MB of {info.capacity_kib // 1024:,}",
            )
        )
    if info.frames or info.bytes:
        lost = f"{info.dropped:,} control steps are missing" if info.lossy else "no step is missing"
        which = "this log" if info.logging else "last log"
        rows.append((which, f"{info.bytes:,} bytes, {info.frames:,} frames; {lost}"))
    print_facts(rows)
