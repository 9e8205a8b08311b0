"""Running mean and spread of the returns that the critic learns."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from neuroflight.sim.arrays import Array

RETURN_MEMORY = 0.95  # decay of the returns' moments from a rollout to the next
RETURN_SPREAD_MIN = 1e-6


@dataclass(frozen=True)
class ReturnMoments:
    """Running mean and spread of the returns: values of the critic are normalized by them.

    Their weights fall from rollout to rollout: returns grow by orders of magnitude while an aircraft learns.
    """

    weight: float = 0.0
    mean: float = 0.0
    square: float = 0.0  # mean of the squares

    def with_more(self, returns: Array) -> ReturnMoments:
        """Add the returns of one more rollout."""
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
