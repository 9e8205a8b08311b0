"""`neuroflight log`: flights as the blackbox wrote them. Getting them off the aircraft, reading them.

Each module named in `COMMANDS` owns one subcommand: `add_arguments(parser)` and `run(args) -> int`.
"""

from __future__ import annotations

import argparse
import importlib

COMMANDS = {  # in the order of --help: the summary
    "list": "the logs of a file or a folder; with --port what the device of the blackbox does and keeps",
    "fetch": "get logs from the firmware into files; goes on where it was interrupted",
    "erase": "make all files for logs empty again; refuses while one was not fetched",
    "card": "put empty files for logs onto a FAT32 card, list them, empty those that were copied",
    "decode": "frames to CSV or NumPy's .npz",
    "plot": "draw a flight: rates, motors, battery, events",
    "metrics": "the figures of a flight that `fly` prints, against the gyro",
    "commands": "how a pilot's commands are distributed",
    "quality": "what a log can answer, and what it cannot",
    "replay": "give the firmware again what it was given in flight, and compare every motor value",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the subcommands."""
    commands = parser.add_subparsers(dest="action", required=True, metavar="COMMAND")
    for name, summary in COMMANDS.items():
        sub = commands.add_parser(name, help=summary, description=summary)
        module = importlib.import_module(f"neuroflight.cli.logs.{name}")
        module.add_arguments(sub)
        sub.set_defaults(subcommand=module.run)


def run(args: argparse.Namespace) -> int:
    """Carry out the subcommand. Returns its exit code; raises NeuroflightError for what cannot be done."""
    return int(args.subcommand(args))
