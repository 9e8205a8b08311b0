"""neuroflight tune-betaflight: settings of Betaflight for an aircraft, by the search that finds a PID's."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sim.aircraft.model import Aircraft
    from sim.ports.betaflight.build import Betaflight
    from training.evaluation.evaluation import Evaluation
    from training.pid_tuning.betaflight_tuning import Limits, Settings, Tuning

USUAL: dict[str, float] = {"commands": 12, "budget": 720, "max_change": 0.0045, "throttle_max": 0.8}
CHECKED = 100
COMMANDS_MAX, CHECKED_MAX = 100, 500  # a Betaflight each, and candidates of a generation at a time
BUDGET_MAX = 100_000
DEFAULTS, TUNED = "defaults", "tuned"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("--aircraft", default="nf1", metavar="NAME|FILE", help="shipped name or a .toml file")
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="of commands, noise and search")
    parser.add_argument(
        "--commands",
        type=int,
        default=USUAL["commands"],
        metavar="N",
        help="pulses that each candidate flies",
    )
    parser.add_argument(
        "--budget", type=int, default=USUAL["budget"], metavar="N", help="candidates to try, about"
    )
    parser.add_argument(
        "--check", type=int, default=CHECKED, metavar="N", help="unseen pulses for the final figures"
    )
    parser.add_argument(
        "--max-change",
        type=float,
        default=USUAL["max_change"],
        metavar="DU",
        help="mean |change| of a motor value in 1 ms",
    )
    parser.add_argument(
        "--throttle-max",
        type=float,
        default=USUAL["throttle_max"],
        metavar="T",
        help="commands are flown at throttles from 0 to T, each at one",
    )
    parser.add_argument(
        "--write",
        type=Path,
        metavar="FILE.txt",
        help="keep the settings, for `betaflight:FILE.txt` and for the command line of Betaflight's app",
    )
    parser.add_argument(
        "--build", type=Path, metavar="DIR", help="Betaflight's build; default: build/BETAFLIGHT"
    )
    parser.add_argument("--json", action="store_true", help="print JSON instead of tables")


def run(args: argparse.Namespace) -> int:
    """Tune, fly unseen commands, write and print. Returns 1 where nothing better keeps the limit."""
    _check(args)

    from cli.sim.fly_ports import built_betaflight
    from sim.aircraft.model import load_aircraft
    from sim.ports.betaflight.tune import tune_text
    from toolchain.files import write_text
    from training.pid_tuning.betaflight_tuning import Limits

    aircraft = load_aircraft(args.aircraft)
    built = built_betaflight(args, aircraft)
    limits = Limits(args.max_change, args.throttle_max)
    tuning = _tune(args, built, aircraft, limits)
    if tuning.interrupted:
        print(f"interrupted after {len(tuning.trials)} candidates; the best is kept", file=sys.stderr)
    checked = _fly_unseen(args, built, aircraft, limits, tuning.best.settings)
    if args.write and tuning.best.settings:
        write_text(args.write, tune_text(tuning.best.settings, _comment(args, tuning, checked)))
    if args.json:
        print(json.dumps(_document(args, aircraft, tuning, checked), indent=2))
    else:
        _print(args, aircraft, tuning, checked)
    if not tuning.best.settings:
        print("nothing was found that beats Betaflight's defaults; try a larger --budget", file=sys.stderr)
        return 1
    if checked[TUNED].effort.change > limits.change:
        print(
            f"the motors change by {checked[TUNED].effort.change:.4f} in 1 ms, more than {limits.change:g}; "
            "try a larger --budget or a wider limit",
            file=sys.stderr,
        )
        return 1
    return 0


def _check(args: argparse.Namespace) -> None:
    """Check the arguments before anything is flown. Raises NeuroflightError."""
    from cli.output import check_output
    from cli.training.evaluation.ranges import check_ranges

    check_ranges(
        ("--seed", args.seed, 0, 2**32 - 1),
        ("--commands", args.commands, 2, COMMANDS_MAX),
        ("--budget", args.budget, 1, BUDGET_MAX),
        ("--check", args.check, 1, CHECKED_MAX),
        ("--max-change", args.max_change, 1e-4, 1.0),
        ("--throttle-max", args.throttle_max, 0.0, 1.0),
    )
    check_output(args.write, ".txt")


def _tune(args: argparse.Namespace, built: Betaflight, aircraft: Aircraft, limits: Limits) -> Tuning:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    from training.pid_tuning.betaflight_tuning import Trial, tune_betaflight

    columns = (TextColumn("{task.description:<36}"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("Betaflight's defaults", total=args.budget)

        def show(flown: int, best: Trial) -> None:
            figures = f"MAE {best.mae:.2f}  |Δu| {best.change:.4f}"
            bar.update(task, completed=min(flown, args.budget), description=f"search  {figures}")

        return tune_betaflight(
            built,
            aircraft,
            limits,
            seed=args.seed,
            commands=args.commands,
            budget=args.budget,
            progress=show,
        )


def _fly_unseen(
    args: argparse.Namespace, built: Betaflight, aircraft: Aircraft, limits: Limits, best: Settings
) -> dict[str, Evaluation]:
    """Figures of the defaults and of the settings on unseen commands; the change is that of the motors."""
    from dataclasses import replace

    import numpy as np

    from sim.ports.betaflight.fleet import ArmedBetaflight
    from training.evaluation.betaflight import record_betaflight
    from training.evaluation.evaluation import figures
    from training.pid_tuning.betaflight_tuning import as_tune
    from training.pid_tuning.trial import throttles
    from training.tasks.task import PulseTask

    thrust = throttles(args.check, limits.throttle_max, np.random.default_rng(args.seed))
    checked = {}
    for name, tune in ((DEFAULTS, None), (TUNED, as_tune(best) if best else None)):
        with ArmedBetaflight(built, aircraft, tune) as armed:
            flights = record_betaflight(
                (armed,), aircraft, PulseTask(), episodes=args.check, seed=args.seed, throttle=thrust
            )
        evaluation = figures(flights)
        assert evaluation.motor_change is not None
        change = float(evaluation.motor_change.value)
        checked[name] = replace(evaluation, effort=replace(evaluation.effort, change=change))
    return checked


def _comment(args: argparse.Namespace, tuning: Tuning, checked: dict[str, Evaluation]) -> list[str]:
    """What stands above the settings in their file."""
    told = [f"Found by `{_command(args)}`."]
    if tuning.interrupted:
        told.append(f"Interrupted after {len(tuning.trials)} candidates.")
    told.append(f"{args.check:,} unseen pulses at throttles from 0 to {args.throttle_max:g}:")
    told += [
        f"{name}: MAE {each.tracking.mae.mean():.2f} deg/s, MSE {each.tracking.mse.mean():.0f}, mean change "
        f"of the motor values in 1 ms {each.effort.change:.4f}"
        for name, each in checked.items()
    ]
    return told


def _command(args: argparse.Namespace) -> str:
    """The command that finds the same settings: options that decide them, if not the default."""
    from cli.output import command_line

    given = {name: getattr(args, name) for name, usual in USUAL.items() if getattr(args, name) != usual}
    return command_line("tune-betaflight", aircraft=Path(args.aircraft).name, seed=args.seed, **given)


def _document(
    args: argparse.Namespace, aircraft: Aircraft, tuning: Tuning, checked: dict[str, Evaluation]
) -> dict[str, object]:
    """The whole result as JSON data."""
    return {
        "command": _command(args),
        "aircraft": aircraft.name,
        "aircraft_sha256": aircraft.sha256,
        "seed": args.seed,
        "commands": args.commands,
        "candidates": len(tuning.trials),
        "interrupted": tuning.interrupted,
        "max_change": args.max_change,
        "throttle_max": args.throttle_max,
        "settings": dict(tuning.best.settings),
        "unseen": args.check,
        "figures": {
            name: {
                "mae": list(each.tracking.mae),
                "mse": list(each.tracking.mse),
                "change": each.effort.change,
            }
            for name, each in checked.items()
        },
    }


def _print(
    args: argparse.Namespace, aircraft: Aircraft, tuning: Tuning, checked: dict[str, Evaluation]
) -> None:
    """Settings and figures."""
    from cli.output import print_table

    rows: list[tuple[str, ...]] = [("", "MAE", "MSE", "|Δu|")]
    rows += [
        (
            f"Betaflight 4.6, {name}",
            f"{each.tracking.mae.mean():.3f}",
            f"{each.tracking.mse.mean():.1f}",
            f"{each.effort.change:.4f}",
        )
        for name, each in checked.items()
    ]
    under = f"throttles to {args.throttle_max:g}, seed {args.seed}"
    print_table(
        f"{aircraft.name}: {args.check:,} unseen pulses at {under}",
        rows,
        "Errors: mean of the axes against the true rate, deg/s; |Δu|: mean change of a motor value in 1 ms.",
    )
    for name, value in tuning.best.settings.items():
        print(f"set {name} = {value}")
    if args.write and tuning.best.settings:
        print(
            f"\n{args.write}: fly it as betaflight:{args.write}, or paste it into Betaflight's command line"
        )
