"""Parameters of a user's own controller by the search that finds a PID's (CMA-ES), in the twin.

A candidate flies pulses at four thrusts, as a PID's does by flying terms, but in Python: the candidates of a
generation fly side by side in one world, and all fly the same commands. Its cost is
a PID's too (see training/pid_tuning/flying.py), without the harder flights.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.analysis.metrics import effort, tracking
from neuroflight.sim.arrays import Array, Array32
from neuroflight.sim.control.controller import Controller
from neuroflight.toolchain.errors import TrainingError
from neuroflight.training.evaluation.evaluation import Flights, record
from neuroflight.training.evaluation.users_controller import Parameter, UsersController
from neuroflight.training.pid_tuning.cma_es import CmaEs
from neuroflight.training.pid_tuning.flying import LEVELS, PENALTY, throttle_for
from neuroflight.training.pid_tuning.trial import (
    MARGIN,
    Trial,
    Tuning,
    streams,
    training_commands,
    without_bias,
)
from neuroflight.training.pid_tuning.tuner import POPULATION, MakeTuner, search
from neuroflight.training.pid_tuning.tuning import significant
from neuroflight.training.tasks.task import GivenCommands, PulseTask

Values = Mapping[str, float]

COMMANDS = 12  # pulses that each candidate flies, three at each thrust
SPREAD = 0.2  # standard deviation of the search's first points, of each parameter's range
BROAD = 10.0  # ratio of a range above which it is searched by its logarithm


def tune_users(
    controller: UsersController,
    aircraft: Aircraft,
    change: float,
    *,
    names: Sequence[str],
    seed: int,
    budget: int,
    progress: Callable[[int, Trial[Values]], None],
    tuner: MakeTuner = CmaEs,
) -> Tuning[Values]:
    """Search values of least cost of the parameters `names` with about `budget` candidates.

    change: the most that a motor value may change in 1 ms on average, fraction; tuner: of the search. The
    same arguments give the same values. names: see `check_names`.
    """
    check_names(controller, names)
    draw, rng = streams(seed)
    flights = _Flights(controller, without_bias(aircraft), change, seed, training_commands(COMMANDS, draw))
    parameters = {name: controller.parameters[name] for name in names}
    (start,) = flights.fly([controller.values])
    at = np.array([_encoded(each, controller.values[name]) for name, each in parameters.items()])

    def fly(points: Array) -> list[Trial[Values]]:
        decoded = [
            {name: _decoded(each, x) for (name, each), x in zip(parameters.items(), point, strict=True)}
            for point in points.tolist()
        ]
        return flights.fly([{**controller.values, **values} for values in decoded])

    return search(tuner(at, np.full(len(at), SPREAD), POPULATION, rng), fly, start, budget, progress)


def check_names(controller: UsersController, names: Sequence[str]) -> None:
    """Raise TrainingError if there is nothing to tune, or a name is no parameter."""
    has = ", ".join(controller.parameters) or "none"
    for name in names:
        if name not in controller.parameters:
            raise TrainingError(
                f"{controller.name}: no parameter {name}; its attribute `parameters` has: {has}"
            )
    if not names:
        raise TrainingError(
            f"{controller.name}: nothing to tune; give its class an attribute such as "
            f'parameters = {{"p": (0.02, 0.001, 1.0)}}: start, least, greatest'
        )


def _encoded(parameter: Parameter, value: float) -> float:
    """Return a value as 0..1 of its range, or of that of its logarithm."""
    low, high = parameter.low, parameter.high
    if low > 0.0 and high / low > BROAD:
        return math.log(value / low) / math.log(high / low)
    return (value - low) / (high - low)


def _decoded(parameter: Parameter, x: float) -> float:
    """Return the value nearest to the one that `_encoded` gives as `x`."""
    low, high, x = parameter.low, parameter.high, min(max(x, 0.0), 1.0)
    broad = low > 0.0 and high / low > BROAD
    value = low * (high / low) ** x if broad else low + x * (high - low)
    return min(max(significant(value), low), high)


@dataclass(frozen=True, eq=False)
class _Flights:
    """The flights that every candidate makes."""

    controller: UsersController
    aircraft: Aircraft
    change: float  # the limit
    seed: int  # of the gyro's noise
    commands: Array  # (n, 3) [rad/s], of the pulses

    def fly(self, candidates: Sequence[Values]) -> list[Trial[Values]]:
        """Return the figures of each of the candidates."""
        spec, count, each = self.controller, len(candidates), len(self.commands)
        throttle = np.array([throttle_for(self.aircraft, level, spec.idle) for level in LEVELS], np.float32)
        flown = record(
            _Crowd([spec.build(self.aircraft, each, values) for values in candidates], each),
            self.aircraft,
            GivenCommands(PulseTask(), np.tile(self.commands, (count, 1))),
            episodes=count * each,
            seed=self.seed,
            control_rate_hz=spec.control_rate_hz,
            throttle=np.tile(np.repeat(throttle, each // len(LEVELS)), count),
            idle=spec.idle,
            mix=spec.mix,
            gyro_filters=spec.gyro_filters,
        )
        assert flown.motors is not None  # `record` keeps them
        rows = [slice(first, first + each) for first in range(0, count * each, each)]
        return [self._trial(values, flown, r) for values, r in zip(candidates, rows, strict=True)]

    def _trial(self, values: Values, flown: Flights, rows: slice) -> Trial[Values]:
        assert flown.motors is not None
        errors = tracking(flown.setpoint[rows], flown.rate[rows], flown.step_s)
        mae, mse = errors.mae.mean(axis=1), errors.mse.mean(axis=1)
        moved = effort(flown.motors[rows], flown.step_s).change
        cost = math.exp(float(np.log(mae * mse).mean()) / 3.0)
        cost *= max(1.0, moved / (MARGIN * self.change)) ** PENALTY
        return Trial(values, float(mae.mean()), moved, cost)


class _Crowd:
    """Controllers of several candidates as one."""

    def __init__(self, each: Sequence[Controller], count: int) -> None:
        """Join them; count: aircraft of each."""
        self._each, self._count = each, count

    def reset(self) -> None:
        """See Controller."""
        for one in self._each:
            one.reset()

    def step(self, setpoint: Array32, gyro: Array32, throttle: Array32) -> Array32:
        """See Controller."""
        rows = range(0, len(setpoint), self._count)
        return np.concatenate(
            [
                one.step(*(part[at : at + self._count] for part in (setpoint, gyro, throttle)))
                for one, at in zip(self._each, rows, strict=True)
            ]
        )
