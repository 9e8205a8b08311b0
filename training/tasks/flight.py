"""Flights of a minute, nothing reset in them: pulses one after another, or a pilot's; then a hover."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import numpy as np

from neuroflight.sim.analysis.holding import DRIFT_S, FIFTHS
from neuroflight.sim.flight.freestyle import FLIGHT_S, FRAME_S, calm_strokes, stick_strokes
from neuroflight.toolchain.errors import TrainingError
from neuroflight.training.tasks.limits import Checked, Limits
from neuroflight.training.tasks.sticks import OnSticks
from neuroflight.training.tasks.task import (
    FULL_STICK_DEG_S,
    LENGTH_MAX_S,
    Length,
    PulseTask,
    RandomCommands,
    Rate,
    Setpoints,
    Task,
)

PULSES_MAX = 1000
LENGTH_MIN_S = 1.0  # of a pilot's flight
HOVER_THROTTLE = 0.3  # the default: about a hover of the shipped aircraft
Hover = Annotated[float, Limits(DRIFT_S, LENGTH_MAX_S)]  # [s]: long enough to tell the drift


@dataclass(frozen=True)
class Course:
    """The division of a flight's time."""

    commands: int  # equal parts of the time before the hover
    hover_s: float  # centred sticks at its end


@dataclass(frozen=True)
class FlightTask(RandomCommands):
    """Ten pulses as those of the pulse task in one flight, and then a hover.

    The commands of flight k are those of the pulse task's episodes 10 k to 10 k + 9 with the same seed.
    """

    name: ClassVar[str] = "flight"
    pulses: Annotated[int, Limits(1, PULSES_MAX)] = 10
    idle_s: Length = 0.5  # of each pulse, before its command
    command_s: Length = 2.0
    rest_s: Length = 2.0
    hover_s: Hover = 15.0

    @property
    def duration_s(self) -> float:
        """Length of a flight [s]."""
        return self.pulses * self._pulse.duration_s + self.hover_s

    @property
    def course(self) -> Course:
        """Division of its time."""
        return Course(self.pulses, self.hover_s)

    def of_length(self, length_s: float) -> FlightTask:
        """Return the task for a flight of that length: as many pulses as fit, and the rest as hover."""
        pulses = int((length_s - self.hover_s) / self._pulse.duration_s * (1 + 1e-9))
        return replace(self, pulses=pulses, hover_s=length_s - pulses * self._pulse.duration_s)

    def of_commands(self, count: int) -> tuple[FlightTask, int]:
        """Return the task for that many commands, and its flights; one left over is shorter."""
        task = replace(self, pulses=min(self.pulses, count))
        return task, -(-count // task.pulses)

    def episodes(self, count: int, rng: np.random.Generator, rate_hz: int) -> Setpoints:
        """See Task."""
        pulses = self._pulse.of(self.commands(count * self.pulses, rng), rate_hz)
        setpoints = np.zeros((count, round(self.duration_s * rate_hz), 3), np.float32)
        setpoints[:, : self.pulses * pulses.shape[1]] = pulses.reshape(count, -1, 3)
        return setpoints

    @property
    def _pulse(self) -> PulseTask:
        return PulseTask(idle_s=self.idle_s, command_s=self.command_s, rest_s=self.rest_s)


@dataclass(frozen=True)
class PilotTask(Checked):
    """The sticks of a pilot's freestyle minute, of another pilot each, and then a hover.

    They move as a hand does and hardly rest: see sim.flight.freestyle. With `sigma_deg_s` he flies no
    aerobatics: his commands are normal, of that standard deviation, for `length_s`. The throttle is the
    evaluation's.
    """

    name: ClassVar[str] = "pilot"
    # Before the hover; a freestyle has this one.
    length_s: Annotated[float, Limits(LENGTH_MIN_S, LENGTH_MAX_S)] = FLIGHT_S
    sigma_deg_s: Rate = 0.0  # 0: a freestyle
    hover_s: Hover = 15.0

    def __post_init__(self) -> None:
        """Reject invalid values."""
        super().__post_init__()
        if self.length_s != FLIGHT_S and not self.sigma_deg_s:
            raise TrainingError(
                f"task {self.name}: length_s {self.length_s:g}, expected {FLIGHT_S:g}: a freestyle is a "
                f"minute; a calm flight, with sigma_deg_s, has any length"
            )

    @property
    def duration_s(self) -> float:
        """Length of a flight [s]."""
        return self.length_s + self.hover_s

    @property
    def course(self) -> Course:
        """Division of its time: errors are told by fifths of the minute."""
        return Course(FIFTHS, self.hover_s)

    def episodes(self, count: int, rng: np.random.Generator, rate_hz: int) -> Setpoints:
        """See Task."""
        setpoints = np.zeros((count, round(self.duration_s * rate_hz), 3), np.float32)
        frames = (np.arange(round(self.length_s * rate_hz)) / (FRAME_S * rate_hz) + 1e-9).astype(np.intp)
        for number, seed in enumerate(rng.integers(2**31, size=count).tolist()):
            if self.sigma_deg_s:
                rates = calm_strokes(seed, self.length_s + FRAME_S, self.sigma_deg_s)
            else:
                rates = stick_strokes(seed)[0]
            rates = np.clip(rates, -FULL_STICK_DEG_S, FULL_STICK_DEG_S)
            setpoints[number, : len(frames)] = np.deg2rad(rates)[frames]
        return setpoints


def course_of(task: Task) -> Course | None:
    """Return the division of the task's flights; None if its episodes are no such flights."""
    inner = task.task if isinstance(task, OnSticks) else task
    return inner.course if isinstance(inner, (FlightTask, PilotTask)) else None
