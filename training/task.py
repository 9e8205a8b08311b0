"""What the pilot asks for during an episode. Pure and vectorised."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from toolchain.contract import RATE_FULL_STICK_DEG_S

Array = NDArray[np.float64]


class Task(Protocol):
    """A command for each episode, drawn at its start, and the setpoint at each of its steps."""

    @property
    def duration_s(self) -> float:
        """Length of an episode [s]."""
        ...

    def draw(self, count: int, rng: np.random.Generator) -> Array:
        """Commands of `count` episodes [rad/s], (count, 3)."""
        ...

    def setpoint(self, command: Array, step: NDArray[np.intp], rate_hz: int) -> Array:
        """Setpoint [rad/s] (N, 3) of each episode at its control step, shape (N,)."""
        ...


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
        """See Task."""
        return _normal(self.sigma_deg_s, count, rng)

    def setpoint(self, command: Array, step: NDArray[np.intp], rate_hz: int) -> Array:
        """See Task."""
        start, end = round(self.idle_s * rate_hz), round((self.idle_s + self.command_s) * rate_hz)
        held = (step >= start) & (step < end)
        return np.where(held[:, None], command, 0.0)


@dataclass(frozen=True)
class EpisodicTask:
    """From rest, one random command on all axes held for the whole episode (Koch 2019, chapter 3)."""

    hold_s: float = 1.0
    limit_deg_s: float = 300.0  # commands are uniform within +-limit an axis

    @property
    def duration_s(self) -> float:
        """Length of an episode [s]."""
        return self.hold_s

    def draw(self, count: int, rng: np.random.Generator) -> Array:
        """See Task."""
        return np.deg2rad(rng.uniform(-self.limit_deg_s, self.limit_deg_s, (count, 3)))

    def setpoint(self, command: Array, step: NDArray[np.intp], rate_hz: int) -> Array:
        """See Task."""
        return np.where((step < round(self.hold_s * rate_hz))[:, None], command, 0.0)


@dataclass(frozen=True)
class EnvelopeTask:
    """From rest, one wide random command on all axes held (Koch 2019, chapter 5: the flight envelope)."""

    hold_s: float = 1.0
    sigma_deg_s: float = 300.0  # commands are N(0, sigma) an axis, held within full stick

    @property
    def duration_s(self) -> float:
        """Length of an episode [s]."""
        return self.hold_s

    def draw(self, count: int, rng: np.random.Generator) -> Array:
        """See Task."""
        return _normal(self.sigma_deg_s, count, rng)

    def setpoint(self, command: Array, step: NDArray[np.intp], rate_hz: int) -> Array:
        """See Task."""
        return np.where((step < round(self.hold_s * rate_hz))[:, None], command, 0.0)


TASKS: dict[str, Callable[[], Task]] = {
    "pulse": PulseTask,
    "episodic": EpisodicTask,
    "envelope": EnvelopeTask,
}


def _normal(sigma_deg_s: float, count: int, rng: np.random.Generator) -> Array:
    """Commands N(0, sigma) [rad/s], (count, 3), held within full stick."""
    command = rng.normal(0.0, sigma_deg_s, (count, 3))
    return np.deg2rad(np.clip(command, -RATE_FULL_STICK_DEG_S, RATE_FULL_STICK_DEG_S))
