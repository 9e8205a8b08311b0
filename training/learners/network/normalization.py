"""Normalization of observations: the running mean and spread of all so far."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from neuroflight.sim.arrays import Array

Numbers = NDArray[np.floating]

VARIANCE_MIN = 1e-2  # of an observed value, in scaled units: one that hardly varies is not blown up


@dataclass(frozen=True, eq=False)
class Normalization:
    """Normalization of observations: (x - mean) times factor, (n,) each."""

    mean: Numbers
    factor: Numbers


@dataclass(frozen=True, eq=False)
class ObservedMoments:
    """Mean and spread of all observations so far."""

    count: float
    mean: Array  # (n,)
    squares: Array  # (n,), sums of squared distances from the mean

    @staticmethod
    def none(width: int) -> ObservedMoments:
        """Return the state before the first observation: values pass unchanged."""
        return ObservedMoments(0.0, np.zeros(width), np.zeros(width))

    def with_more(self, observations: NDArray[np.float32]) -> ObservedMoments:
        """Add `observations` (N, n) (Chan, Golub and LeVeque 1983)."""
        count = float(len(observations))
        mean = observations.mean(axis=0, dtype=np.float64)
        squares = np.square(observations - mean).sum(axis=0)
        total, away = self.count + count, mean - self.mean
        return ObservedMoments(
            total,
            self.mean + away * (count / total),
            self.squares + squares + np.square(away) * (self.count * count / total),
        )

    @property
    def factor(self) -> Array:
        """Factor that brings a value's spread to 1, (n,)."""
        if self.count == 0.0:
            return np.ones_like(self.mean)
        found: Array = 1.0 / np.sqrt(np.maximum(self.squares / self.count, VARIANCE_MIN))
        return found

    @property
    def normalization(self) -> Normalization:
        """Normalization in the numbers of training."""
        return Normalization(self.mean.astype(np.float32), self.factor.astype(np.float32))

    def folded(self, parts: Sequence[NDArray[np.float32]]) -> list[NDArray[np.float32]]:
        """Convert layers that take normalized observations to layers that take raw ones."""
        found = [part.astype(np.float64) for part in parts]
        found[1] = found[1] - found[0] @ (self.mean * self.factor)
        found[0] = found[0] * self.factor
        return [part.astype(np.float32) for part in found]

    def state(self) -> dict[str, Any]:
        """Return plain containers, numbers and tensors."""
        return {
            "count": self.count,
            "mean": torch.from_numpy(self.mean.copy()),
            "squares": torch.from_numpy(self.squares.copy()),
        }

    @staticmethod
    def restored(state: dict[str, Any]) -> ObservedMoments:
        """Restore a `state`."""
        mean, squares = (state[name].numpy().copy() for name in ("mean", "squares"))
        return ObservedMoments(state["count"], mean, squares)
