"""The random-steps task: commands and rest in turn, each held for a random time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray

from neuroflight.training.tasks.limits import Checked, Limits, Share, check_limits
from neuroflight.training.tasks.task import (
    FULL_STICK_DEG_S,
    HOLD_MIN_S,
    LENGTH_MAX_S,
    Length,
    Rate,
    Setpoints,
)

StepArray = NDArray[np.float64]  # (count, T)
Hold = Annotated[float, Limits(HOLD_MIN_S, LENGTH_MAX_S)]  # [s]
Weight = Annotated[float, Limits(0.0, 100.0)]


@dataclass(frozen=True, eq=False)
class StepWeights:
    """Weight of each control step in the means of a batch."""

    error: StepArray  # in the mean absolute error
    square: StepArray  # in the mean squared error
    effort: StepArray  # in the mean output and change

    @staticmethod
    def equal(count: int, steps: int) -> StepWeights:
        """Return the same weight for every step of `count` episodes."""
        one = np.ones((count, steps))
        return StepWeights(one, one, one)


@dataclass(frozen=True)
class RandomStepsTask(Checked):
    """Rest, a random command on all axes, rest again, and so on; each holds for a random time.

    In the pulse task a command comes at a known time, and a policy with memory learns to speed its rotors up
    before it, which is useless in flight. Here the time to the next change is exponentially distributed, so
    the time already passed does not predict it.

    `batch` also weights the control steps: transients after changes weigh as little in a short episode with
    many changes as in a pulse of 4.5 s with its two changes. In wide episodes held commands count, their
    effort too, or motors learn to swing in fast turns; of the way to them, which the motors' limits decide
    too, the error counts as much as `wide_transient` says, and effort not at all.
    """

    name: ClassVar[str] = "random-steps"
    length_s: Hold = 0.7
    hold_least_s: Hold = 0.1
    hold_mean_s: Hold = 0.35
    sigma_deg_s: Rate = 100.0  # commands are N(0, sigma) an axis, held within full stick
    wide_share: Share = 0.0  # of the episodes, in which commands are `wide_factor` times as large
    wide_factor: Annotated[float, Limits(1.0, 100.0)] = 3.0
    wide_weight: Weight = 0.5  # weight of a control step that holds such a command
    wide_transient: Weight = 0.0  # and of one on the way to it, in the mean absolute error
    start_s: Length = 0.06  # until the rotors turn; has no weight
    transient_s: Length = 0.15  # after each change
    transient_share: Share = 0.0667  # of the whole weight that all transients have together

    def __post_init__(self) -> None:
        """Reject invalid values."""
        super().__post_init__()
        least = (self.hold_least_s, LENGTH_MAX_S)
        check_limits(f"task {self.name}", self, hold_mean_s=least, start_s=(0.0, self.length_s))

    @property
    def duration_s(self) -> float:
        """Length of an episode [s]."""
        return self.length_s

    def episodes(self, count: int, rng: np.random.Generator, rate_hz: int) -> Setpoints:
        """See Task."""
        return self._steps(count, rng, rate_hz, exact=False)[0]

    def batch(self, count: int, rng: np.random.Generator, rate_hz: int) -> tuple[Setpoints, StepWeights]:
        """Draw setpoints as `episodes`, and the weight of each control step.

        The commands are scaled so that their deviation is sigma exactly: errors of batches vary less.
        """
        setpoints, wide = self._steps(count, rng, rate_hz, exact=True)
        steps = setpoints.shape[1]
        changed = np.zeros((count, steps), bool)
        changed[:, 1:] = (np.diff(setpoints, axis=1) != 0.0).any(axis=2)
        now = np.arange(steps)
        since = now - np.maximum.accumulate(np.where(changed, now, -steps), axis=1)
        counted = now >= round(self.start_s * rate_hz)
        transient = (since < round(self.transient_s * rate_hz)) & counted
        held = ~transient & counted
        counts = np.zeros((count, steps))
        for part, share in ((transient, self.transient_share), (held, 1.0 - self.transient_share)):
            counts[part] = share * count * steps / max(1, part.sum())
        usual = ~wide[:, None]
        of_wide = np.where(held, self.wide_weight, self.wide_transient)
        error = counts * np.where(usual, 1.0, of_wide)
        effort = counts * np.where(usual, 1.0, held * self.wide_weight)
        return setpoints, StepWeights(error, usual * counts, effort)

    def _steps(
        self, count: int, rng: np.random.Generator, rate_hz: int, *, exact: bool
    ) -> tuple[Setpoints, NDArray[np.bool_]]:
        """Draw setpoints; return them and True for wide episodes, (count,)."""
        steps = round(self.length_s * rate_hz)
        holds = self.hold_least_s + rng.exponential(
            self.hold_mean_s - self.hold_least_s, (count, 1 + int(self.length_s / self.hold_least_s))
        )
        # The first change may come at once: an episode begins at a random time within a hold.
        at = np.cumsum(holds, axis=1) - rng.uniform(0.0, self.hold_least_s, (count, 1))
        changes = np.zeros((count, steps + 1), np.intp)
        rows = np.repeat(np.arange(count), at.shape[1])
        np.add.at(changes, (rows, np.minimum(np.rint(at * rate_hz).astype(np.intp), steps).ravel()), 1)
        nth = np.cumsum(changes[:, :steps], axis=1)
        commands = rng.standard_normal((count, at.shape[1] + 1, 3))
        used = np.arange(commands.shape[1]) % 2 == 1  # the others are rest
        commands[:, ~used] = 0.0
        if exact:
            flown = commands[(np.arange(commands.shape[1]) <= nth[:, -1:]) & used]
            commands /= np.sqrt(np.square(flown).mean(axis=0)) if len(flown) else 1.0
        wide = rng.random(count) < self.wide_share
        sigma = self.sigma_deg_s * np.where(wide, self.wide_factor, 1.0)
        commands = np.clip(sigma[:, None, None] * commands, -FULL_STICK_DEG_S, FULL_STICK_DEG_S)
        setpoints = np.deg2rad(commands)[np.arange(count)[:, None], nth]
        return setpoints.astype(np.float32), wide
