"""neuroflight failure: controllers through a change in flight, of a motor's thrust or of a payload."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from neuroflight.cli.training.evaluation.conditions import check_controllers, progress_bars
from neuroflight.cli.training.evaluation.contenders import CONTENDER, armed_betaflight, is_betaflight
from neuroflight.cli.training.evaluation.foreign import say_foreign
from neuroflight.cli.training.evaluation.ranges import check_ranges

if TYPE_CHECKING:
    from neuroflight.sim.aircraft.model import Aircraft
    from neuroflight.training.evaluation.controllers import Contender
    from neuroflight.training.evaluation.failure import Case, Failure, Plan

EPISODES, AT_S, AFTER_S, THROTTLE, LIMIT = 50, 1.0, 2.0, 0.4, 200.0
CASES_MAX = 12
MOTOR_CASES = (0.25, 0.5, 1.0)  # of motor 1, unless cases are given


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "controllers",
        nargs="+",
        metavar=CONTENDER,
        help="policies, PIDs of the aircraft file, Betaflight with its defaults or a pilot's settings",
    )
    parser.add_argument("--aircraft", default="nf1", metavar="NAME|FILE", help="shipped name or a .toml file")
    parser.add_argument(
        "--fail",
        action="append",
        default=[],
        metavar="MOTOR=SHARE",
        help="a case: this motor, from 1, loses this share of its thrust, above 0 to 1; "
        "default without any case: motor 1 loses 0.25, 0.5, 1",
    )
    parser.add_argument(
        "--payload",
        action="append",
        default=[],
        metavar="GRAMS@X,Y,Z",
        help="a case: a payload comes on, at this place of the body frame [m]",
    )
    parser.add_argument(
        "--drop",
        action="append",
        default=[],
        metavar="GRAMS@X,Y,Z",
        help="a case: a payload carried from the start goes",
    )
    parser.add_argument(
        "--shift",
        action="append",
        default=[],
        metavar="GRAMS@X,Y,Z:X,Y,Z",
        help="a case: a payload carried from the start moves there",
    )
    parser.add_argument(
        "--at", type=float, default=AT_S, metavar="SECONDS", help=f"of the change; default: {AT_S:g}"
    )
    parser.add_argument(
        "--after",
        type=float,
        default=AFTER_S,
        metavar="SECONDS",
        help=f"that are flown after it; default: {AFTER_S:g}",
    )
    parser.add_argument(
        "--episodes", type=int, default=EPISODES, metavar="N", help=f"commands a case; default: {EPISODES}"
    )
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="of commands, noise and bias")
    parser.add_argument(
        "--throttle", type=float, default=THROTTLE, metavar="T", help=f"default: {THROTTLE:g}"
    )
    parser.add_argument(
        "--limit",
        type=float,
        default=LIMIT,
        metavar="DEG_S",
        help=f"each axis is commanded a rate from 0 to this, either way; default: {LIMIT:g}",
    )
    parser.add_argument(
        "--give-up-yaw",
        action="store_true",
        help="after the change the controllers are told the measured yaw rate as the commanded one",
    )
    parser.add_argument("--no-noise", action="store_true", help="an ideal gyro")
    parser.add_argument("--plot", type=Path, metavar="FILE.png", help="draw the errors over time")
    parser.add_argument(
        "--build", type=Path, metavar="DIR", help="Betaflight's build; default: build/BETAFLIGHT"
    )
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")


def run(args: argparse.Namespace) -> int:
    """Fly all cases with each controller and print the results."""
    from rich.console import Console

    from neuroflight.cli.output import check_output
    from neuroflight.sim.aircraft.model import load_aircraft
    from neuroflight.sim.plotting import save_png
    from neuroflight.training.evaluation.failure import examine
    from neuroflight.training.evaluation.failure_plot import draw

    _check(args)
    check_output(args.plot, ".png")
    aircraft = load_aircraft(args.aircraft)
    plan = _plan(args, aircraft)
    with ExitStack() as ends:
        controllers = [_controller(args, name, aircraft, ends) for name in args.controllers]
        with progress_bars(args) as bar:
            results = [examine(each, plan, bar(each.label)) for each in controllers]
    title = f"A change in flight, {aircraft.name}: {plan.episodes} commands, throttle {plan.throttle:g}"
    if args.plot:
        save_png(args.plot, draw(results, plan.at_s, title))
    if args.json:
        print(json.dumps(_document(args, aircraft, plan, results), indent=2))
    else:
        _print(title, plan, results, Console(width=max(Console().width, 140)))
    return 0


def _check(args: argparse.Namespace) -> None:
    """Raise TrainingError on values outside their range, NaN included."""
    from neuroflight.sim.physics.world import COUNT_MAX
    from neuroflight.toolchain.errors import TrainingError

    check_controllers(args.controllers)
    check_ranges(
        ("--at", args.at, 0.1, 60.0),
        ("--after", args.after, 0.5, 60.0),
        ("--episodes", args.episodes, 1, COUNT_MAX),
        ("--throttle", args.throttle, 0.0, 1.0),
        ("--limit", args.limit, 0.0, 500.0),
    )
    if args.seed < 0:
        raise TrainingError(f"--seed {args.seed}, expected 0 or more")
    if args.give_up_yaw and any(map(is_betaflight, args.controllers)):
        raise TrainingError("--give-up-yaw: Betaflight cannot be told to; fly policies and PIDs")


def _plan(args: argparse.Namespace, aircraft: Aircraft) -> Plan:
    from neuroflight.training.evaluation.failure import Plan

    return Plan(
        cases=_cases(args, aircraft),
        episodes=args.episodes,
        seed=args.seed,
        at_s=args.at,
        after_s=args.after,
        throttle=args.throttle,
        limit_deg_s=args.limit,
        noise=not args.no_noise,
        yaw_given_up=args.give_up_yaw,
    )


def _cases(args: argparse.Namespace, aircraft: Aircraft) -> tuple[Case, ...]:
    """The cases of the arguments, after one in which nothing happens. Raises NeuroflightError."""
    from neuroflight.sim.aircraft.payload import parse_payload
    from neuroflight.toolchain.errors import TrainingError
    from neuroflight.training.evaluation.failure import (
        motor_loses,
        nothing_happens,
        payload_attached,
        payload_dropped,
        payload_shifted,
    )

    found = [motor_loses(aircraft, *_loss(text, aircraft)) for text in args.fail]
    found += [payload_attached(aircraft, parse_payload(text)) for text in args.payload]
    found += [payload_dropped(aircraft, parse_payload(text)) for text in args.drop]
    for text in args.shift:
        start, _, place = text.partition(":")
        to = parse_payload(f"{start.partition('@')[0]}@{place}")
        found.append(payload_shifted(aircraft, parse_payload(start), to))
    if not found:
        found = [motor_loses(aircraft, 1, share) for share in MOTOR_CASES]
    names = {case.name for case in found}
    if len(names) < len(found) or len(found) > CASES_MAX:
        raise TrainingError(
            f"{len(found)} cases, {len(names)} of them different, expected 1 to {CASES_MAX} different ones"
        )
    return (nothing_happens(aircraft), *found)


def _loss(text: str, aircraft: Aircraft) -> tuple[int, float]:
    from neuroflight.toolchain.errors import TrainingError

    motor, _, share = text.partition("=")
    try:
        found = int(motor), float(share)
    except ValueError:
        found = 0, 0.0
    if not (1 <= found[0] <= aircraft.motor_count and 0.0 < found[1] <= 1.0):
        raise TrainingError(
            f"--fail {text}: expected MOTOR=SHARE, a motor of 1 to {aircraft.motor_count} and a share "
            "above 0 to 1, such as 1=0.5"
        )
    return found


def _controller(args: argparse.Namespace, name: str, aircraft: Aircraft, ends: ExitStack) -> Contender:
    """A controller by its name; Betaflight ends with `ends`."""
    from neuroflight.training.evaluation.controllers import load_controller

    if is_betaflight(name):
        return armed_betaflight(args, name, aircraft, ends)
    controller = load_controller(name, aircraft)
    say_foreign([controller])
    return controller


def _document(
    args: argparse.Namespace, aircraft: Aircraft, plan: Plan, results: Sequence[Failure]
) -> dict[str, Any]:
    from neuroflight.cli.output import command_line
    from neuroflight.training.evaluation.failure import DIVERGENCE, RECOVERY, document

    cases = {option: getattr(args, option) for option in ("fail", "payload", "drop", "shift")}
    words = [word for option, values in cases.items() for value in values for word in (f"--{option}", value)]
    command = command_line(
        "failure",
        *args.controllers,
        *words,
        aircraft=args.aircraft,
        at=args.at,
        after=args.after,
        episodes=args.episodes,
        seed=args.seed,
        throttle=args.throttle,
        limit=args.limit,
        give_up_yaw=args.give_up_yaw,
        no_noise=args.no_noise,
    )
    return {
        "command": command,
        "aircraft": aircraft.name,
        "aircraft_sha256": aircraft.sha256,
        "failure": {
            "episodes": plan.episodes,
            "seed": plan.seed,
            "at_s": plan.at_s,
            "after_s": plan.after_s,
            "throttle": plan.throttle,
            "limit_deg_s": plan.limit_deg_s,
            "noise": plan.noise,
            "yaw_given_up": plan.yaw_given_up,
            "recovery": RECOVERY,
            "divergence": DIVERGENCE,
            "controllers": {each.controller.name: document(each) for each in results},
        },
    }


def _print(title: str, plan: Plan, results: Sequence[Failure], console: Any) -> None:  # noqa: ANN401 - rich
    from rich.table import Table

    from neuroflight.training.evaluation.failure import DIVERGENCE, RECOVERY

    table = Table(title=title, title_justify="left", box=None, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column("", no_wrap=True)
    for name in ("before", "after", "at the end", "back in s", "of episodes", "diverged"):
        table.add_column(name, justify="right", no_wrap=True)
    for number, case in enumerate(plan.cases):
        table.add_row(case.name, style="bold")
        for result in results:
            flown = result.cases[number]
            table.add_row(
                f"  {result.controller.label}",
                *(_three(values, "{:.1f}") for values in (flown.before, flown.after, flown.settled)),
                _three(flown.recovery_s, "{:.2f}"),
                _three(100 * flown.recovered, "{:.0f}"),
                f"{100 * flown.diverged:.0f} %",
            )
    console.print(table, markup=False)
    console.print(
        f"Roll / pitch / yaw. Mean errors in deg/s: of the half second before the change, from it to the "
        f"end, of the last half second. Back: {RECOVERY}; the median, and the share [%] of episodes. "
        f"Diverged: {DIVERGENCE}.",
        style="dim",
        markup=False,
    )


def _three(values: Any, form: str) -> str:  # noqa: ANN401 - an array
    return " / ".join("-" if value != value else form.format(value) for value in values)
