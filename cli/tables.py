"""Tables of `neuroflight board`: coloured on a terminal, as wide as they need to be in a file or pipe."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

WIDTH = 160  # where there is no terminal


def console() -> Console:
    """Return the console that tables are printed on."""
    from rich.console import Console

    if sys.stdout.isatty():
        return Console(highlight=False)
    return Console(highlight=False, force_terminal=False, color_system=None, width=WIDTH)


def print_facts(rows: Iterable[tuple[str, str]]) -> None:
    """Print a label and a text on each line."""
    from rich.table import Table
    from rich.text import Text

    table = Table.grid(padding=(0, 2))
    for label, value in rows:
        table.add_row(Text(label, style="bold"), Text(value, overflow="fold"))
    console().print(table)


def print_table(heads: Sequence[str], rows: Iterable[Sequence[str]], numbers: frozenset[str]) -> None:
    """Print rows below their heads; the columns of `numbers` stand right."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False)
    for head in heads:
        table.add_column(head, justify="right" if head in numbers else "left", overflow="fold")
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))
    console().print(table)


def print_json(value: object) -> None:
    """Print one JSON document."""
    print(json.dumps(value, indent=2))
