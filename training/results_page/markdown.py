"""Numbers and tables in Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def axes(values: Sequence[float | None], digits: int) -> str:
    """One number an axis; - where there is none."""
    return " / ".join("-" if value is None else number(value, digits) for value in values)


def number(value: float | None, digits: int) -> str:
    """With that many decimals; nothing where there is none."""
    return "" if value is None else f"{value:,.{digits}f}"


def table(heading: Sequence[str], rows: Iterable[Sequence[str]], align: str = "---:") -> str:
    """A table; `align`: of all columns but the first."""
    lines = [heading, ["---", *[align] * (len(heading) - 1)], *rows]
    return "\n".join(f"| {' | '.join(cell.replace('|', '/') for cell in line)} |" for line in lines)
