"""Rewards of a control step: pure functions over N aircraft, each with a name and its source."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.arrays import Array, Array32
from neuroflight.training.tasks.limits import Checked, Limits, Share

Rewards = NDArray[np.float32]  # (N,)

Weight = Annotated[float, Limits(0.0, 1e12)]  # of a term
Scale = Annotated[float, Limits(1e-12, 1e12)]
Rate = Annotated[float, Limits(1e-3, 1e4)]  # [deg/s]


@dataclass(frozen=True, eq=False)
class Transition:
    """One control step of N aircraft: the input of a reward."""

    setpoint: Array  # (N, 3) [rad/s], at the sample after the step
    setpoint_before: Array  # (N, 3) [rad/s], at the sample that the action was computed from
    error: Array  # (N, 3) [rad/s], setpoint - true rate at the sample after the step
    error_before: Array  # (N, 3) [rad/s], at the sample before it
    unclipped: Array32  # (N, M), the network's outputs before they are clipped to 0..1
    action: Array32  # (N, M), the controller's outputs of this step, clipped
    action_before: Array32  # (N, M), of the step before; zeros on an episode's first


class Reward(Protocol):
    """A reward: frozen data with a name in `REWARDS`."""

    name: ClassVar[str]

    def __call__(self, step: Transition) -> Rewards:
        """Return the reward of the step, (N,)."""
        ...


@dataclass(frozen=True)
class TrackingReward(Checked):
    """Follow the command with low outputs that change little.

    r = -error Σ|e| / 100 deg/s - settle Σ min(|e| / 10 deg/s, 1) - output ȳ - change mean|Δy|, over axes
    and motors.
    The absolute error has the same slope when the error is small, unlike its square; the figures of merit
    are mean absolute errors. Δy is of the sampled outputs, which exploration dominates: smoothness of the
    mean output is a term of the policy's loss instead (see `training.learners.smooth_ppo`); `change` is for
    training without that term. `settle` counts the axes that have not reached their command: with large
    commands and slow aircraft, |e| alone hardly distinguishes a final error of 2 deg/s from one of 10.
    """

    name: ClassVar[str] = "tracking"
    error: Weight = 1.0
    settle: Weight = 0.0
    output: Weight = 0.6
    change: Weight = 0.0

    def __call__(self, step: Transition) -> Rewards:
        """See Reward."""
        error = np.abs(step.error)
        tracking = self.error * error.sum(axis=1) / np.deg2rad(100.0)
        if self.settle:
            tracking += self.settle * np.minimum(error / np.deg2rad(10.0), 1.0).sum(axis=1)
        change = np.abs(step.action - step.action_before).mean(axis=1)
        reward = -tracking - self.output * step.action.mean(axis=1) - self.change * change
        return np.asarray(reward, np.float32)


@dataclass(frozen=True)
class NormalizedReward(Checked):
    """The normalized error: r = -clip(Σ|e| / (3 Ω_max), 0, 1).

    Source: Koch 2019, chapter 3. Ω_max is the largest command of its task, ±5.24 rad/s.
    """

    name: ClassVar[str] = "dissertation-3"
    rate_max_deg_s: Rate = 300.0

    def __call__(self, step: Transition) -> Rewards:
        """See Reward."""
        error = np.abs(step.error).sum(axis=1) / (3.0 * np.deg2rad(self.rate_max_deg_s))
        return np.asarray(-np.minimum(error, 1.0), np.float32)


@dataclass(frozen=True)
class SparseReward(Checked):
    """Nothing while the error is small, else a penalty: r = 0 if Σ|e| < threshold, else -1.

    Source: Koch 2019, chapter 3, the footnote on rewards that did poorly. The threshold is not printed. Here
    it is a tenth of the largest command on each axis, the band of that chapter's success.
    """

    name: ClassVar[str] = "dissertation-3-sparse"
    threshold_deg_s: Rate = 90.0

    def __call__(self, step: Transition) -> Rewards:
        """See Reward."""
        error = np.abs(step.error).sum(axis=1)
        return np.where(error < np.deg2rad(self.threshold_deg_s), np.float32(0.0), np.float32(-1.0))


@dataclass(frozen=True)
class CalmReward(Checked):
    """Squared errors, low outputs and, once the command is reached, small changes of the outputs.

    r = -error Σe² + output (1 - ȳ) + change Σ_i max(0, change_max² - Δy_i²), the last term only while each
    |e| is inside the error band; e in deg/s, Δy in percent, ȳ a fraction.

    Source: Koch 2019, chapter 4: r_e + r_y + r_Δ with alpha = 300, beta = 0.5 and Δy_max = 100². The units
    of e and Δy and the band are not printed; deg/s and the band are those of chapter 5's published
    environment. Errors in rad/s are `error` = 3.046e-4, which is (π / 180)²; changes in thousandths are
    `change_max` = 10 and `change` = 50.
    `scale` multiplies the whole; 1 is as printed.
    """

    name: ClassVar[str] = "dissertation-4"
    error: Weight = 1.0
    output: Weight = 300.0
    change: Weight = 0.5
    change_max: Annotated[float, Limits(0.0, 100.0)] = 100.0  # [%]
    band_share: Share = 0.1  # of the command; see `in_band`
    band_floor_deg_s: Rate = 5.0
    scale: Scale = 1.0

    def __call__(self, step: Transition) -> Rewards:
        """See Reward."""
        change = 100.0 * (step.action - step.action_before).astype(np.float64)
        calm = np.maximum(0.0, self.change_max**2 - change**2).sum(axis=1)
        reward = (
            -self.error * np.square(np.rad2deg(step.error)).sum(axis=1)
            + self.output * (1.0 - step.action.mean(axis=1))
            + self.change * calm * in_band(step, self.band_share, self.band_floor_deg_s)
        )
        return np.asarray(self.scale * reward, np.float32)


@dataclass(frozen=True)
class ProgressReward(Checked):
    """Progress of the squared error, small changes, low outputs in the band, no motor beyond its range.

    r = (r_e - r_e before) - change max_i |Δu_i| + output (1 - max(ū, idle)) in the band
        - penalty Σ max(0, a - 1) - penalty if all u = 1 - penalty if more than two motors stand still
        while a rate is commanded; r_e = -Σe², e in deg/s, a the outputs before they are clipped to 0..1.

    Source: Koch 2019, chapter 5, alg:reward, as its text describes it: the listing sets r to the output's
    term instead of adding it, and counts motors that turn where the text counts those at zero. Taken from
    the author's published environment because they are not printed: alpha = beta = 1000, the band, the idle
    of 12 % below which lower outputs earn no more, and deg/s as the unit of e. There the first step of an
    episode has no progress; here it has.
    `scale` multiplies the whole; 1 is as published.
    """

    name: ClassVar[str] = "dissertation-5"
    output: Weight = 1000.0
    change: Weight = 1000.0
    penalty: Weight = 1e9
    idle: Share = 0.12
    band_share: Share = 0.1  # of the command; see `in_band`
    band_floor_deg_s: Rate = 5.0
    scale: Scale = 1.0

    def __call__(self, step: Transition) -> Rewards:
        """See Reward."""
        before, after = (
            np.square(np.rad2deg(error)).sum(axis=1) for error in (step.error_before, step.error)
        )
        low = 1.0 - np.maximum(step.action.mean(axis=1), self.idle)
        beyond = np.maximum(0.0, step.unclipped.astype(np.float64) - 1.0).sum(axis=1)
        full = (step.action == 1.0).all(axis=1)
        idle = ((step.action == 0.0).sum(axis=1) > 2) & step.setpoint_before.any(axis=1)
        reward = (
            before
            - after
            - self.change * np.abs(step.action - step.action_before).max(axis=1)
            + self.output * low * in_band(step, self.band_share, self.band_floor_deg_s)
            - self.penalty * (beyond + full + idle)
        )
        return np.asarray(self.scale * reward, np.float32)


REWARDS: dict[str, type[Reward]] = {
    reward.name: reward
    for reward in (TrackingReward, NormalizedReward, SparseReward, CalmReward, ProgressReward)
}


def in_band(step: Transition, share: float, floor_deg_s: float) -> NDArray[np.bool_]:
    """Return True if each axis' error is at most `share` of its command, or the floor, (N,)."""
    band = np.maximum(share * np.abs(step.setpoint), np.deg2rad(floor_deg_s))
    return np.asarray((np.abs(step.error) <= band).all(axis=1))
