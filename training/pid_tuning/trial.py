"""Trial flights of PID settings in the twin, and what they cost.

Cost of a candidate: its MAE [deg/s], averaged over axes and training pulses, plus 20 deg/s for each time
that the mean output or its mean change exceeds its limit (less a margin) by itself, plus 20 deg/s times the
mean excess over the 10 % band, none counted above 1, at the end of a second of large commands from rest.
The large commands are there for the integral: pulses alone need none in roll and pitch, but fast rotation
about two axes disturbs the third. Candidates of a generation fly side by side in one world, and every
generation flies the same commands and noise, so that costs differ by the settings alone. The gyro's constant
bias is set to 0: no controller can observe it, and the firmware calibrates it away.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sim.aircraft.model import Aircraft, PidSettings
from sim.analysis.metrics import effort, tracking
from sim.analysis.response import BAND, FLOOR_DEG_S
from sim.control.gyro_mean import samples_per_step
from sim.control.motors import raised, throttle_mix
from sim.control.pid import Pid, mixer
from toolchain.contract import Mix
from training.evaluation.evaluation import Flights, record
from training.pid_tuning.ultimate_gain import Steps
from training.tasks.task import EpisodicTask, PulseTask, Setpoints, Task

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

PENALTY = 20.0  # [deg/s] for a limit exceeded by itself
MARGIN = 0.97  # of each limit, kept by the search: unseen commands differ by a percent or two
HELD_MARGIN = 0.8  # likewise of the band at the end of a held command
HELD_END_S = 0.2  # last part of a held command, in which the error counts
HELD_SMALL = 1 / 6  # command of one axis, in parts of that of the others


@dataclass(frozen=True)
class Limits:
    """Limits of a candidate."""

    output: float  # mean output, fraction, before throttle mix and idle
    change: float  # mean |change| in 1 ms, fraction: of an output, or of a motor value
    idle: float  # motor fraction of armed motors at no thrust
    of_motors: bool = False  # whether `change` is of the motor values, after throttle mix and idle


@dataclass(frozen=True)
class Loop:
    """What surrounds the gains of every candidate."""

    control_rate_hz: int
    mix: Mix = Mix.ATTITUDE_FIRST
    gyro_mean: bool = False  # whether candidates see the mean of the gyro's samples of a control period
    throttle_max: float = 0.0  # the pilot's greatest thrust; that of a command is between 0 and this


@dataclass(frozen=True)
class Trial:
    """Settings and their figures on the training commands."""

    settings: PidSettings
    mae: float  # [deg/s], mean of the axes
    output: float
    change: float  # of what the limit is of
    held: float  # mean excess over the band at the end of large commands, 0..1
    cost: float  # [deg/s]


@dataclass(frozen=True, eq=False)
class Pulses:
    """The pulse task with these commands."""

    name: ClassVar[str] = "pulse"
    commands: Array  # (N, 3) [rad/s]
    pulse: PulseTask

    @property
    def duration_s(self) -> float:
        """See Task."""
        return self.pulse.duration_s

    def episodes(self, count: int, rng: np.random.Generator, rate_hz: int) -> Setpoints:
        """See Task."""
        return self.pulse.of(self.commands, rate_hz)


def training_commands(count: int, rng: np.random.Generator) -> Array:
    """Stratified commands of the pulse task [rad/s], (count, 3).

    Each axis has the median of each of `count` equally likely ranges once, in an order of its own.
    """
    normal = NormalDist(0.0, PulseTask().sigma_deg_s)
    middles = np.array([normal.inv_cdf((i + 0.5) / count) for i in range(count)])
    commands: Array = np.deg2rad(np.column_stack([rng.permutation(middles) for _ in range(3)]))
    return commands


def throttles(count: int, most: float, rng: np.random.Generator) -> Array32:
    """The pilot's thrust under each command, (count,): the middle of each of `count` equal parts of 0..most
    once, in any order."""
    return rng.permutation(most * (np.arange(count) + 0.5) / count).astype(np.float32)


def motor_values(output: Array32, throttle: Array32, idle: float, mix: Mix) -> Array32:
    """Motor fractions (E, T, M) of outputs (E, T, M), each episode under the pilot's thrust (E,)."""
    flat = output.reshape(-1, output.shape[-1])
    u = throttle_mix(flat, np.repeat(throttle, output.shape[1]), mix)
    return raised(u, idle).reshape(output.shape)


def held_commands() -> Array:
    """Commands of the episodic task's size, a small one on one axis, [rad/s], (12, 3)."""
    limit = np.deg2rad(EpisodicTask().limit_deg_s)
    signs = np.array([(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)])
    return np.concatenate([np.insert(limit * signs, axis, HELD_SMALL * limit, axis=1) for axis in range(3)])


@dataclass(frozen=True, eq=False)
class Trials:
    """The flights that every candidate of a search makes."""

    aircraft: Aircraft
    loop: Loop
    limits: Limits
    seed: int  # of the gyro's noise
    commands: Array  # (n, 3) [rad/s], of the pulses
    throttle: Array32  # (n,), 0..1

    def quick(self) -> Trials:
        """Flights that tell nearly the same in less time: at the control rate, the gyro as its mean would be.

        They lack the mean's delay, three eighths of a control period of four samples.
        """
        samples = samples_per_step(self.loop.gyro_mean, self.loop.control_rate_hz)
        x, y, z = (noise / math.sqrt(samples) for noise in self.aircraft.gyro.noise)
        quiet = replace(self.aircraft, gyro=replace(self.aircraft.gyro, noise=(x, y, z)))
        return replace(self, aircraft=quiet, loop=replace(self.loop, gyro_mean=False))

    def fly(self, candidates: Sequence[PidSettings]) -> list[Trial]:
        """Figures of each of the candidates. Large commands are flown at half of the greatest throttle."""
        large = held_commands()
        half = np.full(len(large), self.loop.throttle_max / 2, np.float32)
        pulsed = self._flown(candidates, self.commands, lambda rows: Pulses(rows, PulseTask()), self.throttle)
        held = self._flown(candidates, large, lambda rows: Steps(rows, EpisodicTask().hold_s), half)
        return [self._trial(*flown) for flown in zip(candidates, pulsed, held, strict=True)]

    def _flown(
        self,
        candidates: Sequence[PidSettings],
        commands: Array,
        task: Callable[[Array], Task],
        throttle: Array32,
    ) -> list[_Flown]:
        """The flights of each candidate; all fly `commands` (m, 3) under the pilot's thrust (m,)."""
        count, each = len(candidates), len(commands)
        crowd = [settings for settings in candidates for _ in commands]
        pid = Pid(mixer(self.aircraft), crowd, len(crowd), self.loop.control_rate_hz)
        idle = np.array([settings.idle for settings in crowd], np.float32)
        motors = _Motors(pid, np.tile(throttle, count), idle, self.loop.mix)
        flown = record(
            motors,
            self.aircraft,
            task(np.tile(commands, (count, 1))),
            episodes=len(crowd),
            seed=self.seed,
            control_rate_hz=self.loop.control_rate_hz,
            gyro_mean=self.loop.gyro_mean,
        )
        output = np.stack(motors.outputs, axis=1)
        rows = [slice(start, start + each) for start in range(0, len(crowd), each)]
        return [
            _Flown(Flights(flown.setpoint[r], flown.rate[r], output[r], flown.step_s), flown.output[r])
            for r in rows
        ]

    def _trial(self, settings: PidSettings, pulsed: _Flown, held: _Flown) -> Trial:
        flights, limits = pulsed.flights, self.limits
        mae = float(tracking(flights.setpoint, flights.rate, flights.step_s).mae.mean())
        outputs = effort(flights.output, flights.step_s)
        change = effort(pulsed.motors, flights.step_s).change if limits.of_motors else outputs.change
        excess = max(0.0, outputs.output / (MARGIN * limits.output) - 1.0)
        excess += max(0.0, change / (MARGIN * limits.change) - 1.0)
        beyond = missed(held.flights)
        return Trial(settings, mae, outputs.output, change, beyond, mae + PENALTY * (excess + beyond))


@dataclass(frozen=True, eq=False)
class _Flown:
    """Flights with the controllers' outputs, and the motor values after throttle mix and idle."""

    flights: Flights
    motors: Array32  # (E, T, M)


class _Motors:
    """PIDs, each with its throttle and idle, as one controller whose outputs are the motor values."""

    def __init__(self, pid: Pid, throttle: Array32, idle: Array32, mix: Mix) -> None:
        """throttle, idle: (N,), fractions."""
        self.outputs: list[Array32] = []  # (N, M) of each step, before throttle mix and idle
        self._pid, self._throttle, self._mix = pid, throttle, mix
        self._idle = idle[:, None]

    def reset(self) -> None:
        """See Controller."""
        self._pid.reset()
        self.outputs.clear()

    def step(self, setpoint: Array32, gyro: Array32, throttle: Array32) -> Array32:
        """See Controller; the throttle is this object's."""
        y = self._pid.step(setpoint, gyro, self._throttle)
        self.outputs.append(y)
        above = np.float32(1.0) - self._idle
        return self._idle + above * throttle_mix(y, self._throttle, self._mix)


def missed(held: Flights) -> float:
    """Mean excess over the band at the end of held commands; each excess counts at most 1."""
    end = round(HELD_END_S / held.step_s)
    error = np.rad2deg(np.abs(held.setpoint - held.rate)[:, -end:].max(axis=1))
    band = np.maximum(BAND * np.rad2deg(np.abs(held.setpoint[:, -1])), FLOOR_DEG_S)
    return float((error / (HELD_MARGIN * band) - 1.0).clip(0.0, 1.0).mean())
