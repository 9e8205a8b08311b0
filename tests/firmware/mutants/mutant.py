"""A mutant: the core of the firmware with one deliberate mistake, and the tests that must fail for it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Mutant:
    """One textual replacement in one source of the core."""

    name: str
    file: str  # in firmware/src/
    old: str  # stands there exactly once
    new: str
    tests: tuple[str, ...]  # in tests/firmware/, as pytest names them
    argued: str = ""  # why no test can catch it; empty: one must
    slow: bool = True  # for the long run only
