"""A mutant: the firmware with one deliberate mistake, and the tests that must fail for it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Mutant:
    """One textual replacement in one source of the core, or of a chip's directory."""

    name: str
    file: str  # in firmware/src/, or in firmware/ where it begins with hal/
    old: str  # stands there exactly once
    new: str
    tests: tuple[str, ...]  # in tests/firmware/, as pytest names them
    argued: str = ""  # why no test can catch it; empty: one must

    @property
    def of_chip(self) -> bool:
        """Does it concern a chip's directory, so that its tests build an image?"""
        return self.file.startswith("hal/")

    def source(self, firmware: Path) -> Path:
        """Its file, where the firmware lies in that folder."""
        return firmware / self.file if self.of_chip else firmware / "src" / self.file
