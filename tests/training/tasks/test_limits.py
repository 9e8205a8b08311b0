"""Ranges and choices in the types of fields: each kind of rule, and its words."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import pytest

from neuroflight.toolchain.errors import TrainingError
from neuroflight.training.tasks.limits import (
    Checked,
    Limits,
    OneOf,
    Positive,
    Share,
    check_limits,
    value_errors,
)


@dataclass(frozen=True)
class Values(Checked):
    """A field for each rule."""

    name: ClassVar[str] = "mine"
    share: Share = 0.5
    rate: Positive = 1.0
    part: Annotated[float | None, Limits(0.0, 1.0, above=True)] = None
    count: Annotated[int, Limits(1, 10_000_000)] = 1
    span: Annotated[tuple[float, float], Limits(0.01, 600.0)] = (0.1, 1.0)
    kind: Literal["normal", "uniform"] = "normal"
    rate_hz: Annotated[int, OneOf((1000, 2000))] = 1000
    free: float = -1e30


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"share": 1.01}, "share 1.01, expected 0 to 1"),
        ({"share": math.nan}, "share nan, expected 0 to 1"),
        ({"rate": 0.0}, "rate 0.0, expected more than 0"),
        ({"part": 0.0}, "part 0.0, expected more than 0 to 1"),
        ({"count": 0}, "count 0, expected 1 to 10000000"),
        ({"span": (0.001, 1.0)}, "span [0.001, 1.0], expected 0.01 to 600"),
        ({"kind": "gauss"}, "kind 'gauss', expected one of: normal, uniform"),
        ({"rate_hz": 900}, "rate_hz 900, expected one of: 1000, 2000"),
    ],
)
def test_a_value_outside_its_type_is_told_as_what_was_expected(values: dict[str, Any], message: str) -> None:
    with pytest.raises(TrainingError) as refused:
        Values(**values)
    assert str(refused.value) == f"task mine: {message}"


def test_values_at_their_limits_are_taken() -> None:
    made = Values(share=1.0, rate=1e300, part=1.0, count=10_000_000, span=(0.01, 600.0), rate_hz=2000)
    assert not list(value_errors(made))
    check_limits("it", made, share=(1.0, 2.0))
    with pytest.raises(TrainingError, match=r"it: share 1\.0, expected 2 to 3"):
        check_limits("it", made, share=(2.0, 3.0))
