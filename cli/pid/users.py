"""`neuroflight pid tune --of FILE.py:CLASS`: parameters of a user's own controller, by a PID's search."""

from __future__ import annotations

import argparse
import json
import sys
from typing import TYPE_CHECKING, Any

from neuroflight.cli.pid.report import (
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
    from neuroflight.training.evaluation.evaluation import Evaluation
    from neuroflight.training.evaluation.users_controller import UsersController
    from neuroflight.training.pid_tuning.users_tuning import Tuning, Values

    Checked = dict[str, dict[str, Evaluation]]  # by values, then by thrust


def tune_users_of(args: argparse.Namespace, aircraft: Aircraft) -> int:
    """Tune, fly unseen commands, write and print. Returns 1 where the limit is not kept."""
    from neuroflight.toolchain.files import write_text
    from neuroflight.training.evaluation.users_controller import load_users_controller, values_text
    from neuroflight.training.pid_tuning.users_tuning import check_names, tune_users

    controller = load_users_controller(args.of)
    names = list(args.parameters or controller.parameters)
    check_names(controller, names)
    with search_bar(args.budget, "as its class says") as show:
        tuning = tune_users(
            controller,
            aircraft,
            args.limit,
            names=names,
            seed=args.seed,
            budget=args.budget,
            progress=show,
            tuner=chosen_tuner(args),
        )
    if tuning.interrupted:
        print(f"interrupted after {len(tuning.trials)} candidates; the best is kept", file=sys.stderr)
    checked = _fly_unseen(args, controller, aircraft, tuning)
    if args.write:
        told = [f"Found by `{command(args)}`.", flights_told(args, checked[DEFAULTS])]
        told += [f"{name}: {figures_told(each)}" for name, each in checked.items()]
        write_text(args.write, values_text(tuning.best.values, "\n".join(told)))
    if args.json:
        print(json.dumps(_document(args, aircraft, controller, tuning, checked), indent=2))
    else:
        _print(args, controller, tuning, checked)
    return keeps_limit(args, checked[TUNED])


def _fly_unseen(
    args: argparse.Namespace, controller: UsersController, aircraft: Aircraft, tuning: Tuning
) -> Checked:
    """Return the figures as the class says and as found, in the flights of a PID's check."""
    from neuroflight.training.evaluation.evaluation import record

    task, throttle = final_flights(aircraft, controller.idle, args.check)
    both: dict[str, Values] = {DEFAULTS: controller.values, TUNED: tuning.best.values}
    checked: Checked = {}
    with flights_bar() as bar:
        for name, values in both.items():
            flown = record(
                controller.build(aircraft, len(throttle), values),
                aircraft,
                task,
                episodes=len(throttle),
                seed=args.seed,
                control_rate_hz=controller.control_rate_hz,
                throttle=throttle,
                idle=controller.idle,
                mix=controller.mix,
                gyro_mean=controller.gyro_mean,
                progress=bar(f"{name}: {args.check} unseen commands at each thrust"),
            )
            checked[name] = by_thrust(flown)
    return checked


def _document(
    args: argparse.Namespace,
    aircraft: Aircraft,
    controller: UsersController,
    tuning: Tuning,
    checked: Checked,
) -> dict[str, Any]:
    """Return the whole result as JSON data."""
    return {
        "command": command(args),
        "of": controller.name,
        "file_sha256": controller.sha256,
        "aircraft": aircraft.name,
        "aircraft_sha256": aircraft.sha256,
        "seed": args.seed,
        "candidates": len(tuning.trials),
        "interrupted": tuning.interrupted,
        "limits": {"change": args.limit, "change_of": "motors"},
        "costs": {DEFAULTS: tuning.start.cost, TUNED: tuning.best.cost},
        "parameters": dict(tuning.best.values),
        "unseen": args.check,
        "figures": {
            name: {thrust: figures_document(each) for thrust, each in of_thrusts.items()}
            for name, of_thrusts in checked.items()
        },
    }


def _print(args: argparse.Namespace, controller: UsersController, tuning: Tuning, checked: Checked) -> None:
    """Print values and figures, as a PID's."""
    from rich.console import Console

    for name, of_thrusts in checked.items():
        print_thrusts(Console(), f"{controller.name}, {name}", args, of_thrusts)
    for name, value in tuning.best.values.items():
        print(f"{name} = {value!r}")
    if args.write:
        print(f"\n{args.write}: fly it as {controller.name}:{args.write}")
