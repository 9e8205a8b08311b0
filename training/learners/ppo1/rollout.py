"""A rollout of several aircraft, and its advantages."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.arrays import Array, Array32


@dataclass(frozen=True, eq=False)
class Rollout:
    """T control steps of N aircraft."""

    observations: Array32  # (T + 1, N, n), scaled; where an episode ended, the next is its successor's first
    actions: Array32  # (T, N, M), drawn network outputs
    rewards: Array  # (T, N)
    ended: NDArray[np.bool_]  # (T, N), the episode's time is over
    last: list[tuple[int, int, Array32]]  # step, aircraft and last observation of each episode that ended

    @staticmethod
    def empty(steps: int, aircraft: int, inputs: int, motors: int) -> Rollout:
        """Allocate arrays to be filled."""
        return Rollout(
            np.empty((steps + 1, aircraft, inputs), np.float32),
            np.empty((steps, aircraft, motors), np.float32),
            np.empty((steps, aircraft)),
            np.empty((steps, aircraft), np.bool_),
            [],
        )

    def following(self, values: Array, estimate: Callable[[Array32], Array]) -> Array:
        """Compute the value of what follows each step, (T, N); values: of `observations`, (T + 1, N)."""
        following = values[1:].copy()
        if self.last:
            steps, whose, last = zip(*self.last, strict=True)
            following[list(steps), list(whose)] = estimate(np.stack(last))
        return following


def advantages(
    rewards: Array,
    values: Array,
    following: Array,
    ended: NDArray[np.bool_],
    discount: float,
    gae_lambda: float,
) -> Array:
    """Compute generalized advantage estimates (Schulman et al. 2016), all arrays (T, N)."""
    surprise = rewards + discount * following - values
    decay = np.where(ended, 0.0, discount * gae_lambda)
    found = np.empty_like(surprise)
    later = np.zeros(surprise.shape[1])
    for step in range(len(surprise) - 1, -1, -1):
        later = surprise[step] + decay[step] * later
        found[step] = later
    return found
