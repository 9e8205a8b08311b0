"""`neuroflight tune-pid --of betaflight`: settings of Betaflight for an aircraft, by a PID's search."""

from __future__ import annotations

import argparse
import json
import sys
from typing import TYPE_CHECKING

from cli.training.tune_pid_report import (
    BETAFLIGHT,
    FLYING,
    add_errors,
    command,
    figures_document,
    figures_told,
    flights_told,
)
from cli.training.tune_pid_search import by_thrust, final_flights, flights_bar, search_bar
from toolchain.errors import TrainingError

if TYPE_CHECKING:
    from sim.aircraft.model import Aircraft
    from sim.ports.betaflight.build import Betaflight
    from training.evaluation.evaluation import Evaluation
    from training.pid_tuning.betaflight_tuning import Settings, Tuning

    Checked = dict[str, dict[str, Evaluation]]  # by settings, then by thrust

DEFAULTS, TUNED = "defaults", "tuned"
CHECKED_MAX = 500  # commands at each thrust: a Betaflight for each flight at a time
OF_A_PID = ("max_output", "max_idle", "name", "plot")  # options that say nothing of Betaflight


def check_betaflight(args: argparse.Namespace) -> None:
    """Refuse options of a PID's search and fill in the defaults. Raises NeuroflightError."""
    from cli.output import check_output
    from cli.training.evaluation.ranges import check_ranges
    from training.pid_tuning.flying import CHANGE

    if args.terms != FLYING:
        raise TrainingError(f"--terms {args.terms}: of a PID's search; Betaflight's is by flying terms")
    for name in OF_A_PID:
        if getattr(args, name) is not None:
            raise TrainingError(f"--{name.replace('_', '-')}: of a PID's search; leave it out")
    args.check = 50 if args.check is None else args.check
    check_ranges(("--check", args.check, 1, CHECKED_MAX))
    check_output(args.write, ".txt")
    args.limit = CHANGE if args.max_change is None else args.max_change


def tune_betaflight_of(args: argparse.Namespace, aircraft: Aircraft) -> int:
    """Tune, fly unseen commands, write and print. Returns 1 where nothing better keeps the limit."""
    from cli.sim.fly_ports import built_betaflight
    from sim.ports.betaflight.tune import tune_text
    from toolchain.files import write_text
    from training.pid_tuning.betaflight_tuning import tune_betaflight

    built = built_betaflight(args, aircraft)
    with search_bar(args.budget, "Betaflight's defaults") as show:
        tuning = tune_betaflight(
            built, aircraft, args.limit, seed=args.seed, budget=args.budget, progress=show
        )
    if tuning.interrupted:
        print(f"interrupted after {len(tuning.trials)} candidates; the best is kept", file=sys.stderr)
    checked = _fly_unseen(args, built, aircraft, tuning.best.settings)
    if args.write and tuning.best.settings:
        write_text(args.write, tune_text(tuning.best.settings, _comment(args, tuning, checked)))
    if args.json:
        print(json.dumps(_document(args, aircraft, tuning, checked), indent=2))
    else:
        _print(args, aircraft, tuning, checked)
    if not tuning.best.settings:
        print("nothing was found that beats Betaflight's defaults; try a larger --budget", file=sys.stderr)
        return 1
    change = max(each.effort.change for each in checked[TUNED].values())
    if change > args.limit:
        print(
            f"the motors change by {change:.4f} in 1 ms, more than {args.limit:g}; try a larger --budget or "
            "a wider limit",
            file=sys.stderr,
        )
        return 1
    return 0


def _fly_unseen(args: argparse.Namespace, built: Betaflight, aircraft: Aircraft, best: Settings) -> Checked:
    """Return the figures of the defaults and of the settings in the flights of a PID's check."""
    from sim.ports.betaflight.fleet import ArmedBetaflight
    from sim.ports.betaflight.port import IDLE
    from training.evaluation.betaflight import record_betaflight
    from training.pid_tuning.betaflight_tuning import as_tune

    task, throttle = final_flights(aircraft, IDLE, args.check)
    checked: Checked = {}
    with flights_bar() as bar:
        for name, tune in ((DEFAULTS, None), (TUNED, as_tune(best) if best else None)):
            show = bar(f"{name}: {args.check} unseen commands at each thrust")
            with ArmedBetaflight(built, aircraft, tune) as armed:
                flown = record_betaflight(
                    (armed,),
                    aircraft,
                    task,
                    episodes=len(throttle),
                    seed=args.seed,
                    throttle=throttle,
                    progress=show,
                )
            checked[name] = by_thrust(flown)
    return checked


def _comment(args: argparse.Namespace, tuning: Tuning, checked: Checked) -> list[str]:
    """Return what stands above the settings in their file."""
    told = [f"Found by `{command(args)}`."]
    if tuning.interrupted:
        told.append(f"Interrupted after {len(tuning.trials)} candidates.")
    told.append(flights_told(args, checked[DEFAULTS]))
    return [*told, *(f"{name}: {figures_told(each)}" for name, each in checked.items())]


def _document(
    args: argparse.Namespace, aircraft: Aircraft, tuning: Tuning, checked: Checked
) -> dict[str, object]:
    """Return the whole result as JSON data."""
    return {
        "command": command(args),
        "of": BETAFLIGHT,
        "aircraft": aircraft.name,
        "aircraft_sha256": aircraft.sha256,
        "seed": args.seed,
        "candidates": len(tuning.trials),
        "interrupted": tuning.interrupted,
        "limits": {"change": args.limit, "change_of": "motors"},
        "settings": dict(tuning.best.settings),
        "unseen": args.check,
        "figures": {
            name: {thrust: figures_document(each) for thrust, each in of_thrusts.items()}
            for name, of_thrusts in checked.items()
        },
    }


def _print(args: argparse.Namespace, aircraft: Aircraft, tuning: Tuning, checked: Checked) -> None:
    """Settings and figures, as a PID's."""
    from rich.console import Console
    from rich.table import Table

    console = Console()
    for name, of_thrusts in checked.items():
        what = f"{args.check:,} unseen commands each, five in a flight, seed {args.seed}"
        table = Table(title=f"Betaflight 4.6, {name}: {what}", title_justify="left")
        for heading in ("", *of_thrusts):
            table.add_column(heading, justify="right" if heading else "left")
        add_errors(table, of_thrusts)
        changes = (f"{each.effort.change:.4f}" for each in of_thrusts.values())
        table.add_row("mean |Δu| of the motor values in 1 ms", *changes)
        console.print(table)
    for setting, value in tuning.best.settings.items():
        print(f"set {setting} = {value}")
    if args.write and tuning.best.settings:
        print(
            f"\n{args.write}: fly it as betaflight:{args.write}, or paste it into Betaflight's command line"
        )
