"""Shared by the commands that fly controllers in the twin: arguments, their checks, documents."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from neuroflight.cli.training.evaluation.ranges import check_ranges
from neuroflight.cli.training.evaluation.task_arguments import (
    add_task_arguments,
    commands_flown,
    default_throttle,
    task_document,
    task_name,
    task_of,
)
from neuroflight.cli.training.plugins import words as plugin_words

if TYPE_CHECKING:
    from neuroflight.training.evaluation.controllers import Conditions, Contender
    from neuroflight.training.evaluation.evaluation import Evaluation

MOUNTS = ("centre", "rig", "free")
DELAY_MAX_S = 0.1
IDLE_MAX = 0.5
THROTTLES_MAX = 20
CONTROLLERS_MAX = 8  # distinguishable colours, and columns that fit
ONE_EPISODE = " A single flight gives no confidence, so no ± is told."


def add_condition_arguments(parser: argparse.ArgumentParser, episodes: int) -> None:
    """The conditions that are the same for all controllers; `episodes` is the default number."""
    parser.add_argument("--aircraft", default="nf1", metavar="NAME|FILE", help="shipped name or a .toml file")
    add_task_arguments(parser, episodes)
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="of commands, noise and bias")
    parser.add_argument("--mount", choices=MOUNTS, default="centre", help="what holds the aircraft")
    parser.add_argument("--no-noise", action="store_true", help="an ideal gyro")
    parser.add_argument(
        "--delay", type=float, metavar="SECONDS", help="from command to rotor; default: the aircraft's"
    )
    parser.add_argument(
        "--idle", type=float, metavar="U", help="motor fraction at no thrust; default: the controller's own"
    )
    parser.add_argument("--plot", type=Path, metavar="FILE.png", help="draw the responses")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")


def conditions(args: argparse.Namespace) -> Conditions:
    """The conditions of the arguments. Raises TrainingError on values outside their range, NaN included."""
    from neuroflight.cli.output import check_output
    from neuroflight.sim.aircraft.model import load_aircraft
    from neuroflight.sim.physics.world import Mount
    from neuroflight.toolchain.errors import TrainingError
    from neuroflight.training.evaluation.controllers import Conditions

    if args.seed < 0:
        raise TrainingError(f"--seed {args.seed}, expected 0 or more")
    if args.delay is not None and not 0.0 <= args.delay <= DELAY_MAX_S:
        raise TrainingError(f"--delay {args.delay}, expected 0 to {DELAY_MAX_S:g} s")
    check_ranges(("--idle", args.idle, 0.0, IDLE_MAX))
    check_output(args.plot, ".png")
    task, episodes = task_of(args)
    aircraft = load_aircraft(args.aircraft)
    if args.delay is not None:
        aircraft = replace(aircraft, propulsion=replace(aircraft.propulsion, delay=args.delay))
    return Conditions(
        aircraft=aircraft,
        task=task,
        episodes=episodes,
        seed=args.seed,
        mount=Mount(args.mount),
        noise=not args.no_noise,
    )


def told_throttle(flown: Conditions, throttles: Sequence[float | None]) -> Sequence[float | None] | None:
    """The throttles of a stored command; None where they go without saying."""
    default = default_throttle(flown)
    return None if list(throttles) == [default] and not default else throttles


def throttle_words(throttle: float | None) -> str:
    """The pilot's thrust, for titles, after a comma; nothing for none."""
    if throttle is None:
        return ", recorded throttle"
    return f", throttle {throttle:g}" if throttle else ""


def check_controllers(controllers: Sequence[str]) -> None:
    """Raise TrainingError unless they are different and not too many."""
    from neuroflight.toolchain.errors import TrainingError

    different = len(set(controllers))
    if len(controllers) > CONTROLLERS_MAX or different < len(controllers):
        raise TrainingError(
            f"{len(controllers)} controllers, {different} of them different, expected 1 to "
            f"{CONTROLLERS_MAX} different ones"
        )


@contextmanager
def progress_bars(args: argparse.Namespace) -> Iterator[Callable[[str], Callable[[int, int], None]]]:
    """Bars on stderr, hidden with --json or in a log: a function that adds one and returns its update."""
    from rich.console import Console
    from rich.progress import Progress

    quiet = args.json or not sys.stderr.isatty()
    with Progress(console=Console(stderr=True), transient=True, disable=quiet) as bars:

        def add(label: str) -> Callable[[int, int], None]:
            task = bars.add_task(label)
            return lambda done, total: bars.update(task, completed=done, total=total)

        yield add


def command(name: str, args: argparse.Namespace, flown: Conditions, *words: str, throttle: object) -> str:
    """The command that repeats a result."""
    from neuroflight.cli.output import command_line

    return command_line(
        name,
        *words,
        *plugin_words(args),
        aircraft=args.aircraft,
        task=task_name(flown.task) if args.commands is None else None,
        episodes=commands_flown(flown) if args.commands is None else None,
        command=args.named_command,
        limit=args.limit,
        length=args.length,
        commands=args.commands,
        piece=args.piece,
        seed=args.seed,
        mount=args.mount if args.mount != "centre" else None,
        throttle=throttle,
        no_noise=args.no_noise,
        delay=args.delay,
        idle=args.idle,
        battery=getattr(args, "battery", None),
        on=args.on,
        thrust=args.thrust,
        transparency=getattr(args, "transparency", False),
        average=getattr(args, "average", False),
    )


def conditions_document(args: argparse.Namespace, flown: Conditions) -> dict[str, Any]:
    """The conditions that are the same for all controllers, as JSON data."""
    return {
        "aircraft": flown.aircraft.name,
        "aircraft_sha256": flown.aircraft.sha256,
        **task_document(flown),
        "episodes": commands_flown(flown),
        "seed": flown.seed,
        "mount": args.mount,
        "noise": flown.noise,
        "delay_s": flown.aircraft.propulsion.delay,
        "gyro_rate_hz": flown.gyro_rate_hz,
        "sticks": flown.sticks,
    }


def flight_document(controller: Contender, throttle: float | None, result: Evaluation) -> dict[str, Any]:
    """A controller and its figures, as JSON data; throttle None: as recorded."""
    from neuroflight.cli.output import plain

    margins = {
        **asdict(result.tracking_margin),
        **asdict(result.effort_margin),
        "smoothness": result.smoothness_margin,
    }
    if result.motor_change is not None:
        margins["motor_change"] = float(result.motor_change.high - result.motor_change.value)
    return {
        "controller": controller.name,
        **controller.facts,
        "throttle": "recorded" if throttle is None else throttle,
        "idle": controller.idle,
        "control_rate_hz": controller.control_rate_hz,
        **{name: values.tolist() for name, values in asdict(result.tracking).items()},
        "worst_mae": result.worst_mae,
        "mae_least": result.mae_least,
        "mse_least": result.mse_least,
        "output": result.effort.output,
        "change": result.effort.change,
        "motor_change": None if result.motor_change is None else float(result.motor_change.value),
        "smoothness": result.smoothness,
        "margin_95": {name: plain(values) for name, values in margins.items()},
        "response": plain(asdict(result.response)) if result.response else None,
        **({"holding": plain(asdict(result.holding))} if result.holding else {}),
        "spectrum": result.spectrum.document(),
    }
