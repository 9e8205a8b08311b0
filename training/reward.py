"""What a control step is worth. Pure functions over N aircraft."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class TrackingReward:
    """Follow the command, with motors slow and calm.

    r = -error Σ|e| / 100 deg/s - output ȳ - change mean|Δy|, over axes and motors.
    The absolute error (not its square) keeps pulling when the error is small, which is what the
    figures of merit measure. Δy is of the sampled outputs, which exploration dominates: smoothness of
    the mean output is asked for in the policy's loss instead (see `training.smooth_ppo`), and `change`
    is there for those who train without it.
    """

    error: float = 1.0
    output: float = 0.6
    change: float = 0.0

    def __call__(
        self, rate_error: NDArray[np.floating], action: NDArray[np.floating], before: NDArray[np.floating]
    ) -> NDArray[np.float32]:
        """Reward (N,) of a step; rate_error (N, 3) [rad/s] true; action, before (N, M) in 0..1."""
        tracking = np.abs(rate_error).sum(axis=1) / np.deg2rad(100.0)
        change = np.abs(action - before).mean(axis=1)
        reward = -self.error * tracking - self.output * action.mean(axis=1) - self.change * change
        return np.asarray(reward, np.float32)
