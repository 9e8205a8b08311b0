"""The confirmation that nobody can be hurt, before anything may turn."""

from __future__ import annotations

import sys

from neuroflight.toolchain.errors import LinkError


def confirm_props_off(given: bool, what: str) -> None:
    """Raise LinkError unless --props-off was given, or somebody at a terminal types the words.

    what: is about to happen, a sentence.
    """
    confirm(
        given,
        "props off",
        "--props-off",
        what,
        "Take the propellers off, fasten the aircraft, keep hands away",
    )


def confirm(given: bool, words: str, option: str, what: str, first: str) -> None:
    """Raise LinkError unless `option` was given, or somebody at a terminal types `words`.

    what: is about to happen; first: what the person has to do before; sentences.
    """
    if given:
        return
    if not sys.stdin.isatty():
        raise LinkError(f"{what}: {_small(first.split(',')[0])} and give {option}; no motor turned")
    print(f"{what}. {first}.\nType `{words}` if that is so: ", end="", file=sys.stderr, flush=True)
    typed = " ".join(sys.stdin.readline().lower().split())
    if typed != words:
        raise LinkError(f"got {typed!r}, expected {words!r} typed out; no motor turned")


def _small(sentence: str) -> str:
    return sentence[0].lower() + sentence[1:]
