"""neuroflight evaluate: figures of a policy or the PID on unseen commands in the twin."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("controller", help="a policy.onnx, or 'pid' for the aircraft file's gains")
    parser.add_argument("--aircraft", default="nf1", help="shipped name or path of a .toml file")
    parser.add_argument("--episodes", type=int, default=100, help="commands, one aircraft each")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--mount", choices=["centre", "rig", "free"], default="centre")
    parser.add_argument("--throttle", type=float, default=0.0, help="pilot's thrust, 0..1")
    parser.add_argument("--no-noise", action="store_true", help="an ideal gyro")
    parser.add_argument("--json", action="store_true")


def run(args: argparse.Namespace) -> int:
    """Fly all commands at once and print the figures."""
    from rich.console import Console
    from rich.progress import Progress
    from rich.table import Table

    from sim.aircraft import load_aircraft
    from sim.controller import Controller, PolicyController
    from sim.pid import aircraft_pid
    from sim.world import COUNT_MAX, Mount
    from toolchain.contract import AXES
    from toolchain.errors import PolicyError, TrainingError
    from toolchain.network import read_policy
    from training.evaluation import evaluate

    aircraft = load_aircraft(args.aircraft)
    if not 1 <= args.episodes <= COUNT_MAX:
        raise TrainingError(f"--episodes {args.episodes}, expected 1 to {COUNT_MAX}")
    if not 0.0 <= args.throttle <= 1.0:
        raise TrainingError(f"--throttle {args.throttle}, expected 0 to 1")
    if args.seed < 0:
        raise TrainingError(f"--seed {args.seed}, expected 0 or more")
    controller: Controller
    if args.controller == "pid":
        rate_hz = 1000
        controller = aircraft_pid(aircraft, args.episodes, rate_hz)
    else:
        policy = read_policy(Path(args.controller))
        if policy.action_count != aircraft.motor_count:
            raise PolicyError(
                f"{args.controller} drives {policy.action_count} motors, aircraft {aircraft.name} has "
                f"{aircraft.motor_count}; evaluate it on an aircraft it was trained for"
            )
        rate_hz = policy.control_rate_hz
        controller = PolicyController(policy, args.episodes, exact=False)
    console = Console(stderr=args.json)
    with Progress(console=console, transient=True) as bar:
        task = bar.add_task(f"{args.episodes} commands")
        result = evaluate(
            controller,
            aircraft,
            episodes=args.episodes,
            seed=args.seed,
            control_rate_hz=rate_hz,
            mount=Mount(args.mount),
            noise=not args.no_noise,
            throttle=args.throttle,
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        )
    figures = {name: list(values) for name, values in asdict(result.tracking).items()}
    if args.json:
        print(
            json.dumps(
                {
                    "controller": args.controller,
                    "aircraft": aircraft.name,
                    "episodes": result.episodes,
                    "seed": args.seed,
                    **figures,
                    "worst_mae": result.worst_mae,
                    "output": result.effort.output,
                    "change": result.effort.change,
                }
            )
        )
        return 0
    table = Table(title=f"{args.controller} on {aircraft.name}: {result.episodes} commands, seed {args.seed}")
    for heading in ("", *AXES, "average"):
        table.add_column(heading, justify="right" if heading else "left")
    for name, values in figures.items():
        mean = sum(values) / len(values)
        table.add_row(name.upper(), *(f"{value:,.2f}" for value in (*values, mean)))
    console.print(table)
    console.print(
        f"errors in deg/s against the true rate; worst MAE of a command and axis {result.worst_mae:.1f}; "
        f"mean output {result.effort.output:.3f}; mean |Δu| a millisecond {result.effort.change:.4f}"
    )
    return 0
