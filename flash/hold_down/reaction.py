"""The reaction of an aircraft that is held to pulses of one motor, and how sure it is.

Whatever holds it answers: foam, a strap, a hand. Of each axis is assumed that its rate r obeys

    dr/dt = push * f(t) - damping * r - stiffness * angle + something slow

f is the pulse as a rotor follows it. Integrated once, every term is known from samples: the equation is
linear in push, damping and stiffness. Damping and stiffness are the mount's, alike for all pulses and fitted
first; then each pulse gives a push of its own. Their spread says how sure their mean is: what a hand does, or
a mount that is otherwise, is in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
BEFORE_S, BEHIND_S = 0.2, 0.2  # of samples around a pulse that it is judged by
LAG_S = 0.04  # with which rotors follow: between the quickest and the slowest of our twins
# The kick of a rotor that speeds up turns the aircraft as its drag torque does in this time, which our twins
# differ in by three: both have the same sign, so that the sum has it, too.
KICK_S = 0.15
LEAST = 0.02  # [rad/s^2], standard deviation that a pulse's push is believed to have at least
YAW = 2


@dataclass(frozen=True, eq=False)
class Record:
    """The samples while one motor had its pulses."""

    times: Array  # (N,) [s], rising
    rates: Array  # (N, 3) [rad/s] about the body axes: x forward, y left, z up
    level: Array  # (N,), 1 in a pulse, 0 between two
    rpm: float | None = None  # that the motor's ESC told in the last pulse; None: it tells none

    @property
    def edges(self) -> list[int]:
        """The last sample before each pulse."""
        return [int(edge) for edge in np.flatnonzero(np.diff(self.level) > 0.5)]


@dataclass(frozen=True, eq=False)
class Reaction:
    """The mean push of a motor's pulses about each axis, shape (3,) [rad/s^2]: roll, pitch, yaw."""

    push: Array
    error: Array  # its standard deviation
    rpm: float | None = None  # as Record has it

    @property
    def sureness(self) -> Array:
        """Return how many standard deviations the push is from none, with its sign, (3,)."""
        return np.asarray(self.push / self.error)


@dataclass(frozen=True, eq=False)
class _Pulse:
    """One axis around one pulse, as integrals from the first sample on, (n,) each."""

    rate: Array
    angle: Array
    area: Array  # of the angle
    known: Array  # (n, 4): a drift, and what the pulse does

    def without_known(self, values: Array) -> Array:
        """Return what of `values` the columns of `known` cannot explain."""
        basis, _ = np.linalg.qr(self.known)
        return np.asarray(values - basis @ (basis.T @ values))

    def push(self, damping: float, stiffness: float) -> float:
        """Return the push under such a mount [rad/s^2]."""
        free = self.rate + damping * self.angle + stiffness * self.area
        found, *_ = np.linalg.lstsq(self.known, free, rcond=None)
        return float(found[3])


def reactions(records: Sequence[Record]) -> tuple[Reaction, ...]:
    """Return what each motor does, from the records of its pulses, two at least each, in one mount.

    What differs from pulse to pulse is taken to be alike for all motors.
    """
    pushes = [np.zeros((len(record.edges), 3)) for record in records]
    for axis in range(3):
        pulses = [_pulses(record, axis) for record in records]
        mount = _mount([pulse for each in pulses for pulse in each])
        for found, each in zip(pushes, pulses, strict=True):
            found[:, axis] = [pulse.push(*mount) for pulse in each]
    squares = sum((((each - each.mean(axis=0)) ** 2).sum(axis=0) for each in pushes), np.zeros(3))
    free = sum(len(each) - 1 for each in pushes)
    spread = np.maximum(np.sqrt(squares / free), LEAST)
    return tuple(
        Reaction(each.mean(axis=0), spread / np.sqrt(len(each)), record.rpm)
        for each, record in zip(pushes, records, strict=True)
    )


def _pulses(record: Record, axis: int) -> list[_Pulse]:
    """Return the integrals around each pulse."""
    times, rotor = record.times, _followed(record)
    found = []
    for edge in record.edges:
        ends = np.flatnonzero(record.level[edge + 1 :] < 0.5)
        end = times[edge + 1 + ends[0]] if len(ends) else times[-1]
        around = (times >= times[edge] - BEFORE_S) & (times <= end + BEHIND_S)
        at = times[around] - times[around][0]
        rate, pulse = record.rates[around, axis], rotor[around]
        angle = _integral(rate, at)
        pushed = _integral(pulse, at) + (KICK_S * pulse if axis == YAW else 0.0)
        known = np.stack([np.ones_like(at), at, at**2, pushed], axis=1)
        found.append(_Pulse(rate, angle, _integral(angle, at), known))
    return found


def _mount(pulses: Sequence[_Pulse]) -> tuple[float, float]:
    """Return damping [1/s] and stiffness [1/s^2] of an axis."""
    terms = [
        np.stack([-pulse.without_known(pulse.angle), -pulse.without_known(pulse.area)], axis=1)
        for pulse in pulses
    ]
    rates = np.concatenate([pulse.without_known(pulse.rate) for pulse in pulses])
    (damping, stiffness), *_ = np.linalg.lstsq(np.concatenate(terms), rates, rcond=None)
    return max(float(damping), 0.0), max(float(stiffness), 0.0)


def _followed(record: Record) -> Array:
    """Return the pulses as a rotor follows them."""
    found = np.zeros(len(record.times))
    kept = np.exp(-np.diff(record.times) / LAG_S)
    for i, share in enumerate(kept):
        found[i + 1] = share * found[i] + (1.0 - share) * record.level[i]
    return found


def _integral(values: Array, at: Array) -> Array:
    """Return the integral from the first sample on, by trapezoids."""
    steps = 0.5 * (values[1:] + values[:-1]) * np.diff(at)
    return np.concatenate([[0.0], np.cumsum(steps)])
