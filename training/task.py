"""What the pilot asks for during an episode. Pure and vectorised."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from toolchain.contract import RATE_FULL_STICK_DEG_S

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PulseTask:
    """Rest, one random command on all axes held, rest again (Koch 2019, chapter 5)."""

    idle_s: float = 0.5
    command_s: float = 2.0
    rest_s: float = 2.0
    sigma_deg_s: float = 100.0  # commands are N(0, sigma) a axis, held within full stick

    @property
    def duration_s(self) -> float:
        """Length of an episode [s]."""
        return self.idle_s + self.command_s + self.rest_s

    def draw(self, count: int, rng: np.random.Generator) -> Array:
        """Commands of `count` episodes [rad/s], (count, 3)."""
        command = rng.normal(0.0, self.sigma_deg_s, (count, 3))
        return np.deg2rad(np.clip(command, -RATE_FULL_STICK_DEG_S, RATE_FULL_STICK_DEG_S))

    def setpoint(self, command: Array, step: NDArray[np.intp], rate_hz: int) -> Array:
        """Setpoint [rad/s] (N, 3) of each episode at its control step, shape (N,)."""
        start, end = round(self.idle_s * rate_hz), round((self.idle_s + self.command_s) * rate_hz)
        held = (step >= start) & (step < end)
        return np.where(held[:, None], command, 0.0)
