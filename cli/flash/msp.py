"""`neuroflight msp`: ask a running firmware over MSP, change and keep its settings, record what it does.

What a command does stands in cli/flash/state.py (what the firmware tells), settings_commands.py (its
settings) and streaming.py; this module declares them and opens the port.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from neuroflight.cli.flash.state import PORT_HELP

COMMANDS = {  # in the order of --help: the summary
    "info": "who the firmware is, which policy it flies and what forbids arming",
    "status": "state, what forbids arming and how to lift it, battery, receiver, attitude, load",
    "tasks": "how long each task of the processor takes, and how often it came late",
    "get": "settings with their limits and defaults; all, or those named",
    "set": "change settings, all of them or none: NAME=VALUE; a value by number, name or as a mode range",
    "diff": "the settings that differ from their defaults, as lines that `restore` reads",
    "dump": "all settings, as lines that `restore` reads",
    "restore": "set a file's settings, and their defaults beside them, check and save them; all or nothing",
    "import": "bring settings over from Betaflight's `diff all` or `dump`, and tell what is left and why",
    "save": "store all settings",
    "defaults": "set every setting to its default",
    "stream": "what the firmware does, up to 500 times a second: a table, or a file",
    "calibrate": "measure the gyro's bias anew; the aircraft has to lie still",
    "faults": "the last fault that nobody acknowledged",
    "acknowledge": "acknowledge logged faults and a policy that was refused in flight, so that it arms again",
    "reboot": "start the firmware anew, and wait until it answers again",
}
PRINTING = frozenset({"info", "status", "tasks", "get", "diff", "dump", "stream", "faults"})


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the port and the commands."""
    parser.add_argument("--port", metavar="PORT", help=PORT_HELP)
    parser.set_defaults(usage_error=parser.error)
    commands = parser.add_subparsers(dest="action", required=True, metavar="COMMAND")
    declared = {}
    for name, summary in COMMANDS.items():
        declared[name] = commands.add_parser(name, help=summary, description=summary)
        declared[name].add_argument("--port", metavar="PORT", default=argparse.SUPPRESS, help=PORT_HELP)
        if name in PRINTING:
            declared[name].add_argument("--json", action="store_true", help="print JSON")
    declared["get"].add_argument("names", nargs="*", metavar="NAME", help="of settings; all without")
    change = declared["set"]
    change.add_argument("changes", nargs="+", metavar="NAME=VALUE", help='such as mode1="arm aux1 1700 2100"')
    change.add_argument("--save", action="store_true", help="store them as well")
    change.add_argument("--reboot", action="store_true", help="with --save: start anew, to fly them")
    restore = declared["restore"]
    restore.add_argument("file", type=Path, metavar="FILE", help="as printed by dump or diff")
    restore.add_argument("--keep", action="store_true", help="leave what the file does not name as it is")
    imported = declared["import"]
    imported.add_argument("file", type=Path, metavar="DIFF", help="as Betaflight's diff or dump printed it")
    imported.add_argument("--dry-run", action="store_true", help="show it and change nothing")
    imported.add_argument("--yes", action="store_true", help="do not ask")
    imported.add_argument(
        "--backup", type=Path, metavar="FILE", help="write all settings as they are before, for `restore`"
    )
    imported.add_argument(
        "--rate-profile", type=int, metavar="N", help="its rates (default: the one that was active)"
    )
    imported.add_argument(
        "--betaflight", metavar="VERSION", help="that wrote the file, where it does not say so itself"
    )
    declared["defaults"].add_argument("--yes", action="store_true", help="do not ask")
    declared["defaults"].add_argument("--save", action="store_true", help="store them as well")
    stream = declared["stream"]
    stream.add_argument("--rate", type=int, default=100, metavar="HZ", help="samples a second (default 100)")
    stream.add_argument("--seconds", type=float, metavar="S", help="end after so long; else by Ctrl-C")
    stream.add_argument("--out", type=Path, metavar="FILE", help="write the samples to FILE.csv or FILE.npz")
    declared["reboot"].add_argument(
        "--rom", action="store_true", help="start the boot loader in the chip's ROM instead, for `rescue`"
    )
    declared["faults"].add_argument("--ack", action="store_true", help="acknowledge it")


def run(args: argparse.Namespace) -> int:
    """Carry out the command. Returns 0; raises NeuroflightError for what cannot be done."""
    from neuroflight.cli.flash import settings_commands, settings_import, state, streaming

    if args.port is None:
        args.usage_error("the following arguments are required: --port")
    handlers = {**state.HANDLERS, **settings_commands.HANDLERS, **streaming.HANDLERS}
    handlers["import"] = settings_import.import_
    return handlers[args.action](args)
