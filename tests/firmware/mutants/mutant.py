"""A mutant: the firmware with one deliberate mistake, and the tests that must fail for it."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

TOKEN = re.compile(r"\w+|[^\w\s]")


@dataclass(frozen=True)
class Mutant:
    """Some tokens of C for others, wherever and however formatted they stand in core or chip's directory."""

    name: str
    old: str  # found once
    new: str
    tests: tuple[str, ...]  # in tests/firmware/, as pytest names them
    within: str = ""  # the end of its file's path, where `old` alone is found elsewhere too
    argued: str = ""  # why no test can catch it; empty: one must

    def source(self, firmware: Path) -> Path:
        """Return its file, where the firmware lies in that folder. Raises MutantError."""
        of_old = spaced(self.old)
        counts = {
            path: text.count(of_old)
            for path, text in sources(firmware).items()
            if path.as_posix().endswith(self.within)
        }
        if sum(counts.values()) != 1:
            raise MutantError(
                f"{self.old!r} is found {sum(counts.values())} times, expected once: "
                f"the source has changed, choose another place for the mistake"
            )
        return max(counts, key=counts.__getitem__)

    def made(self, text: str) -> str:
        """Return the text of its file with the mistake in it."""
        return replaced(text, self.old, self.new)


class MutantError(Exception):
    """A mutant that says nothing of the tests: it has no place, does not compile, or they do not run."""


def spaced(text: str) -> str:
    """Return the tokens of C between spaces."""
    return f" {' '.join(TOKEN.findall(text))} "


def replaced(text: str, old: str, new: str) -> str:
    """Return `text` with `new` where the tokens of `old` first stand. Raises StopIteration."""
    found, wanted = list(TOKEN.finditer(text)), TOKEN.findall(old)
    tokens = [token[0] for token in found]
    at = next(at for at in range(len(tokens)) if tokens[at : at + len(wanted)] == wanted)
    return text[: found[at].start()] + new + text[found[at + len(wanted) - 1].end() :]


@cache
def sources(firmware: Path) -> dict[Path, str]:
    """Return the tokens of each file of core and chip, without any mistake."""
    folders = (firmware / "src", firmware / "hal" / "stm32f7")
    return {path: spaced(path.read_text()) for folder in folders for path in folder.rglob("*.[ch]")}
