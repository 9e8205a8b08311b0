"""`neuroflight log replay`: give the firmware the inputs of a log again, and compare every motor value."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from neuroflight.cli.log.reading import add_file_arguments, open_log, tell_damage
from neuroflight.cli.options import add_plot, machine
from neuroflight.cli.report import print_table
from neuroflight.toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from neuroflight.sim.blackbox.log import Log
    from neuroflight.sim.replay.inputs import Answers, Flight
    from neuroflight.sim.replay.other_policy import Opinion

ROOT = Path(__file__).resolve().parents[2]
MACHINES = ("library", "host", "board")
Show = Callable[[float], None]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the log, the firmware, and the other policy."""
    add_file_arguments(parser)
    parser.add_argument(
        "--on",
        type=machine,
        choices=MACHINES,
        default="library",
        help="library: the firmware's C core in this process (default); host: the firmware as a program; "
        "board: its image, emulated",
    )
    parser.add_argument(
        "--build",
        type=Path,
        metavar="DIR",
        help="the build to replay with; default: build/HOST, with board build/MATEKF722",
    )
    parser.add_argument(
        "--policy",
        type=Path,
        metavar="OTHER.onnx",
        help="ask this policy at each step of the flight and show how its answers, never flown, differ",
    )
    add_plot(parser, "with --policy: draw both answers", old="--out")


def run(args: argparse.Namespace) -> int:
    """Replay the log. Returns 0 where every value is equal, or another policy was asked; else 1.

    Also 1 where the file has a bit that the firmware did not write.
    """
    from neuroflight.cli.output import check_output
    from neuroflight.sim.replay.flight import replayable

    if args.policy is None and args.plot is not None:
        raise NeuroflightError("--plot draws what another policy answers; name it with --policy")
    if args.policy is not None and args.on != "library":
        raise NeuroflightError(f"--policy asks on the library; leave --on {args.on.said} away")
    check_output(args.plot, ".png")
    log = open_log(args)
    flight = replayable(log)
    code = _compare(args, log, flight) if args.policy is None else _ask(args, flight)
    if flight.incomplete and not args.json:
        print(flight.incomplete, file=sys.stderr)
    tell_damage(log)
    return code


def _compare(args: argparse.Namespace, log: Log, flight: Flight) -> int:
    from neuroflight.sim.replay.comparison import compare
    from neuroflight.sim.replay.cost import log_cost
    from neuroflight.sim.replay.program import image_note

    with _bar(args, f"replaying on {args.on.said}") as show:
        answers = _replay(args, flight, show)
    found = compare(flight, answers)
    if args.json:
        document = {"file": str(args.file), "on": args.on.said, "equal": found.equal, **asdict(found)}
        document |= {
            "incomplete": flight.incomplete or None,
            "damaged": flight.damaged,
            "bytes_per_second": asdict(log_cost(log)),
        }
        print(json.dumps(document, indent=2))
    else:
        print(f"{args.file.name} on {args.on.said}: {found}")
        if not found.equal:
            print(image_note(flight))
    return 0 if found.equal and not flight.damaged else 1


def _replay(args: argparse.Namespace, flight: Flight, show: Show) -> Answers:
    """Replay the log's inputs on the machine that is asked for."""
    from neuroflight.sim.replay.program import check_policy

    folder = args.build or ROOT / "build" / ("MATEKF722" if args.on == "board" else "HOST")
    if args.on == "board":
        from neuroflight.sim.replay.emulator import replay_on_board

        check_policy(flight, folder / "neuroflight.elf")
        return replay_on_board(folder / "neuroflight.bin", flight, show)
    check_policy(flight, folder / "neuroflight")
    if args.on == "host":
        from neuroflight.sim.replay.host import replay_on_host

        return replay_on_host(folder / "neuroflight", flight, show)
    from neuroflight.sim.replay.library import replay_on_library

    return replay_on_library(folder / "libneuroflight.so", flight, show)


def _ask(args: argparse.Namespace, flight: Flight) -> int:
    """Print the answers of the other policy."""
    from neuroflight.sim.replay.other_library import answers_of, build_around
    from neuroflight.sim.replay.other_policy import opinion

    folder = args.build or ROOT / "build" / "HOST"
    with _bar(args, f"building {args.policy.name}"):
        other = build_around(args.policy, ROOT)
    with _bar(args, f"asking {args.policy.name}") as show:
        answers = answers_of(folder, other, flight, show)
    told = opinion(flight, answers)
    if args.plot is not None:
        from neuroflight.sim.plotting import save_png
        from neuroflight.sim.replay.other_policy_plot import draw_opinion

        title = f"{args.file.name}: what {args.policy.parent.name}/{args.policy.name} would have answered"
        save_png(args.plot, draw_opinion(flight, answers, told, title))
    if args.json:
        document = {"file": str(args.file), "policy": str(args.policy), **asdict(told)}
        print(json.dumps(document | {"incomplete": flight.incomplete or None}, indent=2))
    else:
        _print(args, told)
    return 0


def _print(args: argparse.Namespace, told: Opinion) -> None:
    rows: list[tuple[str, ...]] = [("", "mean difference, % of a motor")]
    rows += [(f"motor {motor}", f"{100 * mean:.3f}") for motor, mean in enumerate(told.mean, 1)]
    note = (
        f"{told.steps:,} control steps with motors that turn, {100 * told.share:.1f} % of them answered "
        f"otherwise; mean motor {100 * told.thrust_logged:.2f} % flown, {100 * told.thrust_answered:.2f} % "
        "answered. It began as after a reset, and what it answered was not flown."
    )
    if told.only_logged or told.only_answered:
        note += (
            f" Motors stood in {told.only_logged:,} steps in which they were flown, and turned in "
            f"{told.only_answered:,} in which they were not."
        )
    print_table(f"{args.file.name} asked of {args.policy}", rows)
    large: list[tuple[str, ...]] = [("largest", "time, s", "motor", "flown, %", "answered, %")]
    for number, one in enumerate(told.largest, 1):
        values = f"{one.at_s:.3f}", str(one.motor), f"{100 * one.logged:.2f}", f"{100 * one.answered:.2f}"
        large.append((str(number), *values))
    print_table("", large, note)


@contextmanager
def _bar(args: argparse.Namespace, what: str) -> Iterator[Show]:
    """Show the progress on a terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    hidden = bool(args.json) or not sys.stderr.isatty()
    with Progress(*columns, console=Console(stderr=True), transient=True, disable=hidden) as bar:
        task = bar.add_task(what, total=1.0)
        yield lambda part: bar.update(task, completed=part)
