"""PID tuning in the twin: Ziegler and Nichols' gains, then a local search on the cost of trial flights."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from neuroflight.sim.aircraft.mass import Vector
from neuroflight.sim.aircraft.model import Aircraft, PidSettings
from neuroflight.sim.arrays import Array
from neuroflight.sim.physics.rotor import target_speed, thrust_and_torque
from neuroflight.toolchain.contract import GRAVITY
from neuroflight.training.pid_tuning.cma_es import CmaEs
from neuroflight.training.pid_tuning.trial import RATE_HZ, Trial, Trials, Tuning
from neuroflight.training.pid_tuning.tuner import POPULATION, MakeTuner, search
from neuroflight.training.pid_tuning.ultimate_gain import RULES, UltimateGain, ultimate_gains

IDLE_START = 0.1
IDLE_WEIGHT_MAX = 0.75  # thrust of all idling rotors in parts of the weight; more would hardly let it sink
IDLE_MIN, IDLE_MAX = 1e-3, 0.5  # of the search; the least has no visible effect
CUTOFF_START_HZ = 30.0
CUTOFF_MIN_HZ = 15.0  # with less, K_D acts on the rate rather than on its slope
CUTOFF_NYQUIST_MAX = 0.9  # of half the control rate
NOTHING = (1e-3, 1e-2, 1e-4)  # K_P, K_I, K_D below which a gain has no visible effect and is set to 0
DIGITS = 4  # significant digits of the settings
# Factors of a rule's gains, and a further one of its K_I, that the search may start with: K_u is measured
# with an ideal gyro, and rate control needs little integral, because a moment integrates to a rate.
STARTS = ((1.0, 1.0), (1.0, 0.01), (0.3, 0.01), (0.1, 0.01))
MOST = (1.0, 1.2, 0.3)  # K_P / K_u, K_I T_u / K_u, K_D / (K_u T_u), upper limits of the search
SPREAD_GAIN, SPREAD_INTEGRAL = 0.3, 0.6  # standard deviation of the search's first logarithms


@dataclass(frozen=True)
class PidTuning(Tuning[PidSettings]):
    """A PID's search, which begins with the best of the rules and of parts of them."""

    ultimate_gains: tuple[UltimateGain, UltimateGain, UltimateGain]  # roll, pitch, yaw
    rules: dict[str, Trial[PidSettings]]  # of Ziegler and Nichols and their successors, by name


def tune(
    trials: Trials,
    *,
    budget: int,
    rng: np.random.Generator,
    progress: Callable[[int, Trial[PidSettings]], None],
    begin: Sequence[PidSettings] = (),
    tuner: MakeTuner = CmaEs,
) -> PidTuning:
    """Return the settings of least cost after about `budget` candidates, in whole generations.

    rng: of the search; begin: settings that it may begin with, if they cost less than every rule; tuner: what
    searches.

    The same arguments give the same settings. An interruption (KeyboardInterrupt) during the search ends it
    and keeps the best so far. Raises TrainingError on an aircraft that no gain makes oscillate.
    """
    gains = ultimate_gains(trials.aircraft, min(IDLE_START, trials.limits.idle), RATE_HZ)
    space = _Space(
        trials=trials,
        most=np.array([item.scaled(MOST) for item in gains]),
        cutoff_max_hz=CUTOFF_NYQUIST_MAX * RATE_HZ / 2,
    )
    begun = [space.rule(gains, rule, *part) for part in STARTS for rule in RULES]
    begun += [space.decoded(space.encoded(settings)) for settings in begin]
    starts = trials.fly(begun)
    rules = dict(zip(RULES, starts, strict=False))
    first = min(starts, key=lambda trial: trial.cost)
    at = space.encoded(first.settings)
    spread = np.full(len(at), SPREAD_GAIN)
    spread[3:6] = SPREAD_INTEGRAL
    found = search(
        tuner(at, spread, POPULATION, rng),
        lambda points: trials.fly([space.decoded(point) for point in points]),
        first,
        budget,
        progress,
    )
    return PidTuning(**vars(found), ultimate_gains=gains, rules=rules)


def idle_limit(aircraft: Aircraft) -> float:
    """Return the largest idle, in percent, at which the rotors lift IDLE_WEIGHT_MAX of the weight."""
    idles = np.arange(0.0, IDLE_MAX + 1e-9, 0.01)
    thrust, _ = thrust_and_torque(target_speed(idles, aircraft.propulsion), aircraft.propulsion)
    weight = aircraft.mass_properties.mass * GRAVITY
    return float(round(idles[aircraft.motor_count * thrust <= IDLE_WEIGHT_MAX * weight].max(initial=0.0), 2))


@dataclass(frozen=True, eq=False)
class _Space:
    """The settings that a search may choose."""

    trials: Trials
    most: Array  # (3, 3): axis by K_P, K_I, K_D
    cutoff_max_hz: float

    def rule(self, found: Sequence[UltimateGain], rule: str, part: float, integral: float) -> PidSettings:
        """Return the gains by `rule` times `part`, and K_I times `integral` too."""
        gains = [item.gains(rule) for item in found]
        roll, pitch, yaw = ((part * p, part * integral * i, part * d) for p, i, d in gains)
        return self._rounded((roll, pitch, yaw), CUTOFF_START_HZ, IDLE_START)

    def encoded(self, settings: PidSettings) -> Array:
        """Return settings as logarithms: K_P of the axes, K_I, K_D, cutoff, and idle if it is searched."""
        values = [
            *np.maximum(settings.gains, NOTHING).T.ravel(),
            settings.derivative_cutoff_hz or CUTOFF_START_HZ,
        ]
        if self.trials.idle is None:
            values.append(max(settings.idle, IDLE_MIN))
        return np.log(values)

    def decoded(self, point: Array) -> PidSettings:
        """Return the settings nearest to those that `encoded` gives as `point`."""
        *values, cutoff, idle = np.exp(point if self.trials.idle is None else [*point, 0.0]).tolist()
        gains = np.minimum(np.reshape(values, (3, 3)).T, self.most)
        roll, pitch, yaw = np.where(gains < NOTHING, 0.0, gains).tolist()
        cutoff = min(max(cutoff, CUTOFF_MIN_HZ), self.cutoff_max_hz)
        return self._rounded((tuple(roll), tuple(pitch), tuple(yaw)), cutoff, idle)

    def _rounded(self, gains: tuple[Vector, Vector, Vector], cutoff_hz: float, idle: float) -> PidSettings:
        (a, b, c), (d, e, f), (g, h, i) = ([significant(value) for value in axis] for axis in gains)
        fixed, most = self.trials.idle, self.trials.limits.idle
        return PidSettings(
            ((a, b, c), (d, e, f), (g, h, i)),
            significant(cutoff_hz),
            significant(min(idle, most)) if fixed is None else fixed,
            mix=self.trials.mix,
            gyro_filters=self.trials.gyro_filters,
        )


def significant(value: float) -> float:
    """Round `value` to DIGITS significant digits."""
    if value == 0.0 or not math.isfinite(value):
        return value
    return round(value, DIGITS - 1 - math.floor(math.log10(abs(value))))
