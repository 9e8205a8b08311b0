"""Thrust at rest: what a controller gives at a throttle, and the throttle at which it gives a thrust.

A controller that lets the rotors turn faster at rest has more authority when it needs it. So controllers are
compared where they give equal thrust, and a row shows what each gives at each throttle beside the
transparent one, which gives the motors idle + (1 - idle) throttle.

At rest: zero command on the bench's mount, with gyro noise; the mean over AIRCRAFT aircraft and the last
second of REST_S. Thrust is of all rotors, in parts of the aircraft's weight.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from neuroflight.sim.analysis.confidence import Mean, mean_of
from neuroflight.sim.physics.world import Mount
from neuroflight.toolchain.contract import GRAVITY
from neuroflight.training.evaluation.controllers import AnyController, Conditions
from neuroflight.training.tasks.task import EpisodicTask

REST_S = 1.5
LAST_S = 1.0
AIRCRAFT = 4  # at each throttle: they differ by less than a thousandth of the weight
THROTTLES = (0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.45, 0.6, 0.8, 1.0)
TRANSPARENT = (0.15, 0.8)  # throttles of the largest deviation
ROUNDS = 8  # of the search for a throttle, at most
NEAR = 0.003  # of the wanted thrust, at which the search ends
FINEST = 2.0**-12  # of the throttle: a stick's step is a thousandth

Progress = Callable[[int, int], None]  # steps done and to do
Bar = Callable[[str], Progress]  # adds a bar of that name and gives its update


@dataclass(frozen=True)
class Rest:
    """A controller at rest at one throttle."""

    throttle: float
    thrust: Mean  # of the weight, over aircraft
    motor: float  # mean motor fraction
    deviation: float  # standard deviation of a motor's fraction in that second, mean over motors


@dataclass(frozen=True)
class Trim:
    """The throttle at which a controller gives a thrust, or the nearest that it can."""

    wanted: float  # of the weight
    rest: Rest

    @property
    def reached(self) -> bool:
        """True if the thrust is the wanted one."""
        return abs(float(self.rest.thrust.value) - self.wanted) <= max(0.02 * self.wanted, 0.01)


@dataclass(frozen=True)
class Transparency:
    """A controller at rest along the throttle."""

    controller: AnyController
    rests: tuple[Rest, ...]  # by rising throttle

    def ideal(self, throttle: float) -> float:
        """Return the motor fraction of a transparent controller of the same idle."""
        return self.controller.idle + (1.0 - self.controller.idle) * throttle

    @property
    def deviation(self) -> Rest:
        """The throttle of the largest distance of mean motor fraction and ideal, within TRANSPARENT."""
        low, high = TRANSPARENT
        inside = [rest for rest in self.rests if low <= rest.throttle <= high]
        return max(inside, key=lambda rest: abs(rest.motor - self.ideal(rest.throttle)))

    @property
    def falls(self) -> tuple[float, float] | None:
        """The first neighbouring throttles between which the motors turn no faster; None: none."""
        for before, after in pairwise(self.rests):
            if after.motor <= before.motor:
                return before.throttle, after.throttle
        return None


def transparency(
    controller: AnyController, conditions: Conditions, progress: Progress | None = None
) -> Transparency:
    """Fly the controller at rest at THROTTLES."""
    return Transparency(controller, tuple(at_rest(controller, conditions, THROTTLES, progress)))


def at_rest(
    controller: AnyController,
    conditions: Conditions,
    throttles: Sequence[float],
    progress: Progress | None = None,
    aircraft: int = AIRCRAFT,
) -> list[Rest]:
    """Fly the controller at rest at each throttle, all at once; aircraft: so many at each."""
    still = EpisodicTask(distribution="normal", sigma_deg_s=0.0, hold_s=REST_S)
    count = len(throttles) * aircraft
    resting = replace(conditions, task=still, episodes=count, mount=Mount.CENTRE)
    flights = resting.fly(controller, np.repeat(np.array(throttles, np.float32), aircraft), progress)
    assert flights.lift is not None and flights.motors is not None
    last = slice(-round(LAST_S / flights.step_s), None)
    thrust = flights.lift[:, last].mean(axis=1, dtype=np.float64).reshape(-1, aircraft) / GRAVITY
    motors = flights.motors[:, last].astype(np.float64)
    means, deviations = (
        values.reshape(len(throttles), -1).mean(axis=1)
        for values in (motors.mean(axis=1), motors.std(axis=1))
    )
    return [
        Rest(throttle, mean_of(each), float(mean), float(deviation))
        for throttle, each, mean, deviation in zip(throttles, thrust, means, deviations, strict=True)
    ]


def throttle_of(rests: Sequence[Rest], wanted: float) -> float:
    """Return the throttle that gives about `wanted` of the weight, or the nearest, between known ones."""
    return _Search.of(rests, wanted).guess()


def trims(
    known: Transparency, conditions: Conditions, wanted: Sequence[float], progress: Progress | None = None
) -> list[Trim]:
    """Find the throttle for each wanted thrust, of the weight; 0 is the throttle closed.

    Where a thrust lies beyond what the controller gives along its throttle, the nearest to it. The search
    goes on from two neighbours of `known` with the thrust between them.
    """
    searches = [_Search.of(known.rests, thrust) for thrust in wanted]
    for number in range(ROUNDS):
        open_ones = [search for search in searches if not search.ended]
        if not open_ones:
            break
        tried = at_rest(known.controller, conditions, [search.guess() for search in open_ones])
        for search, rest in zip(open_ones, tried, strict=True):
            search.see(rest)
        if progress is not None:
            progress(number + 1, ROUNDS)
    if progress is not None:
        progress(ROUNDS, ROUNDS)
    return [Trim(search.wanted, search.best) for search in searches]


@dataclass
class _Search:
    """A search for one throttle: rotor speed goes with the root of the thrust, nearly with the throttle."""

    wanted: float
    low: Rest
    high: Rest
    best: Rest

    @staticmethod
    def of(rests: Sequence[Rest], wanted: float) -> _Search:
        """Begin between the first neighbours with the thrust between them."""
        closed = rests[0]
        if wanted == 0.0:
            return _Search(wanted, closed, closed, closed)
        best = min(rests, key=lambda rest: abs(_thrust(rest) - wanted))
        for low, high in pairwise(rests):
            if _thrust(low) <= wanted <= _thrust(high):
                return _Search(wanted, low, high, best)
        return _Search(wanted, best, best, best)

    @property
    def ended(self) -> bool:
        """True if another throttle gains nothing."""
        near = abs(_thrust(self.best) - self.wanted) <= NEAR * self.wanted
        return near or self.high.throttle - self.low.throttle <= FINEST

    def guess(self) -> float:
        """Return the next throttle to try, within the inner 90 %."""
        roots = [max(0.0, thrust) ** 0.5 for thrust in (_thrust(self.low), self.wanted, _thrust(self.high))]
        part = (roots[1] - roots[0]) / (roots[2] - roots[0]) if roots[2] > roots[0] else 0.5
        return self.low.throttle + min(max(part, 0.05), 0.95) * (self.high.throttle - self.low.throttle)

    def see(self, rest: Rest) -> None:
        """Take in the thrust of a throttle."""
        if _thrust(rest) <= self.wanted:
            self.low = rest
        else:
            self.high = rest
        self.best = min(self.best, rest, key=lambda each: abs(_thrust(each) - self.wanted))


def _thrust(rest: Rest) -> float:
    return float(rest.thrust.value)
