"""PID tuning in the twin: Ziegler and Nichols' gains, then a local search on a stated cost.

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

from sim.aircraft.mass import Vector
from sim.aircraft.model import Aircraft, PidSettings
from sim.analysis.metrics import effort, tracking
from sim.analysis.response import BAND, FLOOR_DEG_S
from sim.control.pid import Pid, mixer
from sim.physics.rotor import target_speed, thrust_and_torque
from toolchain.contract import GRAVITY
from training.evaluation.evaluation import Flights, record
from training.pid_tuning.cma_es import CmaEs
from training.pid_tuning.ultimate_gain import RULES, Steps, UltimateGain, ultimate_gains
from training.tasks.task import EpisodicTask, PulseTask, Setpoints, Task

Array = NDArray[np.float64]

POPULATION = 12  # candidates of a generation; the usual number for 11 settings
PENALTY = 20.0  # [deg/s] for a limit exceeded by itself
MARGIN = 0.97  # of each limit, kept by the search: unseen commands differ by a percent or two
HELD_MARGIN = 0.8  # likewise of the band at the end of a held command
HELD_END_S = 0.2  # last part of a held command, in which the error counts
HELD_SMALL = 1 / 6  # command of one axis, in parts of that of the others
IDLE_START = 0.1
IDLE_WEIGHT_MAX = 0.75  # thrust of all idling rotors in parts of the weight; more would hardly let it sink
IDLE_MIN, IDLE_MAX = 1e-3, 0.5  # of the search; the least has no visible effect
CUTOFF_START_HZ = 30.0
CUTOFF_MIN_HZ = 15.0  # with less, K_D acts on the rate rather than on its slope
CUTOFF_NYQUIST_MAX = 0.9  # of half the control rate
NOTHING = (0.0, 1e-2, 1e-4)  # K_P, K_I, K_D below which a gain has no visible effect and is set to 0
DIGITS = 4  # significant digits of the settings
# Factors of a rule's gains, and a further one of its K_I, that the search may start with: K_u is measured
# with an ideal gyro, and rate control needs little integral, because a moment integrates to a rate.
STARTS = ((1.0, 1.0), (1.0, 0.01), (0.3, 0.01), (0.1, 0.01))
MOST = (1.0, 1.2, 0.3)  # K_P / K_u, K_I T_u / K_u, K_D / (K_u T_u), upper limits of the search
SPREAD_GAIN, SPREAD_INTEGRAL = 0.3, 0.6  # standard deviation of the search's first logarithms


@dataclass(frozen=True)
class Limits:
    """Limits of a candidate, before throttle mix and idle."""

    output: float  # mean output, fraction
    change: float  # mean |change| of an output in 1 ms, fraction
    idle: float  # motor fraction of armed motors at no thrust


@dataclass(frozen=True)
class Trial:
    """Settings and their figures on the training commands."""

    settings: PidSettings
    mae: float  # [deg/s], mean of the axes
    output: float
    change: float
    held: float  # mean excess over the band at the end of large commands, 0..1
    cost: float  # [deg/s]


@dataclass(frozen=True)
class Tuning:
    """The course and result of a search."""

    ultimate_gains: tuple[UltimateGain, UltimateGain, UltimateGain]  # roll, pitch, yaw
    rules: dict[str, Trial]  # the rules of Ziegler and Nichols and their successors, by name
    start: Trial  # first mean of the search: the best of the rules and of parts of them
    trials: tuple[Trial, ...]  # of the search, in the order flown
    best: Trial
    interrupted: bool


Progress = Callable[[int, Trial], None]  # candidates flown so far, and the best of them


def tune(
    aircraft: Aircraft,
    limits: Limits,
    *,
    seed: int,
    commands: int,
    budget: int,
    control_rate_hz: int,
    progress: Progress,
) -> Tuning:
    """Settings of least cost after about `budget` candidates (whole generations) of `commands` pulses each.

    The same arguments give the same settings. An interruption (KeyboardInterrupt) during the search ends it
    and keeps the best so far. Raises TrainingError on an aircraft that no gain makes oscillate.
    """
    draw, search = (np.random.default_rng(s) for s in np.random.SeedSequence([seed, 1]).spawn(2))
    pulses = training_commands(commands, draw)
    unbiased = replace(aircraft, gyro=replace(aircraft.gyro, bias=0.0))

    def fly(candidates: Sequence[PidSettings]) -> list[Trial]:
        return _fly(unbiased, candidates, pulses, limits, seed, control_rate_hz)

    idle = min(IDLE_START, limits.idle)
    found = ultimate_gains(aircraft, idle, control_rate_hz)
    starts = fly([_rule_settings(found, rule, *part, idle) for part in STARTS for rule in RULES])
    rules = dict(zip(RULES, starts, strict=False))
    start = best = min(starts, key=lambda trial: trial.cost)
    trials: list[Trial] = []
    cutoff_max_hz = CUTOFF_NYQUIST_MAX * control_rate_hz / 2
    most = np.array([item.scaled(MOST) for item in found])
    spread = np.full(11, SPREAD_GAIN)
    spread[3:6] = SPREAD_INTEGRAL
    cma_es = CmaEs(_encoded(start.settings), spread, POPULATION, search)
    try:
        for _ in range(max(1, round(budget / POPULATION))):
            points = cma_es.ask()
            generation = fly([_decoded(point, most, limits.idle, cutoff_max_hz) for point in points])
            cma_es.tell(points, np.array([trial.cost for trial in generation]))
            trials += generation
            best = min([best, *generation], key=lambda trial: trial.cost)
            progress(len(trials), best)
    except KeyboardInterrupt:
        return Tuning(found, rules, start, tuple(trials), best, interrupted=True)
    return Tuning(found, rules, start, tuple(trials), best, interrupted=False)


def idle_limit(aircraft: Aircraft) -> float:
    """Largest idle, in whole percent, at which all rotors together lift IDLE_WEIGHT_MAX of the weight."""
    idles = np.arange(0.0, IDLE_MAX + 1e-9, 0.01)
    thrust, _ = thrust_and_torque(target_speed(idles, aircraft.propulsion), aircraft.propulsion)
    weight = aircraft.mass_properties.mass * GRAVITY
    return float(round(idles[aircraft.motor_count * thrust <= IDLE_WEIGHT_MAX * weight].max(initial=0.0), 2))


def training_commands(count: int, rng: np.random.Generator) -> Array:
    """Stratified commands of the pulse task [rad/s], (count, 3).

    Each axis has the median of each of `count` equally likely ranges once, in an order of its own.
    """
    normal = NormalDist(0.0, PulseTask().sigma_deg_s)
    middles = np.array([normal.inv_cdf((i + 0.5) / count) for i in range(count)])
    commands: Array = np.deg2rad(np.column_stack([rng.permutation(middles) for _ in range(3)]))
    return commands


def held_commands() -> Array:
    """Commands of the episodic task's size, a small one on one axis, [rad/s], (12, 3)."""
    limit = np.deg2rad(EpisodicTask().limit_deg_s)
    signs = np.array([(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)])
    return np.concatenate([np.insert(limit * signs, axis, HELD_SMALL * limit, axis=1) for axis in range(3)])


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


class _IdlingPid:
    """PIDs with different idles, as one controller whose outputs include the idle."""

    def __init__(self, pid: Pid, idle: Array) -> None:
        self._pid = pid
        self._idle = idle[:, None].astype(np.float32)

    def reset(self) -> None:
        """See Controller."""
        self._pid.reset()

    def step(
        self, setpoint: NDArray[np.float32], gyro: NDArray[np.float32], throttle: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """See Controller."""
        y = self._pid.step(setpoint, gyro, throttle)
        return self._idle + (np.float32(1.0) - self._idle) * y


def _fly(
    aircraft: Aircraft,
    candidates: Sequence[PidSettings],
    pulses: Array,
    limits: Limits,
    seed: int,
    control_rate_hz: int,
) -> list[Trial]:
    def fly(commands: Array, task: Callable[[Array], Task]) -> list[Flights]:
        """The flights of each candidate; all fly the same commands (m, 3)."""
        crowd = [settings for settings in candidates for _ in commands]
        idle = np.array([settings.idle for settings in crowd])
        flown = record(
            _IdlingPid(Pid(mixer(aircraft), crowd, len(crowd), control_rate_hz), idle),
            aircraft,
            task(np.tile(commands, (len(candidates), 1))),
            episodes=len(crowd),
            seed=seed,
            control_rate_hz=control_rate_hz,
        )
        rows = [slice(start, start + len(commands)) for start in range(0, len(crowd), len(commands))]
        return [Flights(flown.setpoint[r], flown.rate[r], flown.output[r], flown.step_s) for r in rows]

    pulsed = fly(pulses, lambda commands: Pulses(commands, PulseTask()))
    held = fly(held_commands(), lambda commands: Steps(commands, EpisodicTask().hold_s))
    return [_trial(*flown, limits) for flown in zip(candidates, pulsed, held, strict=True)]


def _trial(settings: PidSettings, pulsed: Flights, held: Flights, limits: Limits) -> Trial:
    mae = float(tracking(pulsed.setpoint, pulsed.rate, pulsed.step_s).mae.mean())
    raised = effort(pulsed.output, pulsed.step_s)
    output = (raised.output - settings.idle) / (1.0 - settings.idle)
    change = raised.change / (1.0 - settings.idle)
    excess = max(0.0, output / (MARGIN * limits.output) - 1.0)
    excess += max(0.0, change / (MARGIN * limits.change) - 1.0)
    missed = _missed(held)
    return Trial(settings, mae, output, change, missed, mae + PENALTY * (excess + missed))


def _missed(held: Flights) -> float:
    """Mean excess over the band at the end of held commands; each excess counts at most 1."""
    end = round(HELD_END_S / held.step_s)
    error = np.rad2deg(np.abs(held.setpoint - held.rate)[:, -end:].max(axis=1))
    band = np.maximum(BAND * np.rad2deg(np.abs(held.setpoint[:, -1])), FLOOR_DEG_S)
    return float((error / (HELD_MARGIN * band) - 1.0).clip(0.0, 1.0).mean())


def _rule_settings(
    found: Sequence[UltimateGain], rule: str, part: float, integral: float, idle: float
) -> PidSettings:
    """The gains by `rule` times `part`, and K_I times `integral` too."""
    gains = [item.gains(rule) for item in found]
    roll, pitch, yaw = ((part * p, part * integral * i, part * d) for p, i, d in gains)
    return _rounded((roll, pitch, yaw), CUTOFF_START_HZ, idle)


def _encoded(settings: PidSettings) -> Array:
    """Settings as logarithms (11,): K_P of the axes, K_I, K_D, cutoff, idle."""
    gains = np.array(settings.gains).T.ravel()
    return np.log([*gains, settings.derivative_cutoff_hz or CUTOFF_START_HZ, max(settings.idle, IDLE_MIN)])


def _decoded(point: Array, most: Array, idle_max: float, cutoff_max_hz: float) -> PidSettings:
    *values, cutoff, idle = np.exp(point).tolist()
    gains = np.minimum(np.reshape(values, (3, 3)).T, most)
    roll, pitch, yaw = np.where(gains < NOTHING, 0.0, gains).tolist()
    cutoff = min(max(cutoff, CUTOFF_MIN_HZ), cutoff_max_hz)
    return _rounded((tuple(roll), tuple(pitch), tuple(yaw)), cutoff, min(idle, idle_max))


def _rounded(gains: tuple[Vector, Vector, Vector], cutoff_hz: float, idle: float) -> PidSettings:
    (a, b, c), (d, e, f), (g, h, i) = ([_significant(value) for value in axis] for axis in gains)
    return PidSettings(((a, b, c), (d, e, f), (g, h, i)), _significant(cutoff_hz), _significant(idle))


def _significant(value: float) -> float:
    """`value` with DIGITS significant digits."""
    if value == 0.0 or not math.isfinite(value):
        return value
    return round(value, DIGITS - 1 - math.floor(math.log10(abs(value))))
