"""A recorded flight's commands as episodes: whole, or cut into equal pieces one after another."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.control import sticks
from neuroflight.sim.flight.scenario import Scenario
from neuroflight.toolchain.errors import TrainingError
from neuroflight.training.tasks.task import Setpoints


@dataclass(frozen=True, eq=False)
class RecordedPieces:
    """The commands that `fly` sends in a scenario, rounded as the sticks are; nothing is drawn or left out.

    Each piece begins with the aircraft at rest.
    """

    name: ClassVar[str] = "recorded"
    scenario: Scenario
    count: int  # pieces of equal length

    @staticmethod
    def cut(scenario: Scenario, piece_s: float | None) -> RecordedPieces:
        """Cut the flight into as many pieces of at least `piece_s` seconds as fit; None: one piece."""
        return RecordedPieces(
            scenario, 1 if piece_s is None else max(1, int(scenario.duration_s / piece_s * (1 + 1e-9)))
        )

    @property
    def duration_s(self) -> float:
        """Length of an episode [s]."""
        return self.scenario.duration_s / self.count

    def episodes(self, count: int, rng: np.random.Generator, rate_hz: int) -> Setpoints:
        """See Task; `count` must be that of the pieces."""
        setpoints: Setpoints = self._cut(sticks.setpoint(self._channels(rate_hz)), count)
        return setpoints

    def throttle(self, count: int, rate_hz: int) -> NDArray[np.float32]:
        """Return the recorded throttle of each control step, (count, T), 0..1."""
        thrust: NDArray[np.float32] = self._cut(sticks.throttle(self._channels(rate_hz)), count)
        return thrust

    def _channels(self, rate_hz: int) -> NDArray[np.uint16]:
        return self.scenario.timeline(rate_hz)[0]

    def _cut(self, rows: NDArray[np.float32], count: int) -> NDArray[np.float32]:
        """Cut (steps, ...) into (count, steps

        count, ...); up to count - 1 steps of the end are left out.
        """
        if count != self.count:
            raise ValueError(f"{count} episodes of a recording in {self.count} pieces")
        steps = len(rows) // count
        if not steps:
            raise TrainingError(
                f"{self.scenario.name}: {len(rows)} control steps in {count} pieces; expected longer pieces"
            )
        return rows[: steps * count].reshape(count, steps, *rows.shape[1:])
