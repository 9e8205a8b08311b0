"""Shared by `evaluate` and `compare`: tables and data of equal thrust, and of thrust against throttle."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from neuroflight.cli.output import with_margin
from neuroflight.cli.training.evaluation.conditions import flight_document

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from neuroflight.sim.analysis.confidence import Mean
    from neuroflight.training.evaluation.equal_thrust import EqualThrust, Level
    from neuroflight.training.evaluation.thrust import Transparency

FIGURES = (  # heading, figure, digits
    ("MAE mean", "mae", 3),
    ("MSE mean", "mse", 1),
    ("MAE, least possible", "mae_least", 3),
    ("  above it", "mae_above", 3),
    ("MSE, least possible", "mse_least", 1),
    ("  above it", "mse_above", 1),
    ("motors |Δ|, 1 ms", "motor_change", 5),
    ("outputs |Δu|, 1 ms", "change", 5),
    ("peak, %", "peak", 1),
    ("rest early", "rest_early", 2),
    ("rest late", "rest_late", 2),
    ("hover", "hover", 2),
    ("drift, °", "drift", 1),
)
AXIS_FIGURES = (("MAE", "mae", 2), ("rest late", "rest_late", 2), ("drift, °", "drift", 1))
MEAN_FIGURES = (
    "mae",
    "mse",
    "mae_least",
    "mae_above",
    "mse_least",
    "mse_above",
    "motor_change",
    "rest_late",
    "drift",
)  # over all thrusts
LEAST_NOTE = (
    "Least possible: by any motors' values, each figure by its own, from the command's step on, from the "
    "thrust at rest of that controller, without noise."
)
NOTE = (
    "Each controller flies at the throttle that gives this thrust at rest, of the aircraft's weight; (*) "
    "marks the nearest that it can. Motors: their fractions after mix and idle; s.d. at rest: how far they "
    "swing without any command, where their mean change in 1 ms hides a slow swing. Errors in deg/s against "
    "the true rate; ± is 95 % confidence. Differences are paired, command by command; ≈ marks those that "
    f"such confidence does not tell from none. {LEAST_NOTE}"
)
REST_NOTE = (
    "At rest: zero command with gyro noise; motors: their mean fraction, beside the ideal idle + (1 - "
    "idle) throttle; below, the largest deviation from it, and whether the motors rise with the throttle."
)


def documents(found: EqualThrust) -> dict[str, object]:
    """What equal thrust found, as JSON data."""
    from neuroflight.training.evaluation.equal_thrust import level_document

    return {
        "equal_thrust": [
            level_document(
                level, lambda entry: flight_document(entry.controller, entry.throttle, entry.evaluation)
            )
            for level in found.levels
        ],
        **rest_documents(found.transparency),
    }


def rest_documents(rests: Sequence[Transparency]) -> dict[str, object]:
    """Thrust against throttle as JSON data."""
    from neuroflight.training.evaluation.equal_thrust import transparency_document

    return {"transparency": [transparency_document(each) for each in rests]}


def print_equal_thrust(console: Console, title: str, found: EqualThrust, more: str) -> None:
    """A table for each thrust, one of their mean, and one of the thrust against the throttle.

    more: words about the task, for the note.
    """
    for level in found.levels:
        closed = ", throttle closed" if level.wanted == 0.0 else f", thrust {level.wanted:g} at rest"
        _print_level(console, title + closed, level)
    lifted = [level for level in found.levels if level.wanted > 0.0]
    if len(lifted) > 1:
        _print_mean(console, lifted)
    console.print(NOTE + more, style="dim")
    print_transparency(console, found.transparency)


def print_transparency(console: Console, rests: Sequence[Transparency]) -> None:
    """Thrust at rest and mean motor fraction against the throttle."""
    from neuroflight.training.evaluation.thrust import TRANSPARENT

    labels = [f"{each.controller.label}\nidle {each.controller.idle:g}" for each in rests]
    table = _table("at rest: thrust of the weight, motors/ideal", "throttle", labels)
    for number, rest in enumerate(rests[0].rests):
        cells = []
        for each in rests:
            own = each.rests[number]
            cells.append(f"{float(own.thrust.value):.2f}  {own.motor:.3f}/{each.ideal(own.throttle):.3f}")
        table.add_row(f"{rest.throttle:g}", *cells)
    low, high = TRANSPARENT
    cells = []
    for each in rests:
        farthest = each.deviation
        off = farthest.motor - each.ideal(farthest.throttle)
        cells.append(f"{off:+.3f} at {farthest.throttle:g}")
    table.add_row(f"{low:g} to {high:g}", *cells)
    falls = [each.falls for each in rests]
    words = ["yes" if fall is None else f"no: {fall[0]:g} to {fall[1]:g}" for fall in falls]
    table.add_row("rises", *words)
    console.print(table)
    console.print(REST_NOTE, style="dim")


def _print_level(console: Console, title: str, level: Level) -> None:
    from neuroflight.toolchain.contract import AXES
    from neuroflight.training.evaluation.comparison import by_axis, differences, means

    entries = level.entries
    table = _table(title, "", [f"{each.controller.label}\nidle {each.controller.idle:g}" for each in entries])
    rests = [trim.rest for trim in level.trims]
    table.add_row("throttle", *(f"{rest.throttle:.3f}" for rest in rests))
    marks = ["" if trim.reached or level.wanted == 0.0 else " (*)" for trim in level.trims]
    reached = [_interval(rest.thrust, 3) for rest in rests]
    table.add_row("thrust at rest", *(text + mark for text, mark in zip(reached, marks, strict=True)))
    table.add_row("motors at rest, s.d.", *(f"{rest.deviation:.5f}" for rest in rests))
    each_axis = [by_axis(each.scores) for each in entries]
    for heading, name, digits in AXIS_FIGURES:
        if all(name in found for found in each_axis):
            for axis, word in enumerate(AXES):
                table.add_row(
                    f"{heading} {word}", *(_interval(found[name], digits, axis) for found in each_axis)
                )
    averages = [means(each.scores) for each in entries]
    told = [row for row in FIGURES if all(row[1] in each for each in averages)]
    for heading, name, digits in told:
        table.add_row(heading, *(_interval(each[name], digits) for each in averages))
    if len(entries) > 1:
        first = entries[0]
        less = [differences(first.scores, each.scores) for each in entries[1:]]
        table.add_row(f"less {first.controller.label}")
        for heading, name, digits in told:
            table.add_row(f"  {heading}", "", *(_difference(each[name], digits) for each in less))
    console.print(table)


def _print_mean(console: Console, levels: Sequence[Level]) -> None:
    """The means of all thrusts, and their ratios to the first controller's."""
    from neuroflight.training.evaluation.comparison import values
    from neuroflight.training.evaluation.equal_thrust import over_levels

    entries = levels[0].entries
    told = ", ".join(f"{level.wanted:g}" for level in levels)
    table = _table(f"mean over the thrusts {told}", "", [each.controller.label for each in entries])
    numbers = range(len(entries))
    known = values(entries[0].scores)
    for heading, name, digits in (row for row in FIGURES if row[1] in MEAN_FIGURES and row[1] in known):
        found = [over_levels(levels, number, name) for number in numbers]
        table.add_row(heading, *(_interval(mean, digits) for mean, _ in found))
        if len(entries) > 1:
            less = ["" if off is None else _difference(off, digits) for _, off in found]
            table.add_row(f"  less {entries[0].controller.label}", *less)
            base = float(found[0][0].value)
            ratios = [f"{float(mean.value) / base:.3f}" if base else "" for mean, _ in found]
            table.add_row(f"  over {entries[0].controller.label}", *ratios)
    console.print(table)


def _table(title: str, corner: str, headings: Sequence[str]) -> Table:
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    table.add_column(corner, no_wrap=True)
    for heading in headings:
        table.add_column(heading, justify="right", no_wrap=True)
    return table


def _interval(mean: Mean, digits: int, axis: int | tuple[()] = ()) -> str:
    """A mean and its margin; axis: the one of three."""
    if not mean.count[axis]:
        return "none"
    return with_margin(float(mean.value[axis]), float((mean.high - mean.low)[axis]) / 2, digits)


def _difference(mean: Mean, digits: int) -> str:
    from neuroflight.training.evaluation.comparison import significant

    known = significant(mean) and bool(mean.low < mean.high)  # a single flight has no interval
    return f"{'' if known else '≈ '}{'+' if mean.value > 0 else ''}{_interval(mean, digits)}"
