"""The question before data are lost for good."""

from __future__ import annotations

import sys

from neuroflight.toolchain.errors import NeuroflightError


def confirm(given: bool, what: str, undone: str) -> None:
    """Raise NeuroflightError unless --yes was given, or somebody at a terminal says so.

    what: is about to happen, such as "erase 3 logs". undone: what is so if not, for the message.
    """
    if given:
        return
    if not sys.stdin.isatty():
        raise NeuroflightError(f"about to {what}: nobody can be asked here, give --yes; {undone}")
    print(f"{what}? Type `yes`: ", end="", file=sys.stderr, flush=True)
    typed = sys.stdin.readline().strip().lower()
    if typed not in ("y", "yes"):
        raise NeuroflightError(f"got {typed!r}, expected 'yes'; {undone}")
