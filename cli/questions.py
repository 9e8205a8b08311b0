"""Questions to whoever sits at the terminal."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import TypeVar

from neuroflight.toolchain.errors import NeuroflightError

Answer = TypeVar("Answer")


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


def ask(question: str, read: Callable[[str], Answer], undone: str) -> Answer | None:
    """Return what `read` makes of the answer; None: an empty line. An answer that it refuses is asked anew.

    undone: what is so where no answer comes, for the NeuroflightError at the end of the input.
    """
    while True:
        print(question, end=" ", file=sys.stderr, flush=True)
        typed = sys.stdin.readline()
        if not typed:
            raise NeuroflightError(f"no answer, expected a line; {undone}")
        if not typed.strip():
            return None
        try:
            return read(typed.strip())
        except NeuroflightError as error:
            print(error, file=sys.stderr)
