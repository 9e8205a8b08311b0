"""Functions that `results` and `reproduce` share: lines about the steps that run, and the check of a page."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from neuroflight.cli import tree
from neuroflight.cli.options import OLD_ON
from neuroflight.toolchain.errors import NeuroflightError
from neuroflight.training.reproduction.steps import Done, Watcher

if TYPE_CHECKING:
    from rich.console import Console

    from neuroflight.training.reproduction.experiments import Step


class Lines(Watcher):
    """A watcher that prints a line for each step, and keeps the causes of failures in `reasons`."""

    def __init__(self, console: Console, count: int) -> None:
        self.reasons: dict[str, str] = {}
        self._console, self._count, self._ended = console, count, 0

    def started(self, step: Step) -> None:
        """Print that a step begins, see Watcher."""
        self._console.print(f"{step.name}: begins", style="dim")

    def finished(self, done: Done, *, again: bool) -> None:
        """Print that a step has ended, see Watcher."""
        self._end(f"{done.step.name}: {f'{done.seconds:.0f} s' if again else 'was there'}")

    def outdated(self, step: Step, name: str) -> None:
        """Print that a result is outdated, see Watcher."""
        self._console.print(f"{step.name}: {name} has changed since it ran", markup=False)

    def failed(self, step: Step, reason: str) -> None:
        """Print that a step failed, see Watcher."""
        self.reasons[step.name] = reason
        self._end(f"{step.name}: failed: {reason}", "red")

    def _end(self, line: str, style: str = "") -> None:
        self._ended += 1
        self._console.print(f"[{self._ended} of {self._count}] {line}", markup=False, style=style)


def renewed(words: Sequence[str]) -> list[str]:
    """Return today's words for those of before, so that what they gave is still known."""
    now, _ = tree.rewritten(words)
    return [OLD_ON.get(word, word) if before == "--on" else word for before, word in pairwise(["", *now])]


def check_page(page: Path, text: str, stored: Path, command: str) -> None:
    """Raise NeuroflightError if the page does not agree with the stored files."""
    if not page.is_file() or page.read_bytes() != text.encode():
        raise NeuroflightError(f"{page}: not what the files in {stored} give; run `{command}`")
