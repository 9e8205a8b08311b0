"""Numbers and tables in Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def axes(values: Sequence[float | None], digits: int) -> str:
    """Return one number for each axis, or - for None."""
    return " / ".join("-" if value is None else number(value, digits) for value in values)


def number(value: float | None, digits: int) -> str:
    """Return a number with that many decimals; empty for None."""
    return "" if value is None else f"{value:,.{digits}f}"


def table(heading: Sequence[str], rows: Iterable[Sequence[str]], align: str = "---:") -> str:
    """Return a table; `align`: of all columns but the first."""
    lines = [heading, ["---", *[align] * (len(heading) - 1)], *rows]
    return "\n".join(f"| {' | '.join(cell.replace('|', '/') for cell in line)} |" for line in lines)
