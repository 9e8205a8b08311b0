"""neuroflight evaluate: figures of a policy or a PID on unseen commands in the twin."""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.table import Table

    from sim.aircraft import Aircraft
    from sim.confidence import Mean
    from sim.controller import Controller
    from training.evaluation import Evaluation

TASKS = ("pulse", "episodic", "envelope")
MOUNTS = ("centre", "rig", "free")
PID_RATE_HZ = 1000
DELAY_MAX_S = 0.1
IDLE_MAX = 0.5
ALL_ROWS = (
    ("all axes, 500 ms+, %", "all_in_band_500"),
    ("all axes, 750 ms+, %", "all_in_band_750"),
    ("  bare, 500 ms+, %", "all_in_band_500_bare"),
    ("  bare, 750 ms+, %", "all_in_band_750_bare"),
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
    ("in band, 500 ms+, %", "in_band_500", 100, 1),
    ("in band, 750 ms+, %", "in_band_750", 100, 1),
    ("  bare, 500 ms+, %", "in_band_500_bare", 100, 1),
    ("  bare, 750 ms+, %", "in_band_750_bare", 100, 1),
)


@dataclass(frozen=True)
class Opponent:
    """What is evaluated, as the user named it."""

    controller: Controller
    control_rate_hz: int
    idle: float
    facts: dict[str, str]  # that a stored result should remember of it


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "controller", metavar="POLICY.onnx|pid[:NAME]", help="a policy, or a PID of the aircraft file"
    )
    parser.add_argument("--aircraft", default="nf1", metavar="NAME|FILE", help="shipped name or a .toml file")
    parser.add_argument("--task", choices=TASKS, default="pulse", help="what is commanded; default: pulse")
    parser.add_argument("--episodes", type=int, default=100, metavar="N", help="commands, one aircraft each")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="of commands, noise and bias")
    parser.add_argument("--mount", choices=MOUNTS, default="centre", help="what holds the aircraft")
    parser.add_argument("--throttle", type=float, default=0.0, metavar="T", help="pilot's thrust, 0..1")
    parser.add_argument("--no-noise", action="store_true", help="an ideal gyro")
    parser.add_argument(
        "--delay", type=float, metavar="SECONDS", help="from command to rotor; default: the aircraft's"
    )
    parser.add_argument(
        "--idle",
        type=float,
        metavar="U",
        help="motor fraction at no thrust; default: the PID's, a policy's 0",
    )
    parser.add_argument("--plot", type=Path, metavar="FILE.png", help="draw the step responses")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")


def run(args: argparse.Namespace) -> int:
    """Fly all commands at once and print the figures."""
    from rich.console import Console
    from rich.progress import Progress

    from sim.aircraft import load_aircraft
    from sim.report import png
    from sim.response_plot import draw
    from sim.world import Mount
    from toolchain.cli.output import check_output
    from toolchain.files import write_bytes
    from training.evaluation import figures, record
    from training.tasks import TASKS as BUILDERS

    _check(args)
    check_output(args.plot, ".png")
    aircraft = load_aircraft(args.aircraft)
    if args.delay is not None:
        aircraft = replace(aircraft, propulsion=replace(aircraft.propulsion, delay=args.delay))
    opponent = _opponent(args, aircraft)
    quiet = args.json or not sys.stderr.isatty()
    with Progress(console=Console(stderr=True), transient=True, disable=quiet) as bar:
        task = bar.add_task(f"{args.episodes} commands")
        flights = record(
            opponent.controller,
            aircraft,
            BUILDERS[args.task](),
            episodes=args.episodes,
            seed=args.seed,
            control_rate_hz=opponent.control_rate_hz,
            mount=Mount(args.mount),
            noise=not args.no_noise,
            throttle=args.throttle,
            idle=opponent.idle,
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        )
    result = figures(flights)
    title = (
        f"{args.controller} on {aircraft.name}: {result.episodes} commands of {args.task}, seed {args.seed}"
    )
    held = flights.hold()
    if args.plot and held and result.response:
        write_bytes(args.plot, png(draw(held, result.response, title)))
    if args.json:
        print(json.dumps(_document(args, aircraft, opponent, result), indent=2))
    else:
        _print(title, result)
    return 0


def _check(args: argparse.Namespace) -> None:
    """Refuse numbers that make no flight; NaN is in no range."""
    from sim.world import COUNT_MAX
    from toolchain.errors import TrainingError

    if not 1 <= args.episodes <= COUNT_MAX:
        raise TrainingError(f"--episodes {args.episodes}, expected 1 to {COUNT_MAX}")
    if not 0.0 <= args.throttle <= 1.0:
        raise TrainingError(f"--throttle {args.throttle}, expected 0 to 1")
    if args.seed < 0:
        raise TrainingError(f"--seed {args.seed}, expected 0 or more")
    if args.delay is not None and not 0.0 <= args.delay <= DELAY_MAX_S:
        raise TrainingError(f"--delay {args.delay}, expected 0 to {DELAY_MAX_S:g} s")
    if args.idle is not None and not 0.0 <= args.idle <= IDLE_MAX:
        raise TrainingError(f"--idle {args.idle}, expected 0 to {IDLE_MAX:g}")


def _opponent(args: argparse.Namespace, aircraft: Aircraft) -> Opponent:
    from sim.controller import PolicyController
    from sim.pid import aircraft_pid, pid_settings
    from toolchain.errors import PolicyError
    from toolchain.network import read_policy

    kind, _, name = args.controller.partition(":")
    if kind == "pid":
        settings = pid_settings(aircraft, name or None)
        pid = aircraft_pid(aircraft, args.episodes, PID_RATE_HZ, name or None)
        idle = settings.idle if args.idle is None else args.idle
        chosen = name or next(iter(dict(aircraft.pids)))
        return Opponent(pid, PID_RATE_HZ, idle, {"pid": chosen})
    path = Path(args.controller)
    policy = read_policy(path)
    if policy.action_count != aircraft.motor_count:
        raise PolicyError(
            f"{args.controller} drives {policy.action_count} motors, aircraft {aircraft.name} has "
            f"{aircraft.motor_count}; evaluate it on an aircraft it was trained for"
        )
    controller = PolicyController(policy, args.episodes, exact=False)
    facts = {"policy_sha256": hashlib.sha256(path.read_bytes()).hexdigest()}
    return Opponent(controller, policy.control_rate_hz, args.idle or 0.0, facts)


def _document(
    args: argparse.Namespace, aircraft: Aircraft, opponent: Opponent, result: Evaluation
) -> dict[str, Any]:
    from toolchain.cli.output import command_line, plain

    command = command_line(
        "evaluate",
        args.controller,
        aircraft=args.aircraft,
        task=args.task,
        episodes=args.episodes,
        seed=args.seed,
        mount=args.mount if args.mount != "centre" else None,
        throttle=args.throttle or None,
        no_noise=args.no_noise,
        delay=args.delay,
        idle=args.idle,
    )
    margins = {**asdict(result.tracking_margin), **asdict(result.effort_margin)}
    return {
        "command": command,
        "controller": args.controller,
        **opponent.facts,
        "aircraft": aircraft.name,
        "aircraft_sha256": aircraft.sha256,
        "task": args.task,
        "episodes": result.episodes,
        "seed": args.seed,
        "mount": args.mount,
        "throttle": args.throttle,
        "noise": not args.no_noise,
        "delay_s": aircraft.propulsion.delay,
        "idle": opponent.idle,
        "control_rate_hz": opponent.control_rate_hz,
        **{name: values.tolist() for name, values in asdict(result.tracking).items()},
        "worst_mae": result.worst_mae,
        "output": result.effort.output,
        "change": result.effort.change,
        "margin_95": {name: plain(values) for name, values in margins.items()},
        "response": plain(asdict(result.response)) if result.response else None,
    }


def _print(title: str, result: Evaluation) -> None:
    from rich.console import Console
    from rich.table import Table

    from toolchain.contract import AXES

    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    for heading in ("", *AXES, "mean"):
        table.add_column(heading, justify="right" if heading else "left", no_wrap=True)
    margins = asdict(result.tracking_margin)
    for name, values in asdict(result.tracking).items():
        digits = 2 if name == "mae" else 0
        cells = [
            f"{_number(value, digits)} ± {_number(margin, digits)}"
            for value, margin in zip(values, margins[name], strict=True)
        ]
        table.add_row(name.upper(), *cells, _number(values.mean(), digits))
    if result.response:
        _add_response(table, result)
    console = Console()
    console.print(table)
    effort, margin = result.effort, result.effort_margin
    console.print(
        f"mean output ū {effort.output:.4f} ± {margin.output:.4f}, "
        f"mean |Δu| in 1 ms {effort.change:.5f} ± {margin.change:.5f}, "
        f"worst MAE of a command and axis {result.worst_mae:.1f} deg/s"
    )
    note = "Errors in deg/s against the true rate; ± is 95 % confidence of the mean."
    if result.response:
        floor = f"{result.response.floor_deg_s:g} deg/s"
        note += (
            f" The band is 10 % of the initial error or {floor}, whichever is wider; rise, peak and failure "
            f"leave out initial errors below {floor}."
        )
    console.print(note, style="dim")


def _add_response(table: Table, result: Evaluation) -> None:
    import numpy as np

    for heading, name, factor, digits in RESPONSE_ROWS:
        mean: Mean = getattr(result.response, name)
        cells = []
        for axis in range(3):
            value, low, high = (factor * part[axis] for part in (mean.value, mean.low, mean.high))
            known = mean.count[axis] > 0
            cells.append(f"{value:.{digits}f} ± {(high - low) / 2:.{digits}f}" if known else "none")
        some = mean.count > 0
        average = f"{factor * np.mean(mean.value[some]):.{digits}f}" if some.any() else "none"
        table.add_row(heading, *cells, average)
    for heading, name in ALL_ROWS:
        share: Mean = getattr(result.response, name)
        table.add_row(heading, "", "", "", f"{100 * share.value:.1f}")


def _number(value: float, digits: int) -> str:
    """At most seven characters where the digits of large sums would fill the screen."""
    if value < 1e5:
        return f"{value:,.{digits}f}"
    mantissa, exponent = f"{value:.2e}".split("e")
    return f"{mantissa}e{int(exponent)}"
