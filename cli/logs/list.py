"""`neuroflight log list --port`: what the device of the blackbox does, and the logs that it keeps."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from typing import TYPE_CHECKING

from cli.flash.tables import print_json
from cli.logs.device import add_port, print_device, print_logs, waiting
from toolchain.errors import LinkError

if TYPE_CHECKING:
    from flash.logs.messages import LogEntry


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the port."""
    add_port(parser, required=True)
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(args: argparse.Namespace) -> int:
    """Print device and logs. Returns 0; raises LinkError for a firmware that tells of none."""
    from cli.flash.state import connect
    from flash.logs.catalogue import read_entries, read_info

    with connect(args) as client:
        info = read_info(client)
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
