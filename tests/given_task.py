"""A task whose setpoints a test has made."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from neuroflight.training.tasks.task import Setpoints


@dataclass(frozen=True, eq=False)
class Given:
    """Setpoints of 1 kHz, as they are."""

    name: ClassVar[str] = "given"
    setpoint: Setpoints

    @property
    def duration_s(self) -> float:
        """See Task."""
        return 1e-3 * float(self.setpoint.shape[1])

    def episodes(self, count: int, rng: np.random.Generator, rate_hz: int) -> Setpoints:
        """See Task."""
        return self.setpoint
