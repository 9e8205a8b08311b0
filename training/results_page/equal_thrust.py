"""The sections about equal thrust, and about thrust against throttle, on the page of results."""

from __future__ import annotations

from collections.abc import Sequence

from neuroflight.training.results_page.markdown import axes, number, table
from neuroflight.training.results_page.rows import controller_label
from neuroflight.training.results_page.stored_results import Stored

# Figure, heading, digits.
MEANS = (("mae", "MAE", 3), ("mse", "MSE", 1), ("motor_change", "motors, abs Δ", 5))
HOLDS = (("rest_late", "rest late", 2), ("drift", "drift, °", 1))  # of flights besides


def equal_thrust_section(stored: Stored) -> str:
    """Return controllers at equal thrust: a table of each thrust, their mean, and thrust against throttle."""
    levels = stored.entries("equal_thrust")
    flights = stored.text("task") == "flight"
    holds, told_means = (HOLDS, (*MEANS, *HOLDS)) if flights else ((), MEANS)
    body = [row for level in levels for row in _level_rows(level, holds)]
    headings = (
        "thrust, controller",
        "throttle",
        "at rest",
        "MAE",
        "mean",
        "MSE",
        "motors, abs Δ",
        "at rest, s.d.",
        *(heading for _, heading, _ in holds),
    )
    first = controller_label(levels[0].entries("controllers")[0])
    less = tuple(f"{heading} less the first" for _, heading, _ in told_means)
    about = (ABOUT_FLIGHTS if flights else ABOUT_PULSES) + ABOUT.format(
        episodes=f"{stored.number('episodes'):.0f}", first=first
    )
    parts = [f"## Equal thrust, {stored.text('aircraft')}\n\n{about}", table((*headings, *less), body)]
    lifted = [level for level in levels if level.number("thrust") > 0]
    if len(lifted) > 1:
        told = ", ".join(f"{level.number('thrust'):g}" for level in lifted)
        columns = [part for _, heading, _ in told_means for part in (heading, "of the first's")]
        parts.append(table((f"mean over the thrusts {told}", *columns), _mean_rows(lifted, told_means)))
    return "\n\n".join([*parts, transparency_table(stored)])


def transparency_section(stored: Stored) -> str:
    """Return the section of thrust against throttle alone."""
    return f"## Thrust against throttle, {stored.text('aircraft')}\n\n{transparency_table(stored)}"


def transparency_table(stored: Stored) -> str:
    """Return a table of thrust and motors at rest of each controller, a column for each throttle."""
    entries = stored.entries("transparency")
    throttles = entries[0].numbers("throttle")
    low, high = entries[0].numbers("deviation", "throttles")
    body = []
    for each in entries:
        found = (each.numbers(name) for name in ("thrust", "motor", "ideal"))
        cells = [
            f"{thrust:.2f} ({motor:.3f} / {ideal:.3f})" for thrust, motor, ideal in zip(*found, strict=True)
        ]
        off = f"{each.number('deviation', 'value'):+.3f} at {each.number('deviation', 'throttle'):g}"
        rises = "yes" if each.get("falls") is None else "no: {:g} to {:g}".format(*each.numbers("falls"))
        body.append((controller_label(each), *cells, off, rises))
    headings = (*(f"{throttle:g}" for throttle in throttles), f"deviation, {low:g} to {high:g}", "rises")
    return f"{ABOUT_REST}\n\n{table(('throttle', *headings), body)}"


def _level_rows(level: Stored, holds: Sequence[tuple[str, str, int]]) -> list[Sequence[str]]:
    """Return a row for each controller; holds: further figures, of flights."""
    thrust = level.number("thrust")
    rows: list[Sequence[str]] = []
    for each in level.entries("controllers"):
        nearest = "" if each.get("reached") is True or not thrust else ", nearest"
        first = not each.has("difference")  # to which the others' differences are
        change = [
            "" if first else each.interval("difference", name).difference(digits)
            for name, _, digits in (*MEANS, *holds)
        ]
        rows.append(
            (
                f"{f'{thrust:g}' if thrust else 'closed'}, {controller_label(each)}",
                number(each.number("throttle"), 3),
                f"{each.number('thrust_at_rest', 'value'):.3f}{nearest}",
                axes(each.axes("mae"), 2),
                *(each.interval("means", name).text(digits) for name, _, digits in MEANS),
                number(each.number("motor_deviation_at_rest"), 5),
                *(each.interval("means", name).text(digits) for name, _, digits in holds),
                *change,
            )
        )
    return rows


def _mean_rows(levels: Sequence[Stored], told: Sequence[tuple[str, str, int]]) -> list[Sequence[str]]:
    columns = [level.entries("controllers") for level in levels]
    rows: list[Sequence[str]] = []
    for own in zip(*columns, strict=True):
        cells = []
        for name, _, digits in told:
            mean, first = (
                sum(each.number("means", name, "value") for each in row) / len(levels)
                for row in (own, [column[0] for column in columns])
            )
            cells += [number(mean, digits), f"{mean / first:.3f}" if first else ""]
        rows.append((controller_label(own[0]), *cells))
    return rows


ABOUT_PULSES = "Pulses as above, "
ABOUT_FLIGHTS = """Flights of a minute: ten pulses one after another, nothing reset between, and a hover.
Rest late is the mean rate [deg/s] with the sticks centred in the last fifth of the pulses' time, drift how
far the aircraft turns in the last ten seconds of the hover, both means of the axes; ± is that of flights.
Pulses: """
ABOUT = """{episodes} of them, the same for all, rounded to what sticks can say; the gyro
runs at 4 kHz with the same noise and bias, the delay is the aircraft's. Each controller flies at the throttle
that gives this thrust at rest, in parts of the weight, or at the nearest that it can; closed is throttle 0.
So none buys its error with rotors that turn faster than the others'. The terms are the same for all, the
idle too unless a row names another; each was tuned by its own means: a policy by training, a PID by this
project's search, Betaflight by its authors, for no aircraft in particular. Every row is shown, whoever wins
it. Motors: mean change of their fractions, after mix and idle, in 1 ms; their standard deviation (s.d.) at
rest shows a slow swing as well. ± is 95 % confidence; differences are to {first}, command by command, and
≈ marks those whose confidence interval includes zero."""
ABOUT_REST = """Thrust at rest in parts of the weight against the throttle, with gyro noise; in brackets the
mean motor fraction beside the transparent one, idle + (1 - idle) throttle, and last the largest deviation
from it and whether the motors turn faster with every step of the throttle."""
