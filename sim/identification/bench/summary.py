"""Figures of repeated runs: means with their 95 % confidence intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.aircraft.model import RPM
from sim.analysis.confidence import mean_of
from sim.identification.dyno.bench import Step, steps
from sim.identification.dyno.recording import Recording

Array = NDArray[np.float64]

TOP = 0.01  # of the largest throttle: thrust is 0.25 % less over it, on average, than at its end


@dataclass(frozen=True)
class Figure:
    """A mean over repeats and half the width of its interval (Student's t); one repeat has no width."""

    mean: float
    margin: float


@dataclass(frozen=True)
class StepFigures:
    """Steps to one level."""

    level: float  # throttle
    count: int
    rise_s: Figure  # from the command to 90 % of the settled speed
    rpm: Figure
    thrust_n: Figure
    torque_n_m: Figure


@dataclass(frozen=True)
class Peak:
    """Values at the top of the ramps, over the throttles within TOP of the largest: what Koch 2019 reports as
    the largest, without the noise that a single largest value has."""

    count: int
    rpm: Figure
    thrust_n: Figure
    torque_n_m: Figure


def figure(values: Sequence[float]) -> Figure:
    """Mean of one value a repeat, at least one."""
    mean = mean_of(np.array(values, np.float64), np.ones(len(values), bool))
    return Figure(float(mean.value), float(mean.high - mean.value))


def step_figures(recordings: Sequence[Recording]) -> tuple[StepFigures, ...]:
    """Figures of each level that is stepped to, rising."""
    found: dict[float, list[Step]] = {}
    for recording in recordings:
        for step in steps(recording):
            found.setdefault(round(step.level, 3), []).append(step)
    return tuple(
        StepFigures(
            level=level,
            count=len(group),
            rise_s=figure([step.rise for step in group]),
            rpm=figure([step.speed / RPM for step in group]),
            thrust_n=figure([step.thrust for step in group]),
            torque_n_m=figure([step.torque for step in group]),
        )
        for level, group in sorted(found.items())
    )


def peak(recordings: Sequence[Recording]) -> Peak:
    """Speed, thrust and torque at the top of each recording; at least one."""

    def largest(name: str) -> list[float]:
        return [
            float(np.mean(getattr(item, name)[item.throttle >= (1 - TOP) * item.throttle.max()]))
            for item in recordings
        ]

    return Peak(
        count=len(recordings),
        rpm=figure([value / RPM for value in largest("speed")]),
        thrust_n=figure(largest("thrust")),
        torque_n_m=figure(largest("torque")),
    )
