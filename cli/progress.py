"""A bar for each step of a command that takes a while."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager


@contextmanager
def step_bars(words: Mapping[str, str]) -> Iterator[Callable[[str, int, int], None]]:
    """Show a bar for each step, by the step's name in `words`, on a terminal.

    Yields a function that takes the step, the done part of it, and the whole.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description:10}"), BarColumn(), TextColumn("{task.percentage:3.0f} %"))
    console = Console(stderr=True)
    hidden = not console.is_terminal
    with Progress(*columns, TimeRemainingColumn(), console=console, transient=True, disable=hidden) as bars:
        tasks: dict[str, TaskID] = {}

        def update(step: str, done: int, total: int) -> None:
            if step not in tasks:
                tasks[step] = bars.add_task(words[step], total=total)
            bars.update(tasks[step], completed=done)

        yield update
