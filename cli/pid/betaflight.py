"""`neuroflight pid tune --of betaflight`: settings of Betaflight for an aircraft, by a PID's search."""

from __future__ import annotations

import argparse
import json
import sys
from typing import TYPE_CHECKING

from neuroflight.cli.pid.report import (
    BETAFLIGHT,
    DEFAULTS,
    TUNED,
    command,
    figures_document,
    figures_told,
    flights_told,
    keeps_limit,
    print_thrusts,
)
from neuroflight.cli.pid.search import by_thrust, chosen_tuner, final_flights, flights_bar, search_bar

if TYPE_CHECKING:
    from neuroflight.sim.aircraft.model import Aircraft
    from neuroflight.sim.ports.betaflight.build import Betaflight
    from neuroflight.training.evaluation.evaluation import Evaluation
    from neuroflight.training.pid_tuning.betaflight_tuning import Settings, Tuning

    Checked = dict[str, dict[str, Evaluation]]  # by settings, then by thrust


def tune_betaflight_of(args: argparse.Namespace, aircraft: Aircraft) -> int:
    """Tune, fly unseen commands, write and print. Returns 1 where nothing better keeps the limit."""
    from neuroflight.cli.fly.ports import built_betaflight
    from neuroflight.sim.ports.betaflight.tune import tune_text
    from neuroflight.toolchain.files import write_text
    from neuroflight.training.pid_tuning.betaflight_tuning import tune_betaflight

    built = built_betaflight(args, aircraft)
    with search_bar(args.budget, "Betaflight's defaults") as show:
        tuning = tune_betaflight(
            built,
            aircraft,
            args.limit,
            seed=args.seed,
            budget=args.budget,
            progress=show,
            tuner=chosen_tuner(args),
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
    return keeps_limit(args, checked[TUNED])


def _fly_unseen(args: argparse.Namespace, built: Betaflight, aircraft: Aircraft, best: Settings) -> Checked:
    """Return the figures of the defaults and of the settings in the flights of a PID's check."""
    from neuroflight.sim.ports.betaflight.fleet import ArmedBetaflight
    from neuroflight.sim.ports.betaflight.port import IDLE
    from neuroflight.training.evaluation.betaflight import record_betaflight
    from neuroflight.training.pid_tuning.betaflight_tuning import as_tune

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
    """Return the comment above the settings in their file."""
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
    """Print settings and figures, as for a PID."""
    from rich.console import Console

    for name, of_thrusts in checked.items():
        print_thrusts(Console(), f"Betaflight 4.6, {name}", args, of_thrusts)
    for setting, value in tuning.best.settings.items():
        print(f"set {setting} = {value}")
    if args.write and tuning.best.settings:
        print(
            f"\n{args.write}: fly it as betaflight:{args.write}, or paste it into Betaflight's command line"
        )
