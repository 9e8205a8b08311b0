"""Functions that commands about logs share: choice of a log, progress of decoding, damage of a file."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from neuroflight.cli.options import Header, Json
from neuroflight.cli.progress import progress_bars
from neuroflight.cli.requests import Argument, Option, Request
from neuroflight.toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from neuroflight.cli.options import OfRecording
    from neuroflight.sim.blackbox.log import Log


def since(row: str) -> Option:
    """Return the option --from, of seconds since a row."""
    return Option("S", f"seconds since {row}", low=0.0, name="--from")


@dataclass(frozen=True, kw_only=True)
class OfLogs(Request):
    """A request about logs in files."""

    log: Annotated[
        int | None, Option("N", "which log of the file, from 1; default: the last that has frames")
    ] = None
    json: Json = False
    header: Header = ()

    def read(self, path: Path) -> Log:
        """Decode the log that was asked for. Damage is in its notes: `tell_damage`."""
        from neuroflight.sim.blackbox.log import read_log

        told = header_lines(self)
        with progress_bars(self.json) as add:
            return read_log(path, self.log, add(f"decoding {path.name}"), told)


@dataclass(frozen=True, kw_only=True)
class OfLog(OfLogs):
    """A request about one log."""

    file: Annotated[Path, Argument("FILE", "a log of Betaflight's format (.BBL, .BFL, .TXT)")]


def header_lines(args: OfLogs | OfRecording) -> dict[str, str]:
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


def tell_damage(log: Log) -> None:
    """Print the damage of the file in one line on stderr; call it after the work, which may print others."""
    if log.notes:
        print(f"neuroflight: {log.where}: {'; '.join(log.notes)}", file=sys.stderr)
