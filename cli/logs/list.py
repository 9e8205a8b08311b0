"""`neuroflight log list`: the logs of a file or a folder; with --port those of a device, and what it does."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from neuroflight.cli.flash.tables import print_json
from neuroflight.cli.logs import files
from neuroflight.cli.logs.device import add_port, print_device, print_logs, waiting
from neuroflight.toolchain.errors import LinkError, NeuroflightError

if TYPE_CHECKING:
    from neuroflight.flash.logs.messages import LogEntry


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare file and port."""
    parser.add_argument("path", type=Path, nargs="?", metavar="FILE|DIR", help="logs, or a folder with some")
    add_port(parser, required=False)
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(args: argparse.Namespace) -> int:
    """Print logs. Returns 0; raises NeuroflightError unless there is one place to look."""
    if (args.path is None) == (args.port is None):
        raise NeuroflightError("log list: give a FILE, a folder, or --port PORT; one of them")
    return _list_device(args) if args.path is None else files.run(args)


def _list_device(args: argparse.Namespace) -> int:
    """Print device and logs. Returns 0; raises LinkError for a firmware that tells of none."""
    from neuroflight.cli.flash.state import connect
    from neuroflight.flash.logs.catalogue import read_entries, settled_info

    with connect(args) as client:
        info = settled_info(client, waiting())
        told = asdict(info) | {
            name: getattr(info, name).name.lower() for name in ("device", "state", "error")
        }
        if not args.json:
            print_device(info)
        logs: list[LogEntry] = []
        why = ""
        try:
            logs = read_entries(client, info, waiting())
        except LinkError as error:  # the device has been told: that its logs cannot be read now is no failure
            why = str(error)
    if args.json:
        print_json({"info": told, "logs": [asdict(log) for log in logs], "why_none": why or None})
    elif why:
        print(why)
    elif logs:
        print_logs(logs)
    else:
        print("no log is kept there")
    return 0
