"""Output of commands: tables, facts, JSON, means with their confidence."""

from __future__ import annotations

import json
import sys
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from rich.console import Console

    from neuroflight.sim.analysis.confidence import Mean

GAP = 2  # [characters] between columns
WIDTH = 160  # [characters] of tables with texts where there is no terminal


@dataclass(frozen=True)
class Table:
    """A heading and rows of cells; the first column names the rows."""

    title: str
    rows: Sequence[tuple[str, ...]]  # the first is the heading
    note: str = ""


def console(width: int | None = WIDTH) -> Console:
    """Return the console of stdout. width: where that is no terminal."""
    from rich.console import Console

    return Console(highlight=False, width=None if sys.stdout.isatty() else width)


def print_json(value: object) -> None:
    """Print one JSON document."""
    print(json.dumps(value, indent=2))


class Account:
    """The account of a command that acts: lines for people as it goes, or one JSON document at its end."""

    def __init__(self, json: bool) -> None:
        self.json = json

    def say(self, line: str) -> None:
        """Print a line for people."""
        if not self.json:
            print(line, flush=True)

    def end(self, document: object, line: str = "") -> int:
        """Print the document, or the last line for people where there is one. Returns 0, the exit code."""
        if self.json:
            print_json(document)
        elif line:
            self.say(line)
        return 0


def print_facts(rows: Iterable[Sequence[str]], styles: Sequence[str] = ()) -> None:
    """Print a label and texts on each line; styles: of the labels, bold unless given."""
    from rich.table import Table as Shown
    from rich.text import Text

    table = Shown.grid(padding=(0, GAP))
    for number, (label, *texts) in enumerate(rows):
        style = styles[number] if styles else "bold"
        table.add_row(Text(label, style=style), *(Text(text, overflow="fold") for text in texts))
    console().print(table)


def print_table(
    title: str, rows: Sequence[Sequence[str]], note: str = "", *, numbers: Collection[str] | None = None
) -> None:
    """Print rows under their heading, which is the first.

    numbers: headings of the columns that hold numbers, which stand right; all but the first unless given.
    A table of numbers that is wider than the screen is printed in parts, each with the first column: digits
    are never cut. Texts are folded. A note is wrapped on a terminal only.
    """
    from rich.cells import cell_len
    from rich.table import Table as Shown
    from rich.text import Text

    texts = numbers is not None
    out = console(WIDTH if texts else None)
    width = out.width
    right = rows[0][1:] if numbers is None else numbers
    widths = [
        max(cell_len(line) for cell in column for line in cell.split("\n"))
        for column in zip(*rows, strict=True)
    ]
    if title:
        out.print(Text(title, style="bold"))
    for part in [range(1, len(widths))] if texts else _parts(widths, width):
        shown = Shown(box=None, pad_edge=False, show_header=any(rows[0]))
        for number in (0, *part):
            head = rows[0][number]
            side: Literal["left", "right"] = "right" if head in right and (number or texts) else "left"
            shown.add_column(Text(head), justify=side, overflow="fold", no_wrap=not texts)
        for row in rows[1:]:
            shown.add_row(*(Text(row[number]) for number in (0, *part)))
        needed = widths[0] + sum(GAP + widths[number] for number in part)
        out.width = width if texts else max(width, needed)
        out.print(shown, crop=texts)
    out.width = width
    if note:
        out.print(Text(note), style="dim", soft_wrap=not out.is_terminal)


def _parts(widths: Sequence[int], width: int) -> list[range]:
    """Return the columns after the first in groups that fit on the screen beside it."""
    ends, used = [1], widths[0]
    for number in range(1, len(widths)):
        used += GAP + widths[number]
        if used > width and number > ends[-1]:
            ends.append(number)
            used = widths[0] + GAP + widths[number]
    return [range(start, end) for start, end in pairwise([*ends, len(widths)])]


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
