"""What the pilot asks for during an episode: the setpoints of all its control steps. Pure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from toolchain.contract import RATE_FULL_STICK_DEG_S

Array = NDArray[np.float64]
Setpoints = NDArray[np.float32]  # (count, T, 3) [rad/s]


class Task(Protocol):
    """A kind of episode; frozen data, with a name in `training.tasks.TASKS`."""

    name: ClassVar[str]

    @property
    def duration_s(self) -> float:
        """Length of an episode [s]."""
        ...

    def episodes(self, count: int, rng: np.random.Generator, rate_hz: int) -> Setpoints:
        """Setpoints [rad/s] of `count` new episodes, (count, round(duration_s * rate_hz), 3)."""
        ...


@dataclass(frozen=True)
class PulseTask:
    """Rest, one random command on all axes held, rest again (Koch 2019, chapter 5)."""

    name: ClassVar[str] = "pulse"
    idle_s: float = 0.5
    command_s: float = 2.0
    rest_s: float = 2.0
    sigma_deg_s: float = 100.0  # commands are N(0, sigma) an axis, held within full stick

    @property
    def duration_s(self) -> float:
        """Length of an episode [s]."""
        return self.idle_s + self.command_s + self.rest_s

    def episodes(self, count: int, rng: np.random.Generator, rate_hz: int) -> Setpoints:
        """See Task."""
        return self.of(normal_commands(self.sigma_deg_s, count, rng), rate_hz)

    def of(self, commands: Array, rate_hz: int) -> Setpoints:
        """Setpoints of the episodes with these commands (count, 3) [rad/s]."""
        start, end = round(self.idle_s * rate_hz), round((self.idle_s + self.command_s) * rate_hz)
        setpoints = np.zeros((len(commands), round(self.duration_s * rate_hz), 3), np.float32)
        setpoints[:, start:end] = commands[:, None]
        return setpoints


@dataclass(frozen=True)
class EpisodicTask:
    """From rest, one random command on all axes held for the whole episode (Koch 2019, chapter 3)."""

    name: ClassVar[str] = "episodic"
    hold_s: float = 1.0
    limit_deg_s: float = 300.0  # commands are uniform within +-limit an axis

    @property
    def duration_s(self) -> float:
        """Length of an episode [s]."""
        return self.hold_s

    def episodes(self, count: int, rng: np.random.Generator, rate_hz: int) -> Setpoints:
        """See Task."""
        commands = np.deg2rad(rng.uniform(-self.limit_deg_s, self.limit_deg_s, (count, 3)))
        return held(commands, self.hold_s, rate_hz)


@dataclass(frozen=True)
class EnvelopeTask:
    """From rest, one wide random command on all axes held (Koch 2019, chapter 5: the flight envelope)."""

    name: ClassVar[str] = "envelope"
    hold_s: float = 1.5
    sigma_deg_s: float = 300.0  # commands are N(0, sigma) an axis, held within full stick

    @property
    def duration_s(self) -> float:
        """Length of an episode [s]."""
        return self.hold_s

    def episodes(self, count: int, rng: np.random.Generator, rate_hz: int) -> Setpoints:
        """See Task."""
        return held(normal_commands(self.sigma_deg_s, count, rng), self.hold_s, rate_hz)


def held(commands: Array, seconds: float, rate_hz: int) -> Setpoints:
    """Setpoints of episodes that hold `commands` (count, 3) [rad/s] from their first step."""
    return np.repeat(commands[:, None].astype(np.float32), round(seconds * rate_hz), axis=1)


def normal_commands(sigma_deg_s: float, count: int, rng: np.random.Generator) -> Array:
    """Commands N(0, sigma) [rad/s], (count, 3), held within full stick."""
    command = rng.normal(0.0, sigma_deg_s, (count, 3))
    return np.deg2rad(np.clip(command, -RATE_FULL_STICK_DEG_S, RATE_FULL_STICK_DEG_S))
