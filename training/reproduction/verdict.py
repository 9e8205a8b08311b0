"""Ours beside the dissertation's: reached, surpassed or not reached, axis by axis."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from training.reproduction.experiments import TARGET, Figure
from training.reproduction.lookup import Value
from training.reproduction.quoted import Quoted

AXES = ("roll", "pitch", "yaw")
EFFECT_LEAST = 0.5  # of a printed effect: a change of the same sign and half its size has reached it


class Verdict(Enum):
    """How our figure compares with the dissertation's."""

    SURPASSED = "surpassed"  # better on every axis
    REACHED = "reached"  # no worse on any axis than the printed confidence or rounding allows
    NOT_REACHED = "not reached"
    TOLD = "told"  # it has no better and no worse

    def __str__(self) -> str:
        """As it is printed."""
        return "" if self is Verdict.TOLD else self.value


@dataclass(frozen=True)
class Judged:
    """A verdict, and the axes on which the figure is not reached."""

    verdict: Verdict
    axes: tuple[str, ...] = ()

    def __str__(self) -> str:
        """As it is printed."""
        return f"{self.verdict}: {', '.join(self.axes)}" if self.axes else str(self.verdict)


def judge(figure: Figure, value: Value) -> Judged:
    """The verdict on our `value` of a figure.

    Reached is what is within the printed confidence; where none is printed, within half of the last printed
    digit. A figure that the dissertation gives three numbers for is compared axis by axis.
    """
    quote = figure.quote
    if quote is None or figure.aim == "told":
        return Judged(Verdict.TOLD)
    printed, found = quote.value, value if isinstance(value, tuple) else (value,)
    if len(printed) != len(found):
        printed, found = _mean_of(printed), _mean_of(found)
    margins = _margins(quote, len(found))
    compare = _comparison(figure)
    results = [compare(*each) for each in zip(found, printed, margins, strict=True)]
    missed = tuple(AXES[i] for i, each in enumerate(results) if each is Verdict.NOT_REACHED)
    if missed:
        return Judged(Verdict.NOT_REACHED, missed if len(results) == 3 and len(missed) < 3 else ())
    surpassed = all(each is Verdict.SURPASSED for each in results)
    return Judged(Verdict.SURPASSED if surpassed else Verdict.REACHED)


def _mean_of(values: tuple[float, ...]) -> tuple[float, ...]:
    """One number for all axes, where the other side has only one."""
    return (sum(values) / len(values),)


def _margins(quote: Quoted, count: int) -> tuple[float, ...]:
    return quote.allowed if len(quote.allowed) == count else (max(quote.allowed),) * count


def _comparison(figure: Figure) -> Callable[[float, float, float], Verdict]:
    """Compares our number with the printed one and its margin."""
    aim, within = figure.aim, figure.within
    if aim == "lower":
        return lambda our, its, margin: _least(our, its, margin)
    if aim == "higher":
        return lambda our, its, margin: _least(-our, -its, margin)
    if aim == "near":
        return lambda our, its, margin: _near(our, its, max(margin, within * abs(its)))
    if aim == "effect":
        return lambda our, its, margin: _effect(our, its)
    target = TARGET.fullmatch(aim)
    assert target is not None
    ideal = float(target[1])
    return lambda our, its, margin: _least(abs(our - ideal), abs(its - ideal), margin)


def _least(our: float, its: float, margin: float) -> Verdict:
    if our < its:
        return Verdict.SURPASSED
    return Verdict.REACHED if our <= its + margin else Verdict.NOT_REACHED


def _near(our: float, its: float, far: float) -> Verdict:
    return Verdict.REACHED if abs(our - its) <= far else Verdict.NOT_REACHED


def _effect(our: float, its: float) -> Verdict:
    """Of a change in %: the same sign, and as large or at least half as large."""
    size = our / its if its else 0.0
    if size >= 1.0:
        return Verdict.SURPASSED
    return Verdict.REACHED if size >= EFFECT_LEAST else Verdict.NOT_REACHED
