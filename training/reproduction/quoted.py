"""A figure of the dissertation as a row shows it: one number, or roll, pitch and yaw of a table's row."""

from __future__ import annotations

from dataclasses import dataclass

from training.dissertation.quotes import AXES, quotes

DIGITS_MAX = 6


@dataclass(frozen=True)
class Quoted:
    """One number or several, with their confidence."""

    name: str  # of the quote, or of a row of a table with columns roll, pitch and yaw
    value: tuple[float, ...]
    margin: tuple[float, ...] | None  # half widths of their 95 % confidence, where they are printed

    @property
    def digits(self) -> int:
        """Decimals that are printed, at most."""
        return max(_decimals(value) for value in (*self.value, *(self.margin or ())))

    @property
    def allowed(self) -> tuple[float, ...]:
        """Half width of what each number may stand for: its confidence, or more where rounding took more."""
        rounded = 0.5 * 10.0**-self.digits
        return tuple(max(rounded, margin) for margin in self.margin or (0.0,) * len(self.value))


def quoted(name: str) -> Quoted:
    """The quote called `name`, or the three of a table's row. Raises QuoteError if there is none."""
    known = quotes()
    if name in known or f"{name}/{AXES[0]}" not in known:
        quote = known[name]
        margin = None if quote.margin is None else (quote.margin,) * len(quote.value)
        return Quoted(name, quote.value, margin)
    cells = [known[f"{name}/{axis}"] for axis in AXES]
    margins = [cell.margin for cell in cells if cell.margin is not None]
    return Quoted(
        name,
        tuple(number for cell in cells for number in cell.value),
        tuple(margins) if len(margins) == len(cells) else None,
    )


def _decimals(value: float) -> int:
    if value == int(value):
        return 0
    text = f"{value:.{DIGITS_MAX}f}".rstrip("0")
    return len(text.partition(".")[2]) or DIGITS_MAX
