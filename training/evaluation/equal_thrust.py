"""Controllers on the same commands, each at the throttle that gives the same thrust at rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from neuroflight.sim.analysis.confidence import Mean, mean_of
from neuroflight.sim.arrays import Array
from neuroflight.training.evaluation.comparison import Entry, enter, values
from neuroflight.training.evaluation.controllers import AnyController, Conditions
from neuroflight.training.evaluation.thrust import (
    Bar,
    Transparency,
    Trim,
    transparency,
    trims,
)


@dataclass(frozen=True, eq=False)
class Level:
    """All controllers at one thrust, in the order of their transparency."""

    wanted: float  # of the weight; 0: the throttle closed
    entries: tuple[Entry, ...]
    trims: tuple[Trim, ...]


@dataclass(frozen=True, eq=False)
class EqualThrust:
    """Results of controllers at equal thrust."""

    transparency: tuple[Transparency, ...]
    levels: tuple[Level, ...]


def all_transparency(
    controllers: Sequence[AnyController], conditions: Conditions, bar: Bar
) -> tuple[Transparency, ...]:
    """Fly each controller at rest along the throttle."""
    return tuple(transparency(each, conditions, bar(f"{each.label} at rest")) for each in controllers)


def equal_thrust(
    controllers: Sequence[AnyController], conditions: Conditions, thrusts: Sequence[float], bar: Bar
) -> EqualThrust:
    """Find each controller's throttles for `thrusts`, of the weight, and fly all commands at each.

    A throttle that stands for two thrusts is flown once.
    """
    rests = all_transparency(controllers, conditions, bar)
    columns = []
    for known in rests:
        controller = known.controller
        found = trims(known, conditions, thrusts, bar(f"{controller.label}, throttles"))
        flown: dict[float, Entry] = {}
        for trim in found:
            throttle = trim.rest.throttle
            if throttle not in flown:
                show = bar(f"{controller.label}, throttle {throttle:.3f}")
                flown[throttle] = enter(controller, conditions, throttle, show)
        columns.append([(flown[trim.rest.throttle], trim) for trim in found])
    levels = tuple(
        Level(wanted, tuple(entry for entry, _ in row), tuple(trim for _, trim in row))
        for wanted, row in zip(thrusts, zip(*columns, strict=True), strict=True)
    )
    return EqualThrust(rests, levels)


def over_levels(levels: Sequence[Level], number: int, name: str) -> tuple[Mean, Mean | None]:
    """Return a figure of controller `number`, mean over the levels; and less the first's, paired.

    Each command counts with its mean over the levels. The difference is None for the first controller.
    """
    own = [_each(level.entries[number], name) for level in levels]
    if number == 0:
        return mean_of(np.mean(own, axis=0)), None
    first = [_each(level.entries[0], name) for level in levels]
    return mean_of(np.mean(own, axis=0)), mean_of(np.mean(own, axis=0) - np.mean(first, axis=0))


def _each(entry: Entry, name: str) -> Array:
    """Return a figure of each command, (E,), the mean of its axes where it has three."""
    each = values(entry.scores)[name]
    mean: Array = each.reshape(len(each), -1).mean(axis=1)
    return mean
