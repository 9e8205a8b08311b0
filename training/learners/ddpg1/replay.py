"""The replay buffer: a row of numbers for each control step, the newest in place of the oldest."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from neuroflight.sim.arrays import Array32


def row_width(inputs: int, motors: int) -> int:
    """Return the width of a row of `Replay`."""
    return 2 * inputs + motors + 1


class Replay:
    """Control steps as rows: observation (n), action (M), reward, next observation (n).

    No row says that an episode ended: episodes end by time alone, and then too something follows.
    """

    def __init__(self, size: int, inputs: int, motors: int) -> None:
        self.rows: Array32 = np.zeros((size, row_width(inputs, motors)), np.float32)
        self.filled = self._next = 0

    def add(self, observations: Array32, actions: Array32, rewards: Array32, following: Array32) -> None:
        """Add steps of N aircraft: (N, n), (N, M), (N,), (N, n)."""
        size, count = len(self.rows), len(rewards)
        where = np.arange(self._next, self._next + count) % size
        self.rows[where] = np.concatenate([observations, actions, rewards[:, None], following], axis=1)
        self._next = (self._next + count) % size
        self.filled = min(self.filled + count, size)

    def draw(self, rng: np.random.Generator, *shape: int) -> NDArray[np.int32]:
        """Draw indices of filled rows, each as likely."""
        return rng.integers(self.filled, size=shape, dtype=np.int32)

    def state(self) -> dict[str, Any]:
        """Return plain numbers and a tensor."""
        return {"rows": torch.from_numpy(self.rows[: self.filled].copy()), "next": self._next}

    def restore(self, state: dict[str, Any]) -> None:
        """Take over a `state`."""
        rows = state["rows"].numpy()
        self.filled, self._next = len(rows), state["next"]
        self.rows[: self.filled] = rows
