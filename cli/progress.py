"""Progress of a command that takes a while: bars on stderr, on a terminal only."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Protocol


class Update(Protocol):
    """A function that moves a bar."""

    def __call__(self, done: float, whole: float | None = 1.0, text: str | None = None) -> None:
        """Show how much is done, of how much, None: nobody knows; text: replaces the bar's."""


@contextmanager
def progress_bars(quiet: bool = False) -> Iterator[Callable[[str], Update]]:
    """Show bars, unless `quiet`; yield a function that adds one under a text and returns its update."""
    from rich.console import Console
    from rich.progress import Progress

    quiet = quiet or not sys.stderr.isatty()
    with Progress(console=Console(stderr=True), transient=True, disable=quiet) as bars:

        def add(text: str) -> Update:
            task = bars.add_task(text, total=None)

            def update(done: float, whole: float | None = 1.0, text: str | None = None) -> None:
                bars.update(task, completed=done, total=whole, description=text)

            return update

        yield add


@contextmanager
def step_bars(words: Mapping[str, str], quiet: bool = False) -> Iterator[Callable[[str, float, float], None]]:
    """Show a bar for each step, under its text in `words`, or its name where it has none there.

    Yields a function that takes the step's name, the done part of it, and the whole.
    """
    with progress_bars(quiet) as add:
        begun: dict[str, Update] = {}

        def update(step: str, done: float, whole: float) -> None:
            if step not in begun:
                begun[step] = add(words.get(step, step))
            begun[step](done, whole)

        yield update
