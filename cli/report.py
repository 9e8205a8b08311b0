"""Output of commands: tables, means with their confidence, progress."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from neuroflight.sim.analysis.confidence import Mean

GAP = 2  # [characters] between columns


@dataclass(frozen=True)
class Table:
    """A heading and rows of cells; the first column names the rows."""

    title: str
    rows: Sequence[tuple[str, ...]]  # the first is the heading
    note: str = ""


def print_table(title: str, rows: Sequence[tuple[str, ...]], note: str = "", *, left: bool = False) -> None:
    """Print rows under their heading, which is the first; numbers to the right unless `left`.

    A table of numbers that is wider than the screen is printed in parts, each with the first column: digits
    are never cut. Texts (`left`) are folded.
    """
    from rich.cells import cell_len
    from rich.console import Console
    from rich.table import Table as Shown
    from rich.text import Text

    console = Console()
    width = console.width
    widths = [
        max(cell_len(line) for cell in column for line in cell.split("\n"))
        for column in zip(*rows, strict=True)
    ]
    parts = [range(1, len(widths))] if left else _parts(widths, width)
    if title:
        console.print(Text(title, style="bold"))
    for part in parts:
        shown = Shown(box=None, pad_edge=False, show_header=any(rows[0]))
        for number in (0, *part):
            shown.add_column(
                Text(rows[0][number]),
                justify="right" if number and not left else "left",
                overflow="fold",
                no_wrap=not left,
            )
        for row in rows[1:]:
            shown.add_row(*(Text(row[number]) for number in (0, *part)))
        needed = widths[0] + sum(GAP + widths[number] for number in part)
        console.width = width if left else max(width, needed)
        console.print(shown, crop=left)
    console.width = width
    if note:
        console.print(Text(note), style="dim")


def _parts(widths: Sequence[int], width: int) -> list[range]:
    """Return the columns after the first in groups that fit on the screen beside it."""
    ends, used = [1], widths[0]
    for number in range(1, len(widths)):
        used += GAP + widths[number]
        if used > width and number > ends[-1]:
            ends.append(number)
            used = widths[0] + GAP + widths[number]
    return [range(start, end) for start, end in pairwise([*ends, len(widths)])]


@contextmanager
def progress_bars(quiet: bool) -> Iterator[Callable[[str], Callable[[int, int], None]]]:
    """Show bars on stderr, unless `quiet` or in a log; yield a function that adds one."""
    from rich.console import Console
    from rich.progress import Progress

    quiet = quiet or not sys.stderr.isatty()
    with Progress(console=Console(stderr=True), transient=True, disable=quiet) as bars:

        def add(label: str) -> Callable[[int, int], None]:
            task = bars.add_task(label)
            return lambda done, total: bars.update(task, completed=done, total=total)

        yield add


def with_margin(value: float, margin: float, digits: int) -> str:
    """Return a mean and its margin; the mean alone where a single flight leaves no margin to tell."""
    return f"{value:,.{digits}f} ± {margin:,.{digits}f}" if margin > 0.0 else f"{value:,.{digits}f}"


def interval(mean: Mean, digits: int, factor: float = 1.0, axis: int | tuple[()] = ()) -> str:
    """Return a mean and its margin as a cell; axis: the one of three."""
    if not mean.count[axis]:
        return "none"
    margin = factor * float((mean.high - mean.low)[axis]) / 2
    return with_margin(factor * float(mean.value[axis]), margin, digits)


def difference(mean: Mean, digits: int, factor: float = 1.0) -> str:
    """Return a mean difference as a cell; ≈ where its confidence does not tell it from none."""
    known = bool((mean.low > 0.0 or mean.high < 0.0) and mean.low < mean.high)  # a single flight has none
    mark = "" if known or not mean.count else "≈ "
    return f"{mark}{'+' if mean.value > 0 else ''}{interval(mean, digits, factor)}"
