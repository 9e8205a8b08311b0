"""A task in the steps of a pilot's sticks: commands rounded to a receiver's channels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from neuroflight.sim.control import sticks
from neuroflight.training.tasks.task import Setpoints, Task


@dataclass(frozen=True)
class OnSticks:
    """The commands of a task, rounded as every firmware's are: to 2 deg/s."""

    name: ClassVar[str] = "sticks"
    task: Task

    @property
    def duration_s(self) -> float:
        """Length of an episode [s]."""
        return self.task.duration_s

    def episodes(self, count: int, rng: np.random.Generator, rate_hz: int) -> Setpoints:
        """See Task."""
        # Rounded: full stick, as radians in float32 and back, would lie just beyond it.
        wanted = np.rad2deg(self.task.episodes(count, rng, rate_hz).astype(np.float64)).round(3)
        said: Setpoints = np.empty(wanted.shape, np.float32)
        for episode in range(count):
            said[episode] = sticks.setpoint(sticks.channels(wanted[episode], 0.0, armed=True))
        return said
