"""Running means and spreads: of the observations, and of the returns that the critic learns."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Doubles = NDArray[np.float64]

VARIANCE_MIN = 1e-2  # of an observed value, in scaled units: one that hardly varies is not blown up
RETURN_MEMORY = 0.95  # decay of the returns' moments from a rollout to the next
RETURN_SPREAD_MIN = 1e-6


@dataclass(frozen=True, eq=False)
class ObservedMoments:
    """Mean and spread of all observations so far."""

    count: float
    mean: Doubles  # (n,)
    squares: Doubles  # (n,), sums of squared distances from the mean

    @staticmethod
    def none(width: int) -> ObservedMoments:
        """Before the first observation: values pass unchanged."""
        return ObservedMoments(0.0, np.zeros(width), np.zeros(width))

    def with_more(self, observations: NDArray[np.float32]) -> ObservedMoments:
        """With `observations` (N, n) too (Chan, Golub and LeVeque 1983)."""
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
    def factor(self) -> Doubles:
        """What brings a value's spread to 1, (n,)."""
        if self.count == 0.0:
            return np.ones_like(self.mean)
        found: Doubles = 1.0 / np.sqrt(np.maximum(self.squares / self.count, VARIANCE_MIN))
        return found


@dataclass(frozen=True)
class ReturnMoments:
    """Running mean and spread of the returns: values of the critic are normalized by them.

    Their weights fall from rollout to rollout: returns grow by orders of magnitude while an aircraft learns.
    """

    weight: float = 0.0
    mean: float = 0.0
    square: float = 0.0  # mean of the squares

    def with_more(self, returns: Doubles) -> ReturnMoments:
        """With those of one more rollout."""
        weight = RETURN_MEMORY * self.weight + 1.0 - RETURN_MEMORY
        share = (1.0 - RETURN_MEMORY) / weight
        return replace(
            self,
            weight=weight,
            mean=self.mean + share * (float(returns.mean()) - self.mean),
            square=self.square + share * (float(np.square(returns).mean()) - self.square),
        )

    @property
    def spread(self) -> float:
        """Standard deviation; 1 before the first rollout."""
        if self.weight == 0.0:
            return 1.0
        return math.sqrt(max(self.square - self.mean**2, 0.0)) + RETURN_SPREAD_MIN
