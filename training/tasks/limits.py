"""Range checks of configuration values."""

from __future__ import annotations

from neuroflight.toolchain.errors import TrainingError

Limits = tuple[float, float]


def check_limits(what: str, data: object, **limits: Limits) -> None:
    """Raise TrainingError naming the first attribute of `data` outside its limits; NaN is outside all limits.

    what: the name of `data` in the message, such as "task pulse". The limits hold for each item of a tuple.
    """
    for name, (low, high) in limits.items():
        value = getattr(data, name)
        for number in value if isinstance(value, tuple) else (value,):
            if not low <= number <= high:
                shown = list(value) if isinstance(value, tuple) else value
                raise TrainingError(f"{what}: {name} {shown}, expected {low:g} to {high:g}")
