"""Figures of ours in a command's JSON, by a path.

A path is keys joined by dots. `[2]` is an entry of a list, `[1:4]` the mean over some of its entries, and
`[best 1:4]` that one of them whose summed error (`response.error.value`, over the axes) is the least: the
dissertation's choice of an agent (chapter 3).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from typing import Any

from training.reproduction.experiments import Figure, ReproduceError

Value = float | tuple[float, ...]  # of one thing, or of roll, pitch, yaw
PART = re.compile(r"([^.\[\]]+)|\[(best )?(-?\d+)(?:(:)(\d+)?)?\]")
CHOSEN_BY = "response.error.value"


def find(document: Any, path: str) -> Value:  # noqa: ANN401 - any JSON value
    """The number, or the numbers, at `path`. Raises ReproduceError naming the part that is not there."""
    at, value = 0, document
    while at < len(path):
        part = PART.match(path, at)
        if part is None:
            raise ReproduceError(f"path {path}: not understood from {path[at:][:20]!r} on")
        at = part.end()
        rest = path[at:].removeprefix(".")
        key, best, index, span, end = part.groups()
        if key is not None:
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
                return _mean([find(each, rest) for each in some])
            value = min(some, key=_error)
        if path[at : at + 1] == ".":
            at += 1
    return _number(value, path)


def ours(figure: Figure, found: Value, against: Value | None) -> Value:
    """Our figure from what stands in the output, or the change in % from `against`; scaled."""
    if against is None:
        return _each(found, lambda value: figure.scale * value)
    if isinstance(found, tuple) and isinstance(against, tuple):
        changes = tuple(_change(new, old) for new, old in zip(found, against, strict=True))
        return _each(changes, lambda value: figure.scale * value)
    if isinstance(found, tuple) or isinstance(against, tuple):
        raise ReproduceError(f"{figure.what}: one number is compared with three")
    return figure.scale * _change(found, against)


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


def _each(value: Value, of: Callable[[float], float]) -> Value:
    return tuple(of(each) for each in value) if isinstance(value, tuple) else of(value)


def _number(value: Any, path: str) -> Value:  # noqa: ANN401 - any JSON value
    if isinstance(value, list) and value and all(_is_number(each) for each in value):
        return tuple(float(each) for each in value)
    if _is_number(value):
        return float(value)
    raise ReproduceError(f"path {path}: got {str(value)[:40]!r}, expected a number or a list of numbers")


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
