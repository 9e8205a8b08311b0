"""Ranges and choices of configuration values: each stands in the type of its field.

`discount: Share = 0.99` is a number from 0 to 1: the same line tells readers, checks and the reference page.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, ClassVar, Literal, get_args, get_origin, get_type_hints

from neuroflight.toolchain.errors import TrainingError


@dataclass(frozen=True)
class Limits:
    """A range, of each number of a tuple. NaN is outside, None (not given) is inside."""

    low: float
    high: float = math.inf
    above: bool = False  # `low` itself is outside

    def holds(self, value: Any) -> bool:  # noqa: ANN401 - number, tuple of numbers, or None
        """Return True if a value is within the range."""
        numbers = value if isinstance(value, tuple) else () if value is None else (value,)
        return all(self.low <= n <= self.high and not (self.above and n == self.low) for n in numbers)

    def __str__(self) -> str:
        low, high = (f"{n}" if isinstance(n, int) else f"{n:g}" for n in (self.low, self.high))
        least = f"more than {low}" if self.above else low if self.high < math.inf else f"at least {low}"
        return f"{least} to {high}" if self.high < math.inf else least


@dataclass(frozen=True)
class OneOf:
    """A choice."""

    known: Sequence[object]

    def holds(self, value: object) -> bool:
        """Return True if a value is one of them."""
        return value in self.known

    def __str__(self) -> str:
        return f"one of: {', '.join(map(str, self.known))}"


Share = Annotated[float, Limits(0.0, 1.0)]
Positive = Annotated[float, Limits(0.0, above=True)]
NotNegative = Annotated[float, Limits(0.0)]


def value_errors(data: object, prefix: str = "") -> Iterator[str]:
    """Yield a line for each field of `data` whose value is outside what its type says.

    prefix: of the names in the lines, such as "output.".
    """
    kind: Any = type(data)  # mypy takes no class for hashable
    return _errors(data, _expected(kind), prefix)


def check_limits(what: str, data: object, **limits: tuple[float, float]) -> None:
    """Raise TrainingError naming the first attribute of `data` outside the limits given for it.

    what: the name of `data` in the message, such as "task pulse". For limits that depend on other fields, and
    for users' own tasks and rewards.
    """
    for error in _errors(data, {name: Limits(*both) for name, both in limits.items()}, ""):
        raise TrainingError(f"{what}: {error}")


class Checked:
    """A task or a reward whose values are checked when it is made."""

    name: ClassVar[str]

    def __post_init__(self) -> None:
        """Raise TrainingError naming the first value that is outside what its type says."""
        for error in value_errors(self):
            raise TrainingError(f"{'reward' if callable(self) else 'task'} {self.name}: {error}")


def _errors(data: object, expected: Mapping[str, Limits | OneOf], prefix: str) -> Iterator[str]:
    for name, rule in expected.items():
        if not rule.holds(value := getattr(data, name)):
            told = list(value) if isinstance(value, tuple) else value
            yield f"{prefix}{name} {told!r}, expected {rule}"


@cache
def _expected(kind: type[Any]) -> dict[str, Limits | OneOf]:
    """Return what the types of a class's fields say of their values."""
    found: dict[str, Limits | OneOf] = {}
    for name, hint in get_type_hints(kind, include_extras=True).items():
        marks = [OneOf(get_args(hint))] if get_origin(hint) is Literal else getattr(hint, "__metadata__", ())
        for mark in marks:
            if isinstance(mark, Limits | OneOf):
                found[name] = mark
    return found
