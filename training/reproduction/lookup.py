"""Our figures in a command's JSON, by a path.

A path is keys joined by dots. `[2]` is an entry of a list, `[1:4]` the mean over some of its entries, and
`[best 1:4]` that one of them whose summed error (`response.error.value`, over the axes) is the least: the
dissertation's choice of an agent (chapter 3). `margin` is half the distance of `low` and `high` where they
stand; of a mean over entries it is as if each of them had flown commands of its own.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from typing import Any

from neuroflight.training.reproduction.experiments import Figure, ReproduceError

Value = float | tuple[float, ...]  # of one thing, or of roll, pitch, yaw
PART = re.compile(r"([^.\[\]]+)|\[(best )?(-?\d+)(?:(:)(\d+)?)?\]")
CHOSEN_BY = "response.error.value"
MARGIN = "margin"


def find(document: Any, path: str) -> Value:  # noqa: ANN401 - any JSON value
    """Return the number, or the numbers, at `path`. Raises ReproduceError naming the part that is missing."""
    at, value = 0, document
    while at < len(path):
        part = PART.match(path, at)
        if part is None:
            raise ReproduceError(f"path {path}: not understood from {path[at:][:20]!r} on")
        at = part.end()
        rest = path[at:].removeprefix(".")
        key, best, index, span, end = part.groups()
        if key is not None:
            if key == MARGIN and isinstance(value, dict) and {"low", "high"} <= value.keys():
                return _half(_number(value["low"], path), _number(value["high"], path))
            if not isinstance(value, dict) or key not in value:
                raise ReproduceError(f"path {path}: {key}: not in the command's output")
            value = value[key]
        elif not isinstance(value, list):
            raise ReproduceError(f"path {path}: {part.group()}: no list stands there")
        elif span is None and best is None:
            if not -len(value) <= int(index) < len(value):
                raise ReproduceError(f"path {path}: {part.group()}: the list has {len(value)} entries")
            value = value[int(index)]
        else:
            some = value[int(index) : int(end) if end else None]
            if not some:
                raise ReproduceError(f"path {path}: {part.group()}: the list has {len(value)} entries")
            if best is None:
                found = [find(each, rest) for each in some]
                return _mean_margin(found) if rest.endswith(MARGIN) else _mean(found)
            value = min(some, key=_error)
        if path[at : at + 1] == ".":
            at += 1
    return _number(value, path)


def ours(
    figure: Figure,
    found: Value,
    against: Value | None = None,
    times: Value | None = None,
    per: Value | None = None,
) -> Value:
    """Return our figure: `found`, or its change in % from `against`; times `times`, over `per`; scaled."""
    steps: tuple[tuple[Value | None, Callable[[float, float], float]], ...] = (
        (against, _change),
        (times, lambda value, factor: value * factor),
        (per, lambda value, other: value / other if other else math.nan),
    )
    found = _axes(figure, found)
    for other, of in steps:
        if other is not None:
            found = _pairs(figure, found, _axes(figure, other), of)
    return scaled(found, figure.scale)


def _axes(figure: Figure, value: Value) -> Value:
    return sum(value) / len(value) if figure.mean and isinstance(value, tuple) else value


def scaled(value: Value, factor: float) -> Value:
    """Return a value times a factor, axis by axis."""
    return tuple(factor * each for each in value) if isinstance(value, tuple) else factor * value


def _pairs(figure: Figure, new: Value, old: Value, of: Callable[[float, float], float]) -> Value:
    if isinstance(new, tuple) and isinstance(old, tuple):
        return tuple(of(*each) for each in zip(new, old, strict=True))
    if isinstance(old, tuple):
        raise ReproduceError(f"{figure.what}: one number is compared with three")
    return tuple(of(each, old) for each in new) if isinstance(new, tuple) else of(new, old)


def _error(entry: Any) -> float:  # noqa: ANN401 - any JSON value
    error = find(entry, CHOSEN_BY)
    return sum(error) if isinstance(error, tuple) else error


def _change(new: float, old: float) -> float:
    return 100.0 * (new / old - 1.0) if old else math.nan


def _mean(values: Sequence[Value]) -> Value:
    first = values[0]
    if isinstance(first, tuple):
        columns = zip(*(value if isinstance(value, tuple) else (value,) for value in values), strict=True)
        return tuple(sum(column) / len(values) for column in columns)
    return sum(value for value in values if not isinstance(value, tuple)) / len(values)


def _half(low: Value, high: Value) -> Value:
    if isinstance(low, tuple) and isinstance(high, tuple):
        return tuple((b - a) / 2.0 for a, b in zip(low, high, strict=True))
    assert not isinstance(low, tuple) and not isinstance(high, tuple)
    return (high - low) / 2.0


def _mean_margin(margins: Sequence[Value]) -> Value:
    """Return half the width of the interval of a mean, from those of the independent values."""
    count = len(margins)
    columns = zip(*(each if isinstance(each, tuple) else (each,) for each in margins), strict=True)
    found = tuple(math.hypot(*column) / count for column in columns)
    return found if isinstance(margins[0], tuple) else found[0]


def _number(value: Any, path: str) -> Value:  # noqa: ANN401 - any JSON value
    if isinstance(value, list) and value and all(_is_number(each) for each in value):
        return tuple(float(each) for each in value)
    if _is_number(value):
        return float(value)
    raise ReproduceError(f"path {path}: got {str(value)[:40]!r}, expected a number or a list of numbers")


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
