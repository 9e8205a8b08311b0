"""`neuroflight policy`: what is done with a trained policy before it is built into an image."""

from __future__ import annotations

import argparse
import importlib

COMMANDS = {  # in the order of --help: the summary
    "check": "say whether a policy is fit to fly an aircraft, and why not; exit status 1 if it is not",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the subcommands."""
    commands = parser.add_subparsers(dest="action", required=True, metavar="COMMAND")
    for name, summary in COMMANDS.items():
        sub = commands.add_parser(name, help=summary, description=summary)
        module = importlib.import_module(f"neuroflight.cli.training.policy_{name}")
        module.add_arguments(sub)
        sub.set_defaults(subcommand=module.run)


def run(args: argparse.Namespace) -> int:
    """Carry out the subcommand. Returns its exit code; raises NeuroflightError for what cannot be done."""
    return int(args.subcommand(args))
