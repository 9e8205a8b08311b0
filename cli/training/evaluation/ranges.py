"""Shared by the commands of training: numbers that options may have."""

from __future__ import annotations


def check_ranges(*ranges: tuple[str, float | None, float, float]) -> None:
    """Raise TrainingError naming the first option outside its range, as NaN is; None is not checked."""
    from neuroflight.toolchain.errors import TrainingError

    for option, value, low, high in ranges:
        if value is not None and not low <= value <= high:
            raise TrainingError(f"{option} {value}, expected {low:g} to {high:g}")
