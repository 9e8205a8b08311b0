"""The confirmation that propellers are off, before anything may turn."""

from __future__ import annotations

import sys

from neuroflight.toolchain.errors import LinkError

WORDS = "props off"


def confirm_props_off(given: bool, what: str) -> None:
    """Raise LinkError unless --props-off was given, or somebody at a terminal types the words.

    what: is about to happen, a sentence.
    """
    if given:
        return
    if not sys.stdin.isatty():
        raise LinkError(f"{what}: take the propellers off and give --props-off; no motor turned")
    print(
        f"{what}. Take the propellers off, fasten the aircraft, keep hands away.\n"
        f"Type `{WORDS}` if they are off: ",
        end="",
        file=sys.stderr,
        flush=True,
    )
    typed = " ".join(sys.stdin.readline().lower().split())
    if typed != WORDS:
        raise LinkError(f"got {typed!r}, expected {WORDS!r} typed out; no motor turned")
