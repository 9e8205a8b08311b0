"""One named command instead of random ones, in an episode of another task."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from neuroflight.training.tasks.task import EpisodicTask, PulseTask, Setpoints


@dataclass(frozen=True)
class NamedCommand:
    """A task with the same command in every episode; episodes differ in the noise alone."""

    name: ClassVar[str] = "command"
    task: PulseTask | EpisodicTask  # when the command begins, and how long it holds
    command_deg_s: tuple[float, float, float]  # roll, pitch, yaw

    @property
    def duration_s(self) -> float:
        """Length of an episode [s]."""
        return self.task.duration_s

    def episodes(self, count: int, rng: np.random.Generator, rate_hz: int) -> Setpoints:
        """See Task; nothing is drawn from `rng`."""
        return self.task.of(np.tile(np.deg2rad(self.command_deg_s), (count, 1)), rate_hz)
