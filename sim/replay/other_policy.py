"""The answers of another policy to a flight's inputs: asked at every step, never flown."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuroflight.sim.arrays import Array
from neuroflight.sim.control.motors import motor_fractions
from neuroflight.sim.replay.inputs import Answers, Flight
from neuroflight.toolchain.contract import DSHOT_STOP
from neuroflight.toolchain.errors import TraceError

LARGEST = 5  # differences that are named
APART_S = 0.1  # two of them


@dataclass(frozen=True)
class Large:
    """One of the largest differences."""

    at_s: float  # since the log's first step
    motor: int  # from 1
    logged: float  # motor fraction, 0..1
    answered: float


@dataclass(frozen=True)
class Opinion:
    """The differences of its answers from the flight's, over the control steps at which both turn motors."""

    steps: int  # that were compared
    only_logged: int  # control steps at which the flight's motors turned and these would not have
    only_answered: int
    share: float  # of the steps compared, in which a motor differs, 0..1
    mean: tuple[float, ...]  # absolute difference of each motor [motor fraction]
    largest: tuple[Large, ...]
    thrust_logged: float  # mean of all motors [motor fraction]
    thrust_answered: float


def opinion(flight: Flight, answers: Answers) -> Opinion:
    """Compare what another firmware answered with what the flight did.

    Raises TraceError where no motor turned in the flight, or never in both.
    """
    logged, answered = flight.answers.dshot, answers.dshot
    turned, would = (logged != DSHOT_STOP).any(axis=1), (answered != DSHOT_STOP).any(axis=1)
    if not turned.any():
        raise TraceError(f"{flight.path}: no motor turns in this log; there is nothing to compare")
    both = turned & would
    if not both.any():
        raise TraceError(
            f"{flight.path}: with the other policy no motor would have turned; look whether it fits aircraft "
            "and the settings"
        )
    u, v = motor_fractions(logged[both]), motor_fractions(answered[both])
    apart = np.abs(u - v)
    return Opinion(
        steps=int(both.sum()),
        only_logged=int((turned & ~would).sum()),
        only_answered=int((would & ~turned).sum()),
        share=float((logged[both] != answered[both]).any(axis=1).mean()),
        mean=tuple(apart.mean(axis=0).tolist()),
        largest=_largest(flight.t[both], u, v),
        thrust_logged=float(u.mean()),
        thrust_answered=float(v.mean()),
    )


def _largest(t: Array, u: Array, v: Array) -> tuple[Large, ...]:
    """Return the largest differences of fractions u and v (N, M), at least APART_S from each other."""
    worst = np.abs(u - v).max(axis=1)
    found: list[Large] = []
    for row in np.argsort(-worst, kind="stable").tolist():
        if len(found) == LARGEST or worst[row] == 0.0:
            break
        if any(abs(t[row] - one.at_s) < APART_S for one in found):
            continue
        motor = int(np.abs(u[row] - v[row]).argmax())
        found.append(Large(float(t[row]), motor + 1, float(u[row, motor]), float(v[row, motor])))
    return tuple(found)
