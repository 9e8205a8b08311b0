"""The verdict on our figures beside the dissertation's, by one rule for all.

The margin of a comparison is the printed confidence, or half of the last printed digit, whichever is more,
and ours beside it: the root of the sum of their squares. Where ours has a confidence and the dissertation's
has none, as much is taken for it as for ours, which flew as many commands. Ours is *surpassed* if it is
better by more than the margin on every axis, *reached* if it is worse by no more than the margin on any,
else *not reached*. A difference within the margin is a tie, so it is no win. Numbers are compared as the
page shows them: rounded to the decimals of the bar.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

from neuroflight.training.reproduction.experiments import TARGET, Figure, ReproduceError
from neuroflight.training.reproduction.lookup import Value
from neuroflight.training.reproduction.quoted import Quoted

AXES = ("roll", "pitch", "yaw")


class Verdict(Enum):
    """The result of comparing our figure with the dissertation's."""

    SURPASSED = "surpassed"  # better by more than the margin on every axis
    REACHED = "reached"  # worse by no more than the margin on any axis
    NOT_REACHED = "not reached"
    UNLIKE = "not comparable"  # the two are not of the same thing
    INPUT = "input"  # ours was set to the dissertation's
    TOLD = ""  # it has no printed figure beside it


@dataclass(frozen=True)
class Judged:
    """A verdict, and the axes on which the figure is not reached."""

    verdict: Verdict
    axes: tuple[str, ...] = ()
    why: str = ""  # of UNLIKE

    def __str__(self) -> str:
        """Return the text that is printed."""
        more = self.why or ", ".join(self.axes)
        return f"{self.verdict.value}: {more}" if more else self.verdict.value


@dataclass(frozen=True)
class Bar:
    """The bar of our figure on each axis: it is reached if its badness is at most `most`."""

    aim: str
    ideal: tuple[float, ...]  # of "near" and "to NUMBER": the badness is the distance to it
    most: tuple[float, ...]
    less: tuple[float, ...]  # less badness than that is surpassed
    decimals: int

    def verdict(self, axis: int, value: float) -> Verdict:
        """Return the verdict on our value of an axis."""
        bad = round(_badness(self.aim, round(value, self.decimals), self.ideal[axis]), self.decimals)
        if bad < self.less[axis]:
            return Verdict.SURPASSED
        return Verdict.REACHED if bad <= self.most[axis] else Verdict.NOT_REACHED

    def __str__(self) -> str:
        """Return the text that is printed."""
        sign = -1.0 if self.aim == "higher" else 1.0
        limits = _joined(f"{sign * limit + 0.0:,.{self.decimals}f}" for limit in self.most)
        if self.aim in ("lower", "higher"):
            return f"{'<=' if self.aim == 'lower' else '>='} {limits}"
        return f"within {limits} of {_joined(f'{ideal:,.12g}' for ideal in self.ideal)}"


def bar(figure: Figure, confidence: Value | None = None) -> Bar | None:
    """Return the bar of a figure, given the confidence of our value; None if it has none."""
    quote = figure.quote
    if quote is None or not figure.aim:
        return None
    target = TARGET.fullmatch(figure.aim)
    ideal = quote.value if target is None else (float(target[1]),) * len(quote.value)
    printed = [_badness(figure.aim, *each) for each in zip(quote.value, ideal, strict=True)]
    margins = _margins(quote, confidence)
    most, less = (
        tuple(
            round(bad + sign * margin, quote.decimals) for bad, margin in zip(printed, margins, strict=True)
        )
        for sign in (1, -1)
    )
    return Bar(figure.aim, ideal, most, less, quote.decimals)


def judge(figure: Figure, value: Value, confidence: Value | None = None) -> Judged:
    """Return the verdict on our `value` of a figure; one with three numbers is compared axis by axis."""
    if figure.input:
        return Judged(Verdict.INPUT)
    if figure.unlike:
        return Judged(Verdict.UNLIKE, why=figure.unlike)
    found = value if isinstance(value, tuple) else (value,)
    held = bar(figure, confidence)
    if held is None:
        return Judged(Verdict.TOLD)
    if len(found) != len(held.most):
        raise ReproduceError(
            f"{figure.what}: {len(found)} numbers beside {len(held.most)} of the dissertation"
        )
    results = [held.verdict(axis, each) for axis, each in enumerate(found)]
    missed = tuple(AXES[i] for i, each in enumerate(results) if each is Verdict.NOT_REACHED)
    if missed:
        return Judged(Verdict.NOT_REACHED, missed if len(results) == 3 and len(missed) < 3 else ())
    surpassed = all(each is Verdict.SURPASSED for each in results)
    return Judged(Verdict.SURPASSED if surpassed else Verdict.REACHED)


def _margins(quote: Quoted, confidence: Value | None) -> tuple[float, ...]:
    """Return the margin on each axis within which our figure counts as the dissertation's."""
    if confidence is None:
        return quote.allowed
    ours = confidence if isinstance(confidence, tuple) else (confidence,) * len(quote.allowed)
    pairs = zip(quote.allowed, ours, strict=True)
    if quote.confident:
        return tuple(math.hypot(*pair) for pair in pairs)
    return tuple(max(rounded, math.sqrt(2.0) * own) for rounded, own in pairs)


def _badness(aim: str, value: float, ideal: float) -> float:
    """Return a number that is lower for a better value."""
    if aim == "lower":
        return value
    return -value if aim == "higher" else abs(value - ideal)


def _joined(texts: Iterable[str]) -> str:
    """Join the texts of the axes, or return the one that all have."""
    found = list(texts)
    return found[0] if len(set(found)) == 1 else " / ".join(found)
