"""`neuroflight log erase`: makes all files for logs empty again, over the line."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from neuroflight.cli.flash.interrupts import one_interrupt
from neuroflight.cli.logs.device import add_port, look, waiting
from neuroflight.cli.logs.questions import confirm
from neuroflight.toolchain.errors import NeuroflightError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the port and what is allowed."""
    add_port(parser, required=True)
    parser.add_argument("--yes", action="store_true", help="do not ask")
    parser.add_argument(
        "--copies",
        type=Path,
        default=Path(),
        metavar="DIR",
        help="the folder that logs were fetched to (default: this one)",
    )
    parser.add_argument("--unfetched", action="store_true", help="erase logs as well that DIR does not hold")


def run(args: argparse.Namespace) -> int:
    """Erase. Returns 0; raises NeuroflightError of one line where nothing was erased."""
    from neuroflight.cli.flash.state import connect
    from neuroflight.flash.logs.catalogue import erase
    from neuroflight.flash.logs.copies import find_copy

    with one_interrupt(), connect(args) as client:
        _, logs = look(client)
        if not logs:
            print(f"{client.name}: no log is kept there")
            return 0
        kept = [log for log in logs if log.bytes]
        if not args.unfetched:
            lost = [log for log in kept if find_copy(client, log, args.copies, time.monotonic) is None]
            if lost:
                numbers = ", ".join(str(log.number) for log in lost)
                raise NeuroflightError(
                    f"{client.name}: log {numbers} is not in {args.copies.absolute()}, expected a copy; "
                    "`neuroflight log fetch --all` gets them, --copies DIR names another folder, --unfetched "
                    "erases them all the same; nothing was erased"
                )
        confirm(args.yes, f"erase {len(logs)} logs on {client.name}", "nothing was erased")
        erase(client, waiting())
        info, left = look(client)
    if left:
        raise NeuroflightError(f"{client.name}: {len(left)} logs are still there after erasing; erase again")
    print(f"{len(logs)} logs erased; {info.empty} empty files")
    return 0
