"""Metrics of a checkpoint's policy on the monitor's episodes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True)
class Spread:
    """Mean and range of a metric over episodes."""

    mean: float
    least: float
    greatest: float

    @staticmethod
    def of(values: ArrayLike) -> Spread:
        """Compute it from one value per episode."""
        v = np.asarray(values, np.float64)
        return Spread(float(v.mean()), float(v.min()), float(v.max()))


@dataclass(frozen=True)
class CheckpointMetrics:
    """Metrics of one checkpoint, each over the same few episodes."""

    steps: int  # control steps trained
    mae: Spread  # [deg/s], against the true rate, mean of the axes
    mse: Spread  # [(deg/s)^2], likewise
    output: Spread  # mean control output, fraction 0..1
    change: Spread  # mean |y_t - y_(t-1)| over motors and 1 ms steps
    reward: Spread  # of the run, mean per control step

    def document(self) -> dict[str, Any]:
        """Return the metrics as JSON data."""
        return asdict(self)

    @staticmethod
    def of(document: Mapping[str, Any]) -> CheckpointMetrics:
        """Read the metrics from JSON data. Raises KeyError, TypeError or ValueError if it has none."""
        spreads = {
            field.name: Spread(**{key: float(value) for key, value in document[field.name].items()})
            for field in fields(CheckpointMetrics)
            if field.name != "steps"
        }
        return CheckpointMetrics(steps=int(document["steps"]), **spreads)
