"""`neuroflight flash`: the policy that a board flies, over its MSP port."""

from __future__ import annotations

import argparse

from cli.flash import policy_swap
from toolchain.errors import LinkError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument(
        "--port",
        required=True,
        metavar="PORT",
        help="tcp:HOST:PORT, serial:DEVICE[:BAUD] or a device such as /dev/ttyUSB0",
    )
    policy_swap.add_arguments(parser)
    parser.add_argument("--force", action="store_true", help="write it though the board flies it already")
    parser.add_argument("--dry-run", action="store_true", help="print the plan and write nothing")
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(args: argparse.Namespace) -> int:
    """Carry out what was asked. Returns 0; raises NeuroflightError for what cannot be done."""
    if policy_swap.wanted(args):
        return policy_swap.run_policy(args)
    raise LinkError("nothing to do: give --policy FILE, --list or --revert")
