"""neuroflight evaluate: figures of a policy, a PID or Betaflight on unseen commands in the twin."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import TYPE_CHECKING

from neuroflight.cli.output import with_margin
from neuroflight.cli.training.evaluation.conditions import (
    ONE_EPISODE,
    add_condition_arguments,
    command,
    conditions,
    conditions_document,
    flight_document,
    progress_bars,
    told_throttle,
)
from neuroflight.cli.training.evaluation.contenders import (
    CONTENDER,
    add_contender_arguments,
    check_thrusts,
    open_contenders,
)
from neuroflight.cli.training.evaluation.ranges import check_ranges
from neuroflight.cli.training.evaluation.task_arguments import (
    commands_flown,
    default_throttle,
    drawn_as_flown,
    flight_note,
    flown_words,
)

if TYPE_CHECKING:
    from rich.table import Table

    from neuroflight.sim.analysis.confidence import Mean
    from neuroflight.sim.analysis.holding import HoldingFigures
    from neuroflight.training.evaluation.controllers import Conditions, Contender
    from neuroflight.training.evaluation.evaluation import Evaluation

ALL_ROWS = (
    ("all axes, 500 ms+, %", "all_in_band_500"),
    ("all axes, 750 ms+, %", "all_in_band_750"),
    ("  bare, 500 ms+, %", "all_in_band_500_bare"),
    ("  bare, 750 ms+, %", "all_in_band_750_bare"),
    ("all axes, every sample, %", "steady"),
    ("  bare, every sample, %", "steady_bare"),
)
RESPONSE_ROWS = (  # heading, figure, factor, digits
    ("success, %", "success", 100, 1),
    ("  bare 10 % band", "success_bare", 100, 1),
    ("settling, ms", "settling_ms", 1, 1),
    ("failure, %", "failure", 1, 1),
    ("  bare 10 % band", "failure_bare", 1, 1),
    ("rise, ms", "rise_ms", 1, 1),
    ("peak, %", "peak", 1, 1),
    ("error, rad/s", "error", 1, 1),
    ("stability, deg/s²", "stability", 1, 2),
    ("  slope, rad/s²", "slope", 1, 4),
    ("in band, 500 ms+, %", "in_band_500", 100, 1),
    ("in band, 750 ms+, %", "in_band_750", 100, 1),
    ("  bare, 500 ms+, %", "in_band_500_bare", 100, 1),
    ("  bare, 750 ms+, %", "in_band_750_bare", 100, 1),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "controller",
        nargs="?",
        metavar=CONTENDER,
        help="a policy, a PID of the aircraft file, or Betaflight; none with --on betaflight",
    )
    add_condition_arguments(parser, episodes=100)
    parser.add_argument(
        "--throttle",
        type=float,
        metavar="T",
        help="pilot's thrust, 0..1; default: 0.3 in flights, as recorded with --commands, else 0",
    )
    parser.add_argument(
        "--battery",
        type=float,
        nargs="?",
        const=1.0,
        metavar="CHARGE",
        help="fly on the aircraft's battery, charged so far, 0..1 (1); default: the bench supply",
    )
    add_contender_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Fly all commands at once and print the figures."""
    from neuroflight.toolchain.errors import TrainingError

    if (args.controller is None) == (args.on is None):
        raise TrainingError("expected one controller: a policy, pid, pid:NAME, or betaflight")
    check_ranges(("--throttle", args.throttle, 0.0, 1.0), ("--battery", args.battery, 0.0, 1.0))
    check_thrusts(args)
    given = replace(conditions(args), charge=args.battery)
    with open_contenders(args, _words(args), given) as (contenders, flown):
        if args.thrust is not None:
            return _at_thrusts(args, contenders, flown)
        return _at_throttle(args, contenders[0], flown)


def _at_thrusts(args: argparse.Namespace, contenders: Sequence[Contender], flown: Conditions) -> int:
    from rich.console import Console

    from neuroflight.cli.training.evaluation.thrust import documents, print_equal_thrust
    from neuroflight.toolchain.errors import TrainingError
    from neuroflight.training.evaluation.equal_thrust import equal_thrust

    if args.plot:
        raise TrainingError("--plot: `neuroflight compare --thrust` draws; leave it out")
    with progress_bars(args) as bar:
        found = equal_thrust(contenders, flown, args.thrust, bar)
    if args.json:
        told = command("evaluate", args, flown, *_words(args), throttle=None)
        document = {"command": told, **conditions_document(args, flown), **documents(found)}
        print(json.dumps(document, indent=2))
    else:
        print_equal_thrust(
            Console(), f"{flown.aircraft.name}: {flown_words(flown)}", found, flight_note(flown)
        )
    return 0


def _words(args: argparse.Namespace) -> list[str]:
    return [] if args.controller is None else [args.controller]


def _at_throttle(args: argparse.Namespace, controller: Contender, flown: Conditions) -> int:
    from neuroflight.sim.analysis.response_plot import draw
    from neuroflight.sim.analysis.spectrum_plot import Line
    from neuroflight.sim.plotting import save_png
    from neuroflight.training.evaluation.comparison import as_flown
    from neuroflight.training.evaluation.evaluation import summary
    from neuroflight.training.evaluation.floor import scored
    from neuroflight.training.evaluation.tracking_plot import Tracked, draw_long, draw_step

    throttle = default_throttle(flown) if args.throttle is None else args.throttle
    with progress_bars(args) as bar:
        flights = flown.fly(controller, throttle, bar(f"{commands_flown(flown)} commands"))
    result = summary(scored(flights, controller, flown))
    title = f"{controller.name} on {flown.aircraft.name}: {flown_words(flown)}"
    held = flights.hold()
    if args.plot and drawn_as_flown(flown):
        tracked = Tracked(controller.label, *as_flown(flights))
        save_png(args.plot, draw_step([tracked], title) if held else draw_long([tracked], title))
    elif args.plot and held and result.response:
        line = Line(controller.label, result.spectrum, result.smoothness)
        save_png(args.plot, draw(held, result.response, line, title))
    elif args.plot:
        print(f"--plot: {args.plot} is not drawn: no command is held for a second", file=sys.stderr)
    if args.json:
        document = {
            "command": command(
                "evaluate", args, flown, *_words(args), throttle=told_throttle(flown, [throttle])
            ),
            **conditions_document(args, flown),
            **flight_document(controller, throttle, result),
        }
        print(json.dumps(document, indent=2))
    else:
        _print(title, result, flight_note(flown))
    return 0


def _print(title: str, result: Evaluation, more: str) -> None:
    """Print the figures; more: words for the note."""
    from rich.console import Console
    from rich.table import Table

    from neuroflight.toolchain.contract import AXES

    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    for heading in ("", *AXES, "mean"):
        table.add_column(heading, justify="right" if heading else "left", no_wrap=True)
    margins = asdict(result.tracking_margin)
    for name, values in asdict(result.tracking).items():
        digits = 2 if name == "mae" else 0
        cells = [
            _number(value, digits) + (f" ± {_number(margin, digits)}" if margin > 0.0 else "")
            for value, margin in zip(values, margins[name], strict=True)
        ]
        table.add_row(name.upper(), *cells, _number(values.mean(), digits))
    if result.holding:
        _add_holding(table, result.holding)
    if result.response:
        _add_response(table, result)
    console = Console()
    console.print(table)
    if result.holding:
        aged = ", ".join(f"{value:.2f}" for value in result.holding.mae.value)
        console.print(f"MAE by age, of {len(result.holding.mae.value)} equal parts before the hover: {aged}")
    effort, margin = result.effort, result.effort_margin
    console.print(
        f"mean output ū {with_margin(effort.output, margin.output, 4)}, "
        f"mean |Δu| in 1 ms {with_margin(effort.change, margin.change, 5)}, {_motors(result)}"
        f"Sm {with_margin(1e6 * result.smoothness, 1e6 * result.smoothness_margin, 1)} x 1e-6, "
        f"worst MAE of a command and axis {result.worst_mae:.1f} deg/s"
    )
    if result.mae_least and result.mse_least:
        mae, mse = (float(values.mean()) for values in (result.tracking.mae, result.tracking.mse))
        console.print(
            f"least that any motors could leave: MAE {result.mae_least:.2f}, this is "
            f"{100 * (mae / result.mae_least - 1):.0f} % above it; MSE {result.mse_least:.1f}, "
            f"{100 * (mse / result.mse_least - 1):.0f} % above it"
        )
    note = "Errors in deg/s against the true rate; ± is 95 % confidence of the mean."
    if result.response:
        floor = f"{result.response.floor_deg_s:g} deg/s"
        note += (
            f" The band is 10 % of the initial error or {floor}, whichever is wider; rise, peak and failure "
            f"leave out initial errors below {floor}. Every sample: from 500 to 1500 ms after the command, "
            f"or to its end."
        )
    note += more
    if result.episodes == 1:
        note += ONE_EPISODE
    console.print(note, style="dim")


def _add_holding(table: Table, found: HoldingFigures) -> None:
    rest = found.rest
    rows = [
        (f"rest, fifth {n + 1}", 2, *(part[n] for part in (rest.value, rest.low, rest.high, rest.count)))
        for n in range(len(rest.value))
    ]
    for heading, mean, digits in (("hover", found.hover, 2), ("drift, °", found.drift, 1)):
        rows.append((heading, digits, mean.value, mean.low, mean.high, mean.count))
    for heading, digits, value, low, high, count in rows:
        cells = [
            with_margin(value[axis], (high - low)[axis] / 2, digits) if count[axis] else "none"
            for axis in range(3)
        ]
        table.add_row(heading, *cells, f"{value.mean():.{digits}f}" if count.all() else "none")


def _motors(result: Evaluation) -> str:
    change = result.motor_change
    if change is None:
        return ""
    return f"of motors {with_margin(float(change.value), float(change.high - change.value), 5)}, "


def _add_response(table: Table, result: Evaluation) -> None:
    import numpy as np

    for heading, name, factor, digits in RESPONSE_ROWS:
        mean: Mean = getattr(result.response, name)
        cells = []
        for axis in range(3):
            value, low, high = (factor * part[axis] for part in (mean.value, mean.low, mean.high))
            known = mean.count[axis] > 0
            cells.append(with_margin(value, (high - low) / 2, digits) if known else "none")
        some = mean.count > 0
        average = f"{factor * np.mean(mean.value[some]):.{digits}f}" if some.any() else "none"
        table.add_row(heading, *cells, average)
    for heading, name in ALL_ROWS:
        share: Mean = getattr(result.response, name)
        table.add_row(heading, "", "", "", f"{100 * share.value:.1f}")


def _number(value: float, digits: int) -> str:
    """A number; large sums with an exponent, in at most seven characters."""
    if value < 1e5:
        return f"{value:,.{digits}f}"
    mantissa, exponent = f"{value:.2e}".split("e")
    return f"{mantissa}e{int(exponent)}"
