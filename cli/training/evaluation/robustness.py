"""neuroflight robustness: errors of controllers on aircraft whose parameters differ from their file."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from neuroflight.cli.output import with_margin
from neuroflight.cli.training.evaluation.conditions import MOUNTS, check_controllers, progress_bars
from neuroflight.cli.training.evaluation.foreign import say_foreign
from neuroflight.cli.training.evaluation.ranges import check_ranges

if TYPE_CHECKING:
    from rich.console import Console

    from neuroflight.training.evaluation.robustness import CaseResult, JointResult, Plan, Robustness

COLUMN = 34  # [characters], of a controller
EPISODES = {"flight": 50, "pulse": 200}  # commands of a case by task, the first unless the user says
DRAWS = {"flight": 100, "pulse": 200}
FLIGHTS_MAX = 300  # at once, in memory: a gigabyte
THROTTLE_MAX = 0.8


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "controllers",
        nargs="+",
        metavar="POLICY.onnx|pid[:NAME]",
        help="policies, or PIDs of the aircraft file, each at its own idle",
    )
    parser.add_argument("--aircraft", default="nf1", metavar="NAME|FILE", help="shipped name or a .toml file")
    parser.add_argument(
        "--task",
        choices=tuple(EPISODES),
        default="flight",
        help="five commands one after another and a hover, or single ones; default: flight",
    )
    parser.add_argument(
        "--episodes",
        type=int,
        metavar="N",
        help=f"commands a case; default: {EPISODES['flight']} in flights, {EPISODES['pulse']} single ones",
    )
    parser.add_argument(
        "--seed", type=int, default=0, metavar="S", help="of commands, throttle, noise, draws"
    )
    parser.add_argument(
        "--throttle-max",
        type=float,
        default=THROTTLE_MAX,
        metavar="T",
        help=f"the pilot's thrust is drawn from 0 to this for each; default: {THROTTLE_MAX:g}",
    )
    parser.add_argument(
        "--draws",
        type=int,
        metavar="N",
        help=f"aircraft with every parameter drawn at once, 5 commands each; default: {DRAWS['flight']} in "
        f"flights, {DRAWS['pulse']} for single ones",
    )
    parser.add_argument("--mount", choices=MOUNTS, default="centre", help="what holds the aircraft")
    parser.add_argument("--no-noise", action="store_true", help="an ideal gyro")
    parser.add_argument("--plot", type=Path, metavar="FILE.png", help="draw ratios of all cases and draws")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")


def run(args: argparse.Namespace) -> int:
    """Fly the plan with each controller and print the results."""
    from rich.console import Console

    from neuroflight.sim.plotting import save_png
    from neuroflight.training.evaluation.controllers import load_controller
    from neuroflight.training.evaluation.robustness import examine
    from neuroflight.training.evaluation.robustness_plot import draw

    plan = _plan(args)
    controllers = [load_controller(name, plan.aircraft) for name in args.controllers]
    say_foreign(controllers)
    with progress_bars(args) as bar:
        results = [examine(controller, plan, bar(controller.label)) for controller in controllers]
    each = "pulses" if plan.commands == 1 else f"flights of {plan.commands} commands and a hover"
    title = (
        f"Robustness on {plan.aircraft.name}: {plan.episodes} {each} a case, throttle 0 to "
        f"{plan.throttle_max:g}, seed {plan.seed}"
    )
    if args.plot:
        save_png(args.plot, draw(results, title))
    if args.json:
        print(json.dumps(_document(args, plan, results), indent=2))
    else:
        # A table wider than the screen is better than a cropped one.
        _print(title, plan, results, Console(width=max(Console().width, COLUMN * (len(results) + 1))))
    return 0


def _plan(args: argparse.Namespace) -> Plan:
    """The plan of the arguments. Raises TrainingError on values outside their range, NaN included."""
    from neuroflight.cli.output import check_output
    from neuroflight.sim.aircraft.model import load_aircraft
    from neuroflight.sim.physics.world import COUNT_MAX, Mount
    from neuroflight.toolchain.errors import TrainingError
    from neuroflight.training.evaluation.robustness import COMMANDS_PER_DRAW, FLIGHT, Plan
    from neuroflight.training.tasks.task import PulseTask

    check_controllers(args.controllers)
    commands = EPISODES[args.task] if args.episodes is None else args.episodes
    draws = DRAWS[args.task] if args.draws is None else args.draws
    flights = args.task == "flight"
    check_ranges(
        ("--episodes", commands, 2, FLIGHTS_MAX * FLIGHT.pulses if flights else COUNT_MAX),
        ("--draws", draws, 0, FLIGHTS_MAX if flights else COUNT_MAX // COMMANDS_PER_DRAW),
        ("--throttle-max", args.throttle_max, 0.0, 1.0),
    )
    if args.seed < 0:
        raise TrainingError(f"--seed {args.seed}, expected 0 or more")
    check_output(args.plot, ".png")
    return Plan(
        aircraft=load_aircraft(args.aircraft),
        task=FLIGHT if flights else PulseTask(),
        episodes=max(2, -(-commands // FLIGHT.pulses)) if flights else commands,
        draws=draws,
        seed=args.seed,
        throttle_max=args.throttle_max,
        mount=Mount(args.mount),
        noise=not args.no_noise,
    )


def _document(args: argparse.Namespace, plan: Plan, results: Sequence[Robustness]) -> dict[str, Any]:
    from neuroflight.cli.output import command_line
    from neuroflight.training.evaluation.robustness import (
        CASE_RATIO_MAX,
        COMMANDS_PER_DRAW,
        HIGH,
        HIGH_RATIO_MAX,
        MEDIAN_RATIO_MAX,
        document,
    )

    command = command_line(
        "robustness",
        *args.controllers,
        aircraft=args.aircraft,
        task=args.task,
        episodes=plan.episodes * plan.commands,
        seed=args.seed,
        throttle_max=args.throttle_max,
        draws=plan.draws,
        mount=args.mount if args.mount != "centre" else None,
        no_noise=args.no_noise,
    )
    return {
        "command": command,
        "aircraft": plan.aircraft.name,
        "aircraft_sha256": plan.aircraft.sha256,
        "robustness": {
            "task": plan.task.name,
            "episodes": plan.episodes * plan.commands,
            "seed": plan.seed,
            "throttle_max": plan.throttle_max,
            "mount": plan.mount.value,
            "noise": plan.noise,
            "delay_s": plan.aircraft.propulsion.delay,
            "draws": plan.draws,
            "commands_per_draw": COMMANDS_PER_DRAW,
            "extremes": {name: bounds for name, bounds in asdict(plan.extremes()).items() if bounds},
            "divergence": plan.divergence,
            "bars": {"case": CASE_RATIO_MAX, "median": MEDIAN_RATIO_MAX, "high": HIGH_RATIO_MAX},
            "high_quantile": HIGH,
            "controllers": [document(result) for result in results],
        },
    }


def _print(title: str, plan: Plan, results: Sequence[Robustness], console: Console) -> None:
    from rich.table import Table

    from neuroflight.sim.physics.world import Mount
    from neuroflight.training.evaluation.robustness import (
        CASE_RATIO_MAX,
        HIGH_RATIO_MAX,
        MEDIAN_RATIO_MAX,
    )

    flights = plan.commands > 1
    table = Table(title=title, title_justify="left", box=None, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column("", no_wrap=True)
    table.add_column("bar", justify="right")
    for result in results:
        table.add_column(result.controller.label, justify="right", no_wrap=True)
        table.add_column("|Δu|", justify="right", no_wrap=True)
        if flights:
            table.add_column("drift, °", justify="right", no_wrap=True)
    first = [result.cases[0] for result in results]
    table.add_row(
        "nominal, MAE deg/s",
        "",
        *_paired(
            [with_margin(float(each.mae.value), float(each.mae.high - each.mae.value), 2) for each in first],
            first,
        ),
    )
    for row in zip(*(result.cases[1:] for result in results), strict=True):
        cells = []
        for each in row:
            lost = f" [{each.diverged} diverged]" if each.diverged else ""
            mark = "" if each.met else "!"
            margin = each.ratio.high - each.ratio.value
            cells.append(f"{mark}{_ratio(float(each.ratio.value))} ± {_ratio(float(margin))}{lost}")
        name = row[0].case.name
        table.add_row(name, f"{CASE_RATIO_MAX:g}", *_paired(cells, row))
    drawn = [result.joint for result in results if result.joint]
    if drawn:
        count = len(drawn[0].ratios)
        for name, bar, means in (
            (f"median of {count} draws", MEDIAN_RATIO_MAX, [each.median for each in drawn]),
            ("95th percentile", HIGH_RATIO_MAX, [each.high for each in drawn]),
        ):
            quantiles = [
                f"{'' if mean.value <= bar else '!'}{_ratio(float(mean.value))} "
                f"({_ratio(float(mean.low))} to {_ratio(float(mean.high))})"
                for mean in means
            ]
            table.add_row(name, f"{bar:g}", *_paired(quantiles, drawn))
        shares = [f"{each.diverged} (≤ {100 * each.diverged_share.high:.1f} %)" for each in drawn]
        blank = [""] * (2 if flights else 1)
        table.add_row("diverged of the draws", "0", *(text for cell in shares for text in (cell, *blank)))
    console.print(table, markup=False)
    drift = " Drift: in degrees in the hover about the worst axis, mean of the flights." if flights else ""
    held = " Held at its centre, an aircraft's mass has no part." if plan.mount is Mount.CENTRE else ""
    console.print(
        f"Ratios of MAE to the nominal aircraft's on the same commands, with 95 % confidence; ! misses its "
        f"bar. Divergence: {plan.divergence}.{drift}{held}",
        style="dim",
        markup=False,
    )


def _paired(cells: Sequence[str], results: Sequence[CaseResult | JointResult]) -> list[str]:
    """Each cell with its |delta u| beside it, and the drift of flights."""
    found = []
    for text, each in zip(cells, results, strict=True):
        found += [text, f"{each.change:.4f}"]
        if each.drift is not None:
            found.append(f"{each.drift:.1f}")
    return found


def _ratio(value: float) -> str:
    return f"{value:.2f}" if value < 100 else f"{value:.3g}"
