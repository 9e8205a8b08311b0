"""neuroflight compare: policies, PIDs and Betaflight side by side on the same unseen commands."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from neuroflight.cli.output import with_margin
from neuroflight.cli.training.evaluation.average import average_document, check_average, print_average
from neuroflight.cli.training.evaluation.conditions import (
    ONE_EPISODE,
    THROTTLES_MAX,
    add_condition_arguments,
    check_controllers,
    command,
    conditions,
    conditions_document,
    flight_document,
    progress_bars,
    throttle_words,
    told_throttle,
)
from neuroflight.cli.training.evaluation.contenders import (
    CONTENDER,
    add_contender_arguments,
    all_names,
    check_thrusts,
    open_contenders,
)
from neuroflight.cli.training.evaluation.ranges import check_ranges
from neuroflight.cli.training.evaluation.task_arguments import (
    default_throttle,
    drawn_as_flown,
    flight_note,
    flown_words,
)
from neuroflight.cli.training.evaluation.thrust import LEAST_NOTE

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

    from neuroflight.sim.analysis.confidence import Mean
    from neuroflight.training.evaluation.comparison import Entry
    from neuroflight.training.evaluation.controllers import Conditions, Contender
    from neuroflight.training.evaluation.thrust import Transparency

AXIS_ROWS = (  # heading, figure, digits: with a row an axis
    ("MAE", "mae", 2),
    ("MSE", "mse", 1),
    ("rest early", "rest_early", 2),
    ("rest late", "rest_late", 2),
    ("drift, °", "drift", 1),
)
ROWS = (  # heading, figure, factor, digits
    ("MAE, least possible", "mae_least", 1, 2),
    ("  above it", "mae_above", 1, 2),
    ("MSE, least possible", "mse_least", 1, 1),
    ("  above it", "mse_above", 1, 1),
    ("IAE", "iae", 1, 0),
    ("ISE", "ise", 1, 0),
    ("ITAE", "itae", 1, 0),
    ("ITSE", "itse", 1, 0),
    ("mean output ū", "output", 1, 4),
    ("mean |Δu| in 1 ms", "change", 1, 5),
    ("motors, mean |Δ| in 1 ms", "motor_change", 1, 5),
    ("Sm, 1e-6", "smoothness", 1e6, 1),
    ("success, %", "success", 100, 1),
    ("  bare 10 % band", "success_bare", 100, 1),
    ("error, rad/s", "error", 1, 1),
    ("rise, ms", "rise_ms", 1, 1),
    ("peak, %", "peak", 1, 1),
    ("in band, 500 ms+, %", "all_in_band_500", 100, 1),
    ("  bare", "all_in_band_500_bare", 100, 1),
    ("in band, 750 ms+, %", "all_in_band_750", 100, 1),
    ("  bare", "all_in_band_750_bare", 100, 1),
    ("every sample, %", "steady", 100, 1),
    ("  bare", "steady_bare", 100, 1),
    ("  from 750 ms, %", "steady_750", 100, 1),
    ("  bare", "steady_750_bare", 100, 1),
)
NOTE = (
    "Errors in deg/s against the true rate; ± is 95 % confidence. Differences are paired, command by "
    "command; ≈ marks those that such confidence does not tell from none. The band is 10 % of the command or "
    "5 deg/s, whichever is wider, on all axes at once; every sample: from 500 to 1500 ms after the command. "
    f"{LEAST_NOTE}"
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "controllers",
        nargs="+",
        metavar=CONTENDER,
        help="policies, PIDs of the aircraft file, Betaflight; differences are to the first",
    )
    add_condition_arguments(parser, episodes=1000)
    parser.add_argument(
        "--throttle",
        type=float,
        nargs="+",
        metavar="T",
        help="pilot's thrust, 0..1; one comparison each, the first is drawn; default: 0.3 in flights, "
        "as recorded with --commands, else 0",
    )
    add_contender_arguments(parser)
    parser.add_argument(
        "--envelope",
        type=Path,
        metavar="FILE.png",
        help="draw the error of each command of --task envelope over its roll, pitch and yaw rate",
    )
    parser.add_argument(
        "--transparency",
        action="store_true",
        help="thrust and motors at rest against the throttle too, beside what a transparent controller gives",
    )
    parser.add_argument(
        "--average",
        action="store_true",
        help="also the average of all policies over their commands together, as agents of several seeds, "
        "and the best of them: the lowest error summed over the axes",
    )


def run(args: argparse.Namespace) -> int:
    """Fly each controller at each throttle, or at each thrust, and print the figures."""
    check_controllers(all_names(args, args.controllers))
    check_thrusts(args)
    check_average(args)
    _check_envelope(args)
    given = conditions(args)
    throttles = _throttles(args, given)
    with open_contenders(args, args.controllers, given) as (contenders, flown):
        if args.thrust is not None:
            return _at_thrusts(args, contenders, flown)
        return _at_throttles(args, contenders, flown, throttles)


def _check_envelope(args: argparse.Namespace) -> None:
    """Raise NeuroflightError on a picture of another task, or on a name that is none of a picture."""
    from neuroflight.cli.output import check_output
    from neuroflight.toolchain.errors import TrainingError

    check_output(args.envelope, ".png")
    if args.envelope and (args.task != "envelope" or args.thrust is not None):
        raise TrainingError("--envelope: draws --task envelope, without --thrust; use --plot for the others")


def _at_throttles(
    args: argparse.Namespace,
    contenders: Sequence[Contender],
    flown: Conditions,
    throttles: Sequence[float | None],
) -> int:
    from rich.console import Console

    from neuroflight.cli.training.evaluation.thrust import print_transparency, rest_documents
    from neuroflight.sim.plotting import save_png
    from neuroflight.training.evaluation.comparison import enter
    from neuroflight.training.evaluation.envelope_plot import draw_envelope
    from neuroflight.training.evaluation.equal_thrust import all_transparency

    rounds: dict[float | None, list[Entry]] = {}
    with progress_bars(args) as bar:
        for throttle in throttles:
            for contender in contenders:
                show = bar(contender.label + throttle_words(throttle))
                rounds.setdefault(throttle, []).append(enter(contender, flown, throttle, show))
        rests = all_transparency(contenders, flown, bar) if args.transparency else ()
    title = f"{flown.aircraft.name}: {flown_words(flown)}"
    if args.plot:
        first = throttles[0]
        save_png(args.plot, _drawn(flown, rounds[first], title + throttle_words(first), rests))
    averages = [average_document(entries) for entries in rounds.values()] if args.average else []
    if args.envelope:
        first = throttles[0]
        save_png(args.envelope, draw_envelope(rounds[first], title + throttle_words(first)))
    if args.json:
        comparison = [entry for entries in rounds.values() for entry in _documents(entries)]
        more = {"average": averages} if averages else {}
        _print_json(
            args, flown, {"comparison": comparison, **more, **(rest_documents(rests) if rests else {})}
        )
        return 0
    console = Console()
    for throttle, entries in rounds.items():
        _print(console, title + throttle_words(throttle), entries)
    for found in averages:
        print_average(console, found)
    console.print(f"{NOTE}{flight_note(flown)}{ONE_EPISODE if flown.episodes == 1 else ''}", style="dim")
    if rests:
        print_transparency(console, rests)
    return 0


def _drawn(flown: Conditions, entries: Sequence[Entry], title: str, rests: Sequence[Transparency]) -> Figure:
    """One episode as all flew it where it says more than percentiles do; else all commands."""
    from neuroflight.training.evaluation.comparison_plot import draw
    from neuroflight.training.evaluation.tracking_plot import Tracked, draw_long, draw_step

    if not drawn_as_flown(flown):
        return draw(entries, title, rests)
    tracked = [Tracked(entry.controller.label, entry.curves.t, entry.curves.example) for entry in entries]
    held = all(entry.evaluation.response is not None for entry in entries)
    return draw_step(tracked, title) if held else draw_long(tracked, title)


def _at_thrusts(args: argparse.Namespace, contenders: Sequence[Contender], flown: Conditions) -> int:
    from rich.console import Console

    from neuroflight.cli.training.evaluation.thrust import documents, print_equal_thrust
    from neuroflight.sim.plotting import save_png
    from neuroflight.training.evaluation.equal_thrust import equal_thrust

    with progress_bars(args) as bar:
        found = equal_thrust(contenders, flown, args.thrust, bar)
    title = f"{flown.aircraft.name}: {flown_words(flown)}"
    if args.plot:
        first = found.levels[0]
        words = f"{title}, thrust {first.wanted:g}"
        save_png(args.plot, _drawn(flown, first.entries, words, found.transparency))
    if args.json:
        _print_json(args, flown, documents(found))
    else:
        print_equal_thrust(Console(), title, found, flight_note(flown))
    return 0


def _print_json(args: argparse.Namespace, flown: Conditions, found: dict[str, object]) -> None:
    throttles = None if args.thrust is not None else told_throttle(flown, _throttles(args, flown))
    told = command("compare", args, flown, *args.controllers, throttle=throttles)
    print(json.dumps({"command": told, **conditions_document(args, flown), **found}, indent=2))


def _throttles(args: argparse.Namespace, flown: Conditions) -> list[float | None]:
    """The throttles to fly at, checked; None: as recorded."""
    from neuroflight.toolchain.errors import TrainingError

    if args.throttle is None:
        return [default_throttle(flown)]
    if len(args.throttle) > THROTTLES_MAX:
        raise TrainingError(f"--throttle: {len(args.throttle)} values, expected 1 to {THROTTLES_MAX}")
    check_ranges(*(("--throttle", throttle, 0.0, 1.0) for throttle in args.throttle))
    return list(args.throttle)


def _documents(entries: Sequence[Entry]) -> list[dict[str, object]]:
    from neuroflight.training.evaluation.comparison import document
    from neuroflight.training.evaluation.envelope import envelope, envelope_document

    envelopes = [envelope(entry) for entry in entries]
    return [
        {
            **flight_document(entry.controller, entry.throttle, entry.evaluation),
            **document(entry, None if entry is entries[0] else entries[0]),
            **({"envelope": envelope_document(found, envelopes[0])} if found and envelopes[0] else {}),
        }
        for entry, found in zip(entries, envelopes, strict=True)
    ]


def _print(console: Console, title: str, entries: Sequence[Entry]) -> None:
    """Print the figures, then the differences to the first controller."""
    from rich.table import Table

    from neuroflight.toolchain.contract import AXES
    from neuroflight.training.evaluation.comparison import by_axis, differences, means

    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    table.add_column("", no_wrap=True)
    for entry in entries:
        idle = f"\nidle {entry.controller.idle:g}" if entry.controller.idle else ""
        table.add_column(entry.controller.label + idle, justify="right", no_wrap=True)
    averages = [means(entry.scores) for entry in entries]
    each = [by_axis(entry.scores) for entry in entries]
    for heading, name, digits in AXIS_ROWS:
        if not all(name in found for found in averages):
            continue
        for axis, word in enumerate(AXES):
            table.add_row(f"{heading} {word}", *(_interval(found[name], 1, digits, axis) for found in each))
        table.add_row(f"{heading} mean", *(_interval(found[name], 1, digits) for found in averages))
    for heading, name, factor, digits in ROWS:
        if all(name in each for each in averages):
            table.add_row(heading, *(_interval(each[name], factor, digits) for each in averages))
    console.print(table)
    if len(entries) == 1:
        return
    first = entries[0]
    table = Table(title=f"less {first.controller.label}", title_justify="left", box=None, pad_edge=False)
    table.add_column("", no_wrap=True)
    for entry in entries[1:]:
        table.add_column(entry.controller.label, justify="right", no_wrap=True)
    found = [differences(first.scores, entry.scores) for entry in entries[1:]]
    rows = [(f"{heading} mean", name, 1, digits) for heading, name, digits in AXIS_ROWS]
    for heading, name, factor, digits in (*rows, *ROWS):
        if name in found[0]:
            table.add_row(heading, *(_difference(each[name], factor, digits) for each in found))
    console.print(table)


def _interval(mean: Mean, factor: float, digits: int, axis: int | None = None) -> str:
    """A mean and its margin; axis: the one of three."""
    count, value, low, high = (
        part if axis is None else part[axis] for part in (mean.count, mean.value, mean.low, mean.high)
    )
    if not count:
        return "none"
    value, margin = factor * float(value), factor * float(high - low) / 2
    return with_margin(value, margin, digits)


def _difference(mean: Mean, factor: float, digits: int) -> str:
    from neuroflight.training.evaluation.comparison import significant

    known = significant(mean) and bool(mean.low < mean.high)  # a single flight has no interval
    mark = "" if known or not mean.count else "≈ "
    sign = "+" if mean.value > 0 else ""
    return f"{mark}{sign}{_interval(mean, factor, digits)}"
