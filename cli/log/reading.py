"""Functions that commands about logs share: choice of a log, progress of decoding, damage of a file."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from neuroflight.toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from neuroflight.sim.blackbox.flight import Part
    from neuroflight.sim.blackbox.log import Log


def add_file_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare FILE, --log and --json."""
    parser.add_argument(
        "file", type=Path, metavar="FILE", help="a log of Betaflight's format (.BBL, .BFL, .TXT)"
    )
    add_choice_arguments(parser)


def add_choice_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare --log and --json."""
    parser.add_argument(
        "--log",
        type=int,
        metavar="N",
        help="which log of the file, from 1; default: the last that has frames",
    )
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    add_header_argument(parser)


def add_header_argument(parser: argparse.ArgumentParser) -> None:
    """Add the option --header."""
    parser.add_argument(
        "--header",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="take the log as if its header had this line, which it lost or its firmware does not write; may "
        "be given several times",
    )


def add_recording_arguments(parser: argparse.ArgumentParser) -> None:
    """Add --from, --to, --header and --cut-rates, for commands that come from a recording."""
    add_part_arguments(parser, "the first command, of recorded ones")
    add_header_argument(parser)
    parser.add_argument(
        "--cut-rates",
        action="store_true",
        help="fly recorded rates beyond full stick (1000 deg/s) as full stick, rather than refuse them",
    )


def header_lines(args: argparse.Namespace) -> dict[str, str]:
    """Return the lines of --header, by name. Raises NeuroflightError for text that is no header line."""
    found = {}
    for text in args.header:
        name, equals, value = text.partition("=")
        name, value = name.strip(), value.strip()
        if (
            not equals
            or not name
            or not value
            or not (name + value).isprintable()
            or name.startswith("Field ")
        ):
            raise NeuroflightError(
                f"--header: got {text!r}, expected NAME=VALUE of a header line, such as motorOutput=138,2047"
            )
        found[name] = value
    return found


def add_part_arguments(parser: argparse.ArgumentParser, since: str) -> None:
    """Declare --from and --to."""
    parser.add_argument(
        "--from", dest="start", type=float, default=0.0, metavar="S", help=f"seconds since {since}"
    )
    parser.add_argument("--to", dest="stop", type=float, metavar="S", help="likewise; default: the end")


def part(args: argparse.Namespace) -> Part:
    """Return the part that --from and --to choose. Raises NeuroflightError if it is empty."""
    from neuroflight.sim.blackbox.flight import Part

    check_part(args)
    return Part(args.start, args.stop)


def check_part(args: argparse.Namespace) -> None:
    """Raise NeuroflightError where --from and --to choose nothing."""
    if not args.start >= 0.0:
        raise NeuroflightError(f"--from: got {args.start:g}, expected 0 or more")
    if args.stop is not None and not args.stop > args.start:
        raise NeuroflightError(f"--to: got {args.stop:g}, expected more than --from, {args.start:g}")


def open_log(args: argparse.Namespace, path: Path | None = None) -> Log:
    """Decode the log that was asked for, with a bar on a terminal. Damage is in its notes: `tell_damage`."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    from neuroflight.sim.blackbox.log import read_log

    path, told = args.file if path is None else path, header_lines(args)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    hidden = bool(args.json) or not sys.stderr.isatty()
    with Progress(*columns, console=Console(stderr=True), transient=True, disable=hidden) as bar:
        task = bar.add_task(f"decoding {path.name}", total=1.0)
        log = read_log(path, args.log, lambda done: bar.update(task, completed=done), told)
    return log


def tell_damage(log: Log) -> None:
    """Print the damage of the file in one line on stderr; call it after the work, which may print others."""
    if log.notes:
        print(f"neuroflight: {log.path}: log {log.number}: {'; '.join(log.notes)}", file=sys.stderr)
