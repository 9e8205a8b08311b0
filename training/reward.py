"""What a control step is worth. Pure functions over N aircraft, each with a name and its source."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Outputs = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Transition:
    """One control step of N aircraft, as a reward sees it."""

    setpoint: Array  # (N, 3) [rad/s], asked for at the sample after the step
    error: Array  # (N, 3) [rad/s], setpoint - true rate at the sample after the step
    error_before: Array  # (N, 3) [rad/s], at the sample before it
    action: Outputs  # (N, M), the controller's outputs of this step, 0..1
    action_before: Outputs  # (N, M), of the step before; zeros on an episode's first
    excess: Outputs  # (N, M), by how much the network asked for less than 0 or more than 1, >= 0


class Reward(Protocol):
    """A reward; frozen data, with a name in `REWARDS`."""

    name: ClassVar[str]

    def __call__(self, step: Transition) -> NDArray[np.float32]:
        """Reward of the step, (N,)."""
        ...


@dataclass(frozen=True)
class TrackingReward:
    """Follow the command, with motors slow and calm.

    r = -error Σ|e| / 100 deg/s - output ȳ - change mean|Δy|, over axes and motors.
    The absolute error (not its square) keeps pulling when the error is small, which is what the
    figures of merit measure. Δy is of the sampled outputs, which exploration dominates: smoothness of
    the mean output is asked for in the policy's loss instead (see `training.smooth_ppo`), and `change`
    is there for those who train without it.
    """

    name: ClassVar[str] = "tracking"
    error: float = 1.0
    output: float = 0.6
    change: float = 0.0

    def __call__(self, step: Transition) -> NDArray[np.float32]:
        """See Reward."""
        tracking = np.abs(step.error).sum(axis=1) / np.deg2rad(100.0)
        change = np.abs(step.action - step.action_before).mean(axis=1)
        reward = -self.error * tracking - self.output * step.action.mean(axis=1) - self.change * change
        return np.asarray(reward, np.float32)


REWARDS: dict[str, type[Reward]] = {reward.name: reward for reward in (TrackingReward,)}
