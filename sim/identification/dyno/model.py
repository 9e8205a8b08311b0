"""Rotor speed in closed form under a schedule of throttle, fast enough for a fit.

`sim.physics.rotor` moves every rotor of a twin by one step; here one rotor runs through a whole recording,
exact for throttle that is held from one instant to the next.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from neuroflight.sim.arrays import Array, Flags, Indices
from neuroflight.sim.identification.dyno.recording import Recording
from neuroflight.sim.identification.dyno.signal import uneven

HELD = 0.001  # throttle that moves less than this is taken as held: 0.05 % off at most
UNLIMITED = 1e12  # [rad/s^2], slew of a response that has no limit
PLACES = np.linspace(-1.0, 1.0, 17)  # tried within the slack of a jump's time
NEAR = 2.0  # standard deviations of the noise
FIRST_ROWS = 5  # of a run, whose median is its first speed


@dataclass(frozen=True, eq=False)
class Schedule:
    """Throttle as S stretches on which it is held."""

    time: Array  # (S,) [s], at which each begins
    value: Array  # (S,)
    fresh: Flags  # (S,), whether a run begins with it
    first: Array  # (S,) [rad/s], measured speed at the beginning of a run, else 0
    row: Indices  # (S,), at which each shows first
    middle: Array  # (S,) [s], middle of the interval that the log leaves for `time`
    slack: Array  # (S,) [s], by which that may be early or late
    near: float  # [rad/s], a run that begins no further from its target begins there


@dataclass(frozen=True)
class Dynamics:
    """Rates [1/s] and slews [rad/s^2] up and down, delay [s]: both kinds of response in one form."""

    rate_up: float
    rate_down: float
    slew_up: float
    slew_down: float
    delay: float


def make_schedule(recording: Recording, throttle: Array, noise: float = 0.0, held: float = HELD) -> Schedule:
    """Split the throttle into stretches on which it moves less than `held`; noise [rad/s]: of the speed."""
    begins = []
    starts = set(recording.starts)
    low = high = 0.0
    for row, value in enumerate(throttle.tolist()):
        low, high = min(low, value), max(high, value)
        if row in starts or high - low > held:
            begins.append(row)
            low = high = value
    rows = np.array(begins)
    sizes = np.diff(np.append(rows, len(throttle)))
    fresh = np.isin(rows, recording.starts)
    first = np.zeros(len(rows))
    for index in np.flatnonzero(fresh):
        row = int(rows[index])
        first[index] = max(float(np.median(recording.speed[row : row + FIRST_ROWS])), 0.0)
    time = recording.time[rows]
    slack = np.zeros(len(rows))
    if uneven(recording.time):  # then throttle may have changed at any time since the row before
        slack = np.where(fresh, 0.0, 0.5 * (time - recording.time[rows - 1]))
    middle = time - slack
    value = np.add.reduceat(throttle, rows) / sizes
    return Schedule(middle, value, fresh, first, rows, middle, slack, NEAR * noise)


def retimed(schedule: Schedule, jumped: Indices, cost: Callable[[Schedule], Array]) -> Schedule:
    """Return `schedule` with each jump moved to where within its slack it costs least.

    jumped: rows of the jumps, (J,). cost: of the rows after each jump under a schedule, (J,). On average
    the jumps stay where they are, so that this does not take the place of a delay.
    """
    index = np.searchsorted(schedule.row, jumped)
    slack = schedule.slack[index]
    if not slack.any():
        return schedule

    def moved(part: Array) -> Schedule:
        time = schedule.time.copy()
        time[index] = schedule.middle[index] + part * slack
        return replace(schedule, time=time)

    costs = np.array([cost(moved(np.full(len(index), part))) for part in PLACES])
    part = PLACES[np.argmin(costs, axis=0)]
    return moved(np.clip(part - part.mean(), -1.0, 1.0))


def simulate(schedule: Schedule, slopes: Array, dynamics: Dynamics, time: Array) -> Array:
    """Compute the rotor speed at `time`, exactly for throttle held on each stretch."""
    begins = np.where(schedule.fresh, schedule.time, schedule.time + dynamics.delay)
    targets = curve(slopes, schedule.value)
    index = np.searchsorted(begins, time, side="right") - 1
    target = targets[index]
    away = knots(schedule, targets, dynamics)[index] - target
    rate = np.where(away < 0, dynamics.rate_up, dynamics.rate_down)
    slew = np.where(away < 0, dynamics.slew_up, dynamics.slew_down)
    size, elapsed = np.abs(away), time - begins[index]
    limited = np.maximum(size / slew - 1 / rate, 0.0)  # [s], for which the slew holds it
    left = (size - slew * np.minimum(elapsed, limited)) * np.exp(-rate * np.maximum(elapsed - limited, 0.0))
    speed: Array = target + np.copysign(left, away)
    return speed


def knots(schedule: Schedule, targets: Array, dynamics: Dynamics) -> Array:
    """Compute the speed at the beginning of each stretch, with the motion of `simulate`.

    Scalars, because each waits for the one before it and a ramp has a thousand.
    """
    up = dynamics.rate_up, dynamics.slew_up, 1 / dynamics.rate_up
    down = dynamics.rate_down, dynamics.slew_down, 1 / dynamics.rate_down
    begins = np.where(schedule.fresh, schedule.time, schedule.time + dynamics.delay)
    lasting = np.diff(begins, append=begins[-1]).tolist()
    settled = schedule.fresh & (np.abs(schedule.first - targets) < schedule.near)
    knots = np.where(settled, targets, schedule.first).tolist()
    fresh = schedule.fresh.tolist()
    fresh.append(True)
    exp = math.exp
    for index, (target, elapsed) in enumerate(zip(targets.tolist(), lasting, strict=True)):
        if fresh[index + 1]:
            continue
        away = knots[index] - target
        size = abs(away)
        rate, slew, lag = up if away < 0 else down
        limited = size / slew - lag
        if limited <= 0:
            left = size * exp(-rate * elapsed)
        elif elapsed <= limited:
            left = size - slew * elapsed
        else:
            left = slew * lag * exp(-rate * (elapsed - limited))
        knots[index + 1] = target + math.copysign(left, away)
    return np.array(knots)


def curve(slopes: Array, throttle: Array) -> Array:
    """Compute H [rad/s] from its value at 0 and its slopes at 0 and 1, which are its bounds."""
    start, first, last = slopes
    speed: Array = start + throttle * (first + throttle * (0.5 * (last - first)))
    return speed


def quadratic(slopes: Array) -> tuple[float, float, float]:
    """Return a, b, c of H from its value and slopes."""
    start, first, last = (float(value) for value in slopes)
    return 0.5 * (last - first), first, start


def quadratic_errors(covariance: Array) -> tuple[float, float, float]:
    """Return the standard errors of a, b, c from the covariance of value and slopes, (3, 3)."""
    to_a = np.array([0.0, -0.5, 0.5])
    a, b, c = np.sqrt([to_a @ covariance @ to_a, covariance[1, 1], covariance[0, 0]])
    return float(a), float(b), float(c)
