"""Limits of the checkpoint that becomes policy.onnx; `training.checkpoints.selection` holds the rule."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

from neuroflight.training.tasks.limits import Limits, value_errors

Limit = Annotated[float, Limits(0.0, 1.0, above=True)]


@dataclass(frozen=True)
class SelectionLimits:
    """The limits that a checkpoint should keep on the monitor's episodes."""

    output: Limit = 0.12  # of the mean control output: what the dissertation's policy takes
    change: Limit = 0.012  # of the mean |change| of an output in 1 ms, as `tune-pid` keeps it
    fit: bool = False  # whether it must be fit to fly, as `neuroflight policy check` says

    def errors(self) -> Iterator[str]:
        """Yield errors of the limits, one line each."""
        yield from value_errors(self, "selection ")
