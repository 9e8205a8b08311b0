"""Figures of repeated runs: means with their 95 % confidence intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from neuroflight.sim.aircraft.model import RPM
from neuroflight.sim.analysis.confidence import mean_of
from neuroflight.sim.arrays import Array
from neuroflight.sim.identification.dyno.bench import Step, steps
from neuroflight.sim.identification.dyno.recording import Recording
from neuroflight.sim.identification.dyno.signal import JUMP, commanded, jumps

TOP = 0.01  # of the largest throttle: thrust is 0.25 % less over it, on average, than at its end


@dataclass(frozen=True)
class Figure:
    """A mean over repeats and half the width of its interval (Student's t); one repeat has no width."""

    mean: float
    margin: float


@dataclass(frozen=True)
class StepFigures:
    """The figures of steps to one level."""

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
    thrust_coefficient: Figure  # K_T = thrust / speed^2 of each repeat's top [N s^2/rad^2], as Koch has it
    torque_ratio_m: Figure  # K_Q = torque / thrust there


@dataclass(frozen=True)
class Repeats:
    """All repeats of a recording."""

    runs: int
    steps: tuple[StepFigures, ...]
    ramp_top: Peak | None  # None: no run is a ramp


def figure(values: Sequence[float] | Array) -> Figure:
    """Compute the mean of one value a repeat, at least one."""
    mean = mean_of(np.array(values, np.float64), np.ones(len(values), bool))
    return Figure(float(mean.value), float(mean.high - mean.value))


def step_figures(recordings: Sequence[Recording]) -> tuple[StepFigures, ...]:
    """Compute the figures of each level that is stepped to, rising."""
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
    """Compute speed, thrust and torque at the top of each recording; at least one."""

    def largest(name: str) -> Array:
        return np.array(
            [getattr(run, name)[run.throttle >= (1 - TOP) * run.throttle.max()].mean() for run in recordings]
        )

    speed, thrust, torque = largest("speed"), largest("thrust"), largest("torque")
    return Peak(
        count=len(recordings),
        rpm=figure(speed / RPM),
        thrust_n=figure(thrust),
        torque_n_m=figure(torque),
        thrust_coefficient=figure(_ratio(thrust, speed**2)),
        torque_ratio_m=figure(_ratio(torque, thrust)),
    )


def _ratio(values: Array, by: Array) -> Array:
    """Compute values / by, (R,); 0 for a sensor that showed nothing."""
    return values / np.where(by == 0.0, np.inf, by)


def repeats(recording: Recording) -> Repeats | None:
    """Return figures over the runs of a recording; None where there is one run only, or no torque.

    A run without a step is a ramp, unless its throttle stays below JUMP.
    """
    runs = runs_of(recording)
    if len(runs) < 2 or not recording.has_torque:
        return None
    ramps = [run for run in runs if not len(jumps(run)) and commanded(run).max() > JUMP]
    return Repeats(len(runs), step_figures(runs), peak(ramps) if ramps else None)


def runs_of(recording: Recording) -> list[Recording]:
    """Split a recording into its runs."""
    bounds = zip(recording.starts, [*recording.starts[1:], len(recording.time)], strict=True)
    return [
        Recording(
            *(
                getattr(recording, name)[first:end]
                for name in ("time", "throttle", "speed", "thrust", "torque")
            )
        )
        for first, end in bounds
    ]
