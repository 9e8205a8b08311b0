"""Controllers on the same commands, each at the throttle that gives the same thrust at rest."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from neuroflight.sim.analysis.confidence import Mean
from neuroflight.training.evaluation.comparison import Array, Entry, document, enter, values
from neuroflight.training.evaluation.controllers import AnyController, Conditions
from neuroflight.training.evaluation.evaluation import interval, mean_over
from neuroflight.training.evaluation.thrust import (
    TRANSPARENT,
    Progress,
    Transparency,
    Trim,
    transparency,
    trims,
)

Bar = Callable[[str], Progress]  # adds a bar of that name and gives its update


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
        return mean_over(np.mean(own, axis=0)), None
    first = [_each(level.entries[0], name) for level in levels]
    return mean_over(np.mean(own, axis=0)), mean_over(np.mean(own, axis=0) - np.mean(first, axis=0))


def level_document(level: Level, flight: Callable[[Entry], dict[str, object]]) -> dict[str, object]:
    """Return a level as JSON data; flight: what a controller and its figures give."""
    first = level.entries[0]
    return {
        "thrust": level.wanted,
        "controllers": [
            {
                **flight(entry),
                **document(entry, None if entry is first else first),
                "thrust_at_rest": interval(trim.rest.thrust),
                "motor_at_rest": trim.rest.motor,
                "motor_deviation_at_rest": trim.rest.deviation,
                "reached": trim.reached,
            }
            for entry, trim in zip(level.entries, level.trims, strict=True)
        ],
    }


def transparency_document(known: Transparency) -> dict[str, object]:
    """Return a controller at rest as JSON data."""
    farthest = known.deviation
    return {
        "controller": known.controller.name,
        **known.controller.facts,
        "idle": known.controller.idle,
        "throttle": [rest.throttle for rest in known.rests],
        "thrust": [float(rest.thrust.value) for rest in known.rests],
        "motor": [rest.motor for rest in known.rests],
        "motor_deviation": [rest.deviation for rest in known.rests],
        "ideal": [known.ideal(rest.throttle) for rest in known.rests],
        "deviation": {
            "throttles": list(TRANSPARENT),
            "value": farthest.motor - known.ideal(farthest.throttle),
            "throttle": farthest.throttle,
        },
        "falls": None if known.falls is None else list(known.falls),
    }


def _each(entry: Entry, name: str) -> Array:
    """Return a figure of each command, (E,), the mean of its axes where it has three."""
    each = values(entry.scores)[name]
    mean: Array = each.reshape(len(each), -1).mean(axis=1)
    return mean
