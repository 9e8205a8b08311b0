"""Figures of controllers at equal thrust, and of their thrust against the throttle: tables and JSON."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from neuroflight.cli.compare.commanded import flight_note
from neuroflight.cli.compare.figures import (
    HEADLINE,
    LEAST_NOTE,
    MEAN_ROWS,
    MORE,
    flight_document,
    means_document,
    side_by_side,
)
from neuroflight.cli.report import Table, difference, interval

if TYPE_CHECKING:
    from neuroflight.training.evaluation.controllers import Conditions
    from neuroflight.training.evaluation.equal_thrust import EqualThrust, Level
    from neuroflight.training.evaluation.thrust import Transparency

OVER_THRUSTS = {  # figures that are averaged over thrusts
    *("mae", "mse", "mae_least", "mae_above", "mse_least", "mse_above"),
    *("motor_change", "rest_late", "drift"),
}
NOTE = (
    "Each controller flies at the throttle that gives this thrust at rest, of the aircraft's weight; (*) "
    "marks the nearest that it can. Motors: their fractions after mix and idle; s.d. at rest: how far they "
    "swing without any command, where their mean change in 1 ms hides a slow swing. Errors in deg/s against "
    "the true rate; ± is 95 % confidence. Differences are paired, command by command; ≈ marks those that "
    "such confidence does not tell from none. "
)
REST_NOTE = (
    "At rest: zero command with gyro noise; motors: their mean fraction, beside the ideal idle + (1 - "
    "idle) throttle; below, the largest deviation from it, and whether the motors rise with the throttle."
)


def documents(found: EqualThrust) -> dict[str, object]:
    """Return the flights at equal thrust as JSON data."""
    return {
        "equal_thrust": [
            {
                "thrust": level.wanted,
                "controllers": [
                    {
                        **flight_document(entry),
                        **means_document(entry, level.entries[0]),
                        "thrust_at_rest": trim.rest.thrust.document(),
                        "motor_at_rest": trim.rest.motor,
                        "motor_deviation_at_rest": trim.rest.deviation,
                        "reached": trim.reached,
                    }
                    for entry, trim in zip(level.entries, level.trims, strict=True)
                ],
            }
            for level in found.levels
        ],
        **rest_documents(found.transparency),
    }


def rest_documents(rests: Sequence[Transparency]) -> dict[str, object]:
    """Return thrust against throttle as JSON data."""
    return {"transparency": [_rest_document(each) for each in rests]}


def _rest_document(known: Transparency) -> dict[str, object]:
    from neuroflight.training.evaluation.thrust import TRANSPARENT

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


def equal_thrust_tables(
    title: str, found: EqualThrust, flown: Conditions, *, everything: bool
) -> list[Table]:
    """Return tables for each thrust, one of their mean, and one of the thrust against the throttle."""
    tables = []
    for level in found.levels:
        closed = ", throttle closed" if level.wanted == 0.0 else f", thrust {level.wanted:g} at rest"
        tables += side_by_side(title + closed, level.entries, _trims(level), everything)
    lifted = [level for level in found.levels if level.wanted > 0.0]
    if len(lifted) > 1:
        told = ", ".join(f"{level.wanted:g}" for level in lifted)
        tables.append(Table(f"mean over the thrusts {told}", list(_mean_rows(lifted, everything))))
    note = f"{NOTE}{LEAST_NOTE if everything else MORE.strip()}{flight_note(flown)}"
    tables[-1] = replace(tables[-1], note=note)
    return [*tables, transparency_table(found.transparency)]


def transparency_table(rests: Sequence[Transparency]) -> Table:
    """Return thrust at rest and mean motor fraction against the throttle."""
    from neuroflight.training.evaluation.thrust import TRANSPARENT

    labels = [f"{each.controller.label}\nidle {each.controller.idle:g}" for each in rests]
    rows: list[tuple[str, ...]] = [("throttle", *labels)]
    for number, rest in enumerate(rests[0].rests):
        pairs = [(each, each.rests[number]) for each in rests]
        cells = [
            f"{float(own.thrust.value):.2f}  {own.motor:.3f}/{each.ideal(own.throttle):.3f}"
            for each, own in pairs
        ]
        rows.append((f"{rest.throttle:g}", *cells))
    low, high = TRANSPARENT
    farthest = [(each.deviation, each) for each in rests]
    off = [f"{far.motor - each.ideal(far.throttle):+.3f} at {far.throttle:g}" for far, each in farthest]
    rows.append((f"{low:g} to {high:g}", *off))
    falls = [each.falls for each in rests]
    rows.append(("rises", *("yes" if fall is None else f"no: {fall[0]:g} to {fall[1]:g}" for fall in falls)))
    return Table("at rest: thrust of the weight, motors/ideal", rows, REST_NOTE)


def _trims(level: Level) -> list[tuple[str, ...]]:
    """Return the throttle of each controller, and the thrust that it gives."""
    rests = [trim.rest for trim in level.trims]
    marks = ["" if trim.reached or level.wanted == 0.0 else " (*)" for trim in level.trims]
    reached = [interval(rest.thrust, 3) for rest in rests]
    return [
        ("throttle", *(f"{rest.throttle:.3f}" for rest in rests)),
        ("thrust at rest", *(text + mark for text, mark in zip(reached, marks, strict=True))),
        ("motors at rest, s.d.", *(f"{rest.deviation:.5f}" for rest in rests)),
    ]


def _mean_rows(levels: Sequence[Level], everything: bool) -> Iterator[tuple[str, ...]]:
    """Yield the means of all thrusts, and their ratios to the first controller's."""
    from neuroflight.training.evaluation.comparison import values
    from neuroflight.training.evaluation.equal_thrust import over_levels

    entries = levels[0].entries
    first = entries[0].controller.label
    yield ("", *(each.controller.label for each in entries))
    known = values(entries[0].scores)
    for heading, name, factor, digits in MEAN_ROWS:
        if not (name in known and name in OVER_THRUSTS and (everything or name in HEADLINE)):
            continue
        found = [over_levels(levels, number, name) for number in range(len(entries))]
        yield (heading, *(interval(mean, digits, factor) for mean, _ in found))
        if len(entries) > 1:
            yield (
                f"  less {first}",
                *("" if off is None else difference(off, digits, factor) for _, off in found),
            )
            base = float(found[0][0].value)
            ratios = (f"{float(mean.value) / base:.3f}" if base else "" for mean, _ in found)
            yield (f"  over {first}", *ratios)
