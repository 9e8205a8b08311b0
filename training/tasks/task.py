"""Tasks: the setpoints that the pilot commands in the control steps of an episode. Pure functions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.arrays import Array
from neuroflight.toolchain.contract import RATE_FULL_STICK_DEG_S
from neuroflight.toolchain.errors import TrainingError
from neuroflight.training.tasks.limits import Checked, Limits

Setpoints = NDArray[np.float32]  # (count, T, 3) [rad/s]
Distribution = Literal["normal", "uniform"]

FULL_STICK_DEG_S = float(RATE_FULL_STICK_DEG_S)
LENGTH_MAX_S = 600.0  # [s] of each part of an episode
HOLD_MIN_S = 0.01  # [s], of commands that change at random; no aircraft follows shorter ones
Rate = Annotated[float, Limits(0.0, FULL_STICK_DEG_S)]  # [deg/s]
Length = Annotated[float, Limits(0.0, LENGTH_MAX_S)]  # [s]
Holds = Annotated[tuple[float, float], Limits(HOLD_MIN_S, LENGTH_MAX_S)]  # [s], least and greatest


class Task(Protocol):
    """A kind of episode: frozen data with a name in `training.tasks.registry.TASKS`."""

    name: ClassVar[str]

    @property
    def duration_s(self) -> float:
        """Length of an episode [s]."""
        ...

    def episodes(self, count: int, rng: np.random.Generator, rate_hz: int) -> Setpoints:
        """Draw setpoints [rad/s] of `count` new episodes, (count, round(duration_s * rate_hz), 3)."""
        ...


@dataclass(frozen=True)
class RandomCommands(Checked):
    """The distribution of the commands of the tasks below, each axis by itself."""

    distribution: Distribution = "normal"
    sigma_deg_s: Rate = 100.0  # of the normal
    limit_deg_s: Rate = FULL_STICK_DEG_S  # the uniform is within +-limit, the normal is clipped to it

    def commands(self, count: int, rng: np.random.Generator) -> Array:
        """Draw random commands [rad/s], (count, 3)."""
        if self.distribution == "normal":
            return normal_commands(self.sigma_deg_s, count, rng, self.limit_deg_s)
        return np.deg2rad(rng.uniform(-self.limit_deg_s, self.limit_deg_s, (count, 3)))


@dataclass(frozen=True)
class PulseTask(RandomCommands):
    """Rest, one random command on all axes held, rest again (Koch 2019, chapter 5)."""

    name: ClassVar[str] = "pulse"
    idle_s: Length = 0.5
    command_s: Length = 2.0
    rest_s: Length = 2.0

    @property
    def duration_s(self) -> float:
        """Length of an episode [s]."""
        return self.idle_s + self.command_s + self.rest_s

    def episodes(self, count: int, rng: np.random.Generator, rate_hz: int) -> Setpoints:
        """See Task."""
        return self.of(self.commands(count, rng), rate_hz)

    def of(self, commands: Array, rate_hz: int) -> Setpoints:
        """Return setpoints of the episodes with these commands (count, 3) [rad/s]."""
        start, end = round(self.idle_s * rate_hz), round((self.idle_s + self.command_s) * rate_hz)
        setpoints = np.zeros((len(commands), round(self.duration_s * rate_hz), 3), np.float32)
        setpoints[:, start:end] = commands[:, None]
        return setpoints


@dataclass(frozen=True)
class EpisodicTask(RandomCommands):
    """One random command on all axes from rest, held for the whole episode (Koch 2019, chapter 3)."""

    name: ClassVar[str] = "episodic"
    distribution: Distribution = "uniform"
    limit_deg_s: Rate = 300.0
    hold_s: Length = 1.0

    @property
    def duration_s(self) -> float:
        """Length of an episode [s]."""
        return self.hold_s

    def episodes(self, count: int, rng: np.random.Generator, rate_hz: int) -> Setpoints:
        """See Task."""
        return self.of(self.commands(count, rng), rate_hz)

    def of(self, commands: Array, rate_hz: int) -> Setpoints:
        """Return setpoints of the episodes with these commands (count, 3) [rad/s]."""
        return held(commands, self.hold_s, rate_hz)


@dataclass(frozen=True)
class EnvelopeTask(EpisodicTask):
    """One wide random command on all axes from rest, held (Koch 2019, chapter 5: the flight envelope)."""

    name: ClassVar[str] = "envelope"
    distribution: Distribution = "normal"
    sigma_deg_s: Rate = 300.0
    limit_deg_s: Rate = FULL_STICK_DEG_S
    hold_s: Length = 1.5


@dataclass(frozen=True)
class ContinuousTask(RandomCommands):
    """Random commands on all axes one after the other, each for a random time, with rest between.

    Koch 2019, chapter 4, whose episodes last 30 s; it prints neither the range of the commands nor their
    times. Times of 0.1 to 1 s are those of chapter 3's continuous evaluation (60 s, figure `fig:ppo1`) and of
    the author's published environment, which has ±360 deg/s. Two things differ here: an episode is 10 s, as
    its statistics do not depend on its length but its memory does, and it begins with rest, as a flight does.
    """

    name: ClassVar[str] = "continuous"
    distribution: Distribution = "uniform"
    limit_deg_s: Rate = 360.0
    length_s: Length = 10.0
    command_s: Holds = (0.1, 1.0)  # least and greatest length of a command, drawn uniformly
    rest_s: Holds = (0.1, 1.0)  # likewise of a rest

    def __post_init__(self) -> None:
        """Reject invalid values."""
        super().__post_init__()
        for name in ("command_s", "rest_s"):
            least, greatest = getattr(self, name)
            if least > greatest:
                raise TrainingError(
                    f"task {self.name}: {name} {[least, greatest]}, expected [least, greatest]"
                )

    @property
    def duration_s(self) -> float:
        """Length of an episode [s]."""
        return self.length_s

    def episodes(self, count: int, rng: np.random.Generator, rate_hz: int) -> Setpoints:
        """See Task."""
        steps = np.arange(round(self.length_s * rate_hz))
        setpoints = np.empty((count, len(steps), 3), np.float32)
        pairs = 1 + int(self.length_s / (self.rest_s[0] + self.command_s[0]))  # enough to the end
        commands = np.zeros((2 * pairs + 1, 3))  # rest and command in turn
        for episode in range(count):
            rests, holds = rng.uniform(*self.rest_s, pairs), rng.uniform(*self.command_s, pairs)
            changes = np.rint(np.cumsum(np.column_stack([rests, holds]).ravel()) * rate_hz)
            commands[1::2] = self.commands(pairs, rng)
            setpoints[episode] = commands[np.searchsorted(changes, steps, side="right")]
        return setpoints


@dataclass(frozen=True, eq=False)
class GivenCommands:
    """A task whose commands are given, one for each episode."""

    name: ClassVar[str] = "given"
    task: PulseTask | EpisodicTask  # when a command begins, and how long it holds
    given: Array  # (count, 3) [rad/s]

    @property
    def duration_s(self) -> float:
        """Length of an episode [s]."""
        return self.task.duration_s

    def episodes(self, count: int, rng: np.random.Generator, rate_hz: int) -> Setpoints:
        """See Task; nothing is drawn from `rng`."""
        return self.task.of(self.given, rate_hz)


def held(commands: Array, seconds: float, rate_hz: int) -> Setpoints:
    """Return setpoints of episodes that hold `commands` (count, 3) [rad/s] from the first step on."""
    return np.repeat(commands[:, None].astype(np.float32), round(seconds * rate_hz), axis=1)


def normal_commands(
    sigma_deg_s: float, count: int, rng: np.random.Generator, limit_deg_s: float = FULL_STICK_DEG_S
) -> Array:
    """Draw commands N(0, sigma) [rad/s], (count, 3), clipped to the limit."""
    return np.deg2rad(np.clip(rng.normal(0.0, sigma_deg_s, (count, 3)), -limit_deg_s, limit_deg_s))
