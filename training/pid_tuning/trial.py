"""Trials of a PID tuning: a candidate's flights, limits and figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.aircraft.model import Aircraft, PidSettings
from neuroflight.sim.analysis.response import BAND, FLOOR_DEG_S
from neuroflight.sim.arrays import Array
from neuroflight.toolchain.contract import Mix
from neuroflight.toolchain.policy.gyro_filters import GyroFilters
from neuroflight.training.evaluation.evaluation import Flights
from neuroflight.training.tasks.task import EpisodicTask, PulseTask

Settings = TypeVar("Settings")

RATE_HZ = 1000  # of the control loop
PENALTY = 20.0  # [deg/s] for a limit exceeded by itself
HELD_MARGIN = 0.8  # of the band at the end of a held command, kept by the search
HELD_END_S = 0.2  # last part of a held command, in which the error counts
HELD_SMALL = 1 / 6  # command of one axis, in parts of that of the others
MARGIN = 0.97  # of each limit, kept by the search: unseen commands differ by a percent or two


@dataclass(frozen=True)
class Limits:
    """The limits of a candidate."""

    output: float  # mean output, fraction, before throttle mix and idle; 1: none
    change: float  # mean |change| in 1 ms, fraction: of an output, or of a motor value
    idle: float  # motor fraction of armed motors at no thrust
    of_motors: bool = False  # whether `change` is of the motor values, after throttle mix and idle


@dataclass(frozen=True)
class Trial(Generic[Settings]):
    """Settings and their figures on the training commands."""

    settings: Settings
    mae: float  # [deg/s], mean of the axes
    change: float  # of what the limit is of
    cost: float  # [deg/s]
    output: float = 0.0  # where it is limited
    held: float = 0.0  # mean excess over the band at the end of large commands, 0..1, where it counts


@dataclass(frozen=True)
class Tuning(Generic[Settings]):
    """The course and result of a search."""

    start: Trial[Settings]  # what the search begins with
    trials: tuple[Trial[Settings], ...]  # of the search, in the order flown
    best: Trial[Settings]
    interrupted: bool


class Trials:
    """The flights that every candidate PID of a search makes, and the terms that it flies by."""

    aircraft: Aircraft
    limits: Limits
    mix: Mix  # of every candidate's outputs with the throttle
    gyro_filters: GyroFilters  # before every candidate
    idle: float | None  # of every candidate; None: it is searched, up to its limit

    def fly(self, candidates: Sequence[PidSettings]) -> list[Trial[PidSettings]]:
        """Return the figures of each candidate."""
        raise NotImplementedError


def streams(seed: int) -> tuple[np.random.Generator, np.random.Generator]:
    """Return the random numbers of a seed: those of trials' commands and noise, and those of the search."""
    draw, search = (np.random.default_rng(part) for part in np.random.SeedSequence([seed, 1]).spawn(2))
    return draw, search


def without_bias(aircraft: Aircraft) -> Aircraft:
    """Return the aircraft with a gyro without bias: firmware calibrates it away, no controller sees it."""
    return replace(aircraft, gyro=replace(aircraft.gyro, bias=0.0))


def training_commands(count: int, rng: np.random.Generator) -> Array:
    """Return stratified commands of the pulse task [rad/s], (count, 3).

    Each axis has the median of each of `count` equally likely ranges once, in an order of its own.
    """
    normal = NormalDist(0.0, PulseTask().sigma_deg_s)
    middles = np.array([normal.inv_cdf((i + 0.5) / count) for i in range(count)])
    commands: Array = np.deg2rad(np.column_stack([rng.permutation(middles) for _ in range(3)]))
    return commands


def throttles(count: int, most: float, rng: np.random.Generator) -> NDArray[np.float32]:
    """Return the pilot's thrust under each command, (count,), in any order.

    It is the middle of each of `count` equal parts of 0..most once.
    """
    return rng.permutation(most * (np.arange(count) + 0.5) / count).astype(np.float32)


def held_commands() -> Array:
    """Return commands of the episodic task's size, a small one on one axis, [rad/s], (12, 3)."""
    limit = np.deg2rad(EpisodicTask().limit_deg_s)
    signs = np.array([(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)])
    return np.concatenate([np.insert(limit * signs, axis, HELD_SMALL * limit, axis=1) for axis in range(3)])


def missed(held: Flights) -> float:
    """Return the mean excess over the band at the end of held commands; each excess counts at most 1."""
    end = round(HELD_END_S / held.step_s)
    error = np.rad2deg(np.abs(held.setpoint - held.rate)[:, -end:].max(axis=1))
    band = np.maximum(BAND * np.rad2deg(np.abs(held.setpoint[:, -1])), FLOOR_DEG_S)
    return float((error / (HELD_MARGIN * band) - 1.0).clip(0.0, 1.0).mean())
