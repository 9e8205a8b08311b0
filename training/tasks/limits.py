"""Ranges of numbers in configurations, refused in one line."""

from __future__ import annotations

from toolchain.errors import TrainingError

Limits = tuple[float, float]


def check_limits(what: str, data: object, **limits: Limits) -> None:
    """Raise TrainingError naming the first attribute of `data` outside of its limits; NaN is in none.

    what: how the message calls `data`, such as "task pulse". A tuple's items all have the same limits.
    """
    for name, (low, high) in limits.items():
        value = getattr(data, name)
        for number in value if isinstance(value, tuple) else (value,):
            if not low <= number <= high:
                shown = list(value) if isinstance(value, tuple) else value
                raise TrainingError(f"{what}: {name} {shown}, expected {low:g} to {high:g}")
