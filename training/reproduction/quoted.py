"""A figure of the dissertation as a row shows it: one number, or roll, pitch and yaw of a table's row."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from neuroflight.training.dissertation.quotes import AXES, Printed, quotes

DIGITS = 2  # that count in the margin of a figure that follows from printed ones
DECIMALS_MAX = 4  # of one


@dataclass(frozen=True)
class Quoted:
    """One number or several, with the margin of each."""

    name: str  # of the quote, or of a row of a table with columns roll, pitch and yaw
    value: tuple[float, ...]
    allowed: tuple[float, ...]  # half width of what it may stand for: its confidence, or half its last digit
    text: str  # as it is printed, with its confidence
    digits: int  # decimals of the value that are printed
    decimals: int  # that are needed to write a value with its half width
    confident: bool = False  # whether a confidence is printed of each number

    @property
    def rounded(self) -> Quoted:
        """The same, rounded to the decimals that are shown; a margin is at least one of the last of them."""
        least = 10.0**-self.decimals
        value = tuple(round(number, self.decimals) for number in self.value)
        allowed = tuple(max(round(width, self.decimals), least) for width in self.allowed)
        return replace(self, value=value, allowed=allowed)

    @property
    def mean(self) -> Quoted:
        """The mean of its axes."""
        count = len(self.value)
        if count == 1:
            return self
        found = _follows(
            f"mean of {self.name}", [sum(self.value) / count], [math.hypot(*self.allowed) / count]
        )
        return replace(found, confident=self.confident)

    def over(self, other: Quoted) -> Quoted:
        """Return the ratio to another figure. Raises ValueError where that may be 0."""
        if len(self.value) != len(other.value):
            raise ValueError(f"{self.name} has {len(self.value)} numbers, {other.name} {len(other.value)}")
        if any(abs(number) <= allowed for number, allowed in zip(other.value, other.allowed, strict=True)):
            raise ValueError(f"{other.name} may be 0; nothing is divided by it")
        ratios, widths = [], []
        for i, number in enumerate(self.value):
            ratios.append(number / other.value[i])
            wide = math.hypot(self.allowed[i], ratios[i] * other.allowed[i])
            widths.append(abs(wide / other.value[i]))
        found = _follows(f"{self.name} / {other.name}", ratios, widths)
        return replace(found, confident=self.confident and other.confident)


def quoted(name: str) -> Quoted:
    """Return the quote called `name`, or the three of a table's row. Raises QuoteError if there is none."""
    known = quotes()
    if name in known or f"{name}/{AXES[0]}" not in known:
        quote = known[name]
        return printed(name, quote.value, [quote.margin] * len(quote.value))
    cells = [known[f"{name}/{axis}"] for axis in AXES]
    return printed(name, [number for cell in cells for number in cell.value], [cell.margin for cell in cells])


def printed(name: str, value: Sequence[Printed], margin: Sequence[Printed | None]) -> Quoted:
    """Return a figure of printed numbers, each with its confidence, where that is printed."""
    allowed, decimals = [], []
    for number, width in zip(value, margin, strict=True):
        rounded = 0.5 * 10.0**-number.decimals
        confidence = 0.0 if width is None else float(width)
        allowed.append(max(rounded, confidence))
        finer = 0 if width is None else width.decimals
        decimals.append(max(number.decimals, finer) if confidence >= rounded else number.decimals + 1)
    text = " / ".join(map(written, value))
    widths = [width for width in margin if width is not None]
    if len(widths) == len(value):
        text += " ± " + " / ".join(map(written, widths[:1] if len(set(widths)) == 1 else widths))
    digits = max(0, *(number.decimals for number in value))
    return Quoted(
        name,
        tuple(map(float, value)),
        tuple(allowed),
        text,
        digits,
        max(0, *decimals),
        len(widths) == len(value),
    )


def written(number: Printed) -> str:
    """Return a number as the dissertation prints it."""
    if "e" in number.text.lower():
        return f"{float(number):,.0f}" if abs(number) >= 1.0 else number.text
    return f"{number:,.{number.decimals}f}"


def _follows(name: str, value: Sequence[float], allowed: Sequence[float]) -> Quoted:
    """Return a figure computed from printed ones, with as many decimals as its margin justifies."""
    least = min(width for width in allowed if width > 0.0)
    decimals = min(DECIMALS_MAX, max(0, DIGITS - 1 - math.floor(math.log10(least))))
    found = Quoted(name, tuple(value), tuple(allowed), "", decimals, decimals).rounded
    shown = (
        " / ".join(f"{number:,.{decimals}f}" for number in each) for each in (found.value, found.allowed)
    )
    return Quoted(name, tuple(value), tuple(allowed), " ± ".join(shown), decimals, decimals)
