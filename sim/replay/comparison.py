"""Comparison of a replay's answers with the flight's: to the bit, no tolerance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.arrays import Flags
from neuroflight.sim.replay.inputs import Answers, Flight

EXACT = ("gyro", "setpoint", "throttle")  # compared where the log has them to the bit


@dataclass(frozen=True)
class Difference:
    """The first control step at which something differs."""

    step: int  # since the log's first
    at_s: float  # likewise
    logged: tuple[int, ...]  # DShot value of each motor
    replayed: tuple[int, ...]
    exact: tuple[str, ...]  # which of EXACT differ there


@dataclass(frozen=True)
class Comparison:
    """The comparison of all control steps that were replayed."""

    steps: int
    values: int  # of motors
    different: int  # control steps of which a motor differs
    exact: tuple[str, ...]  # of EXACT that were compared as well
    first: Difference | None

    @property
    def equal(self) -> bool:
        return self.first is None

    def __str__(self) -> str:
        if self.first is None:
            beside = f"; so are {', '.join(self.exact)} to the bit" if self.exact else ""
            return f"{self.steps:,} control steps, {self.values:,} values, equal{beside}"
        first = self.first
        logged, replayed = (" ".join(map(str, values)) for values in (first.logged, first.replayed))
        same = logged == replayed
        motors = "motors equal there" if same else f"motors logged {logged}, replayed {replayed}"
        beside = f"; {', '.join(first.exact)} differ{'s' * (len(first.exact) == 1)}" if first.exact else ""
        return (
            f"differs first at control step {first.step:,}, {first.at_s:.3f} s: {motors}{beside}\n"
            f"{self.different:,} of {self.steps:,} control steps differ in a motor"
        )


def compare(flight: Flight, replayed: Answers) -> Comparison:
    """Compare `replayed`, one row for each step of `flight`, with the log."""
    logged = flight.answers
    motors = (logged.dshot != replayed.dshot).any(axis=1)
    pairs = {name: (getattr(logged, name), getattr(replayed, name)) for name in EXACT}
    known = {name: pair for name, pair in pairs.items() if pair[0] is not None and pair[1] is not None}
    others = {name: _differs(*pair) for name, pair in known.items()}
    anything = np.logical_or.reduce([motors, *others.values()])
    first = None
    if anything.any():
        row = int(anything.argmax())
        first = Difference(
            step=int(flight.inputs.step[row]),
            at_s=float(flight.t[row]),
            logged=tuple(logged.dshot[row].tolist()),
            replayed=tuple(replayed.dshot[row].tolist()),
            exact=tuple(name for name, rows in others.items() if rows[row]),
        )
    return Comparison(len(flight), logged.dshot.size, int(motors.sum()), tuple(known), first)


def _differs(logged: NDArray[Any], replayed: NDArray[Any]) -> Flags:
    """Return True for rows (N,) whose bits differ."""
    bits = logged.view(np.uint32) != replayed.view(np.uint32)
    rows: Flags = bits.reshape(len(logged), -1).any(axis=1)
    return rows
