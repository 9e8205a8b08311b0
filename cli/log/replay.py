"""`neuroflight log replay`: give the firmware the inputs of a log again, and compare every motor value."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from neuroflight.cli.board.built import built_last
from neuroflight.cli.log.reading import OfLog, tell_damage
from neuroflight.cli.options import Machine
from neuroflight.cli.progress import progress_bars
from neuroflight.cli.report import print_json, print_table
from neuroflight.cli.requests import Option
from neuroflight.toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from neuroflight.sim.blackbox.log import Log
    from neuroflight.sim.replay.inputs import Answers, Flight
    from neuroflight.sim.replay.other_policy import Opinion

ROOT = Path(__file__).resolve().parents[2]
LIBRARY = Machine("library")
Show = Callable[[float], None]


@dataclass(frozen=True, kw_only=True)
class Replay(OfLog):
    """A request to replay a log."""

    on: Annotated[
        Machine,
        Option(
            None,
            "library: the firmware's C core in this process (default); host: the firmware as a program; "
            "board: its image, emulated",
            choices=("library", "host", "board"),
        ),
    ] = LIBRARY
    build: Annotated[
        Path | None,
        Option("DIR", "the build to replay with; default: build/HOST, with board the last board's"),
    ] = None
    policy: Annotated[
        Path | None,
        Option(
            "OTHER.onnx",
            "ask this policy at each step of the flight and show how its answers, never flown, differ",
        ),
    ] = None
    plot: Annotated[
        Path | None, Option("FILE.png", "with --policy: draw both answers", old=("--out",), suffix=".png")
    ] = None

    def run(self) -> int:
        """Replay the log. Returns 0 where every value is equal, or another policy was asked; else 1.

        Also 1 where the file has a bit that the firmware did not write.
        """
        from neuroflight.sim.replay.flight import replayable

        if self.policy is None and self.plot is not None:
            raise NeuroflightError("--plot draws what another policy answers; name it with --policy")
        if self.policy is not None and self.on != "library":
            raise NeuroflightError(f"--policy asks on the library; leave --on {self.on.said} away")
        log = self.read(self.file)
        flight = replayable(log)
        code = _compare(self, log, flight) if self.policy is None else _ask(self, self.policy, flight)
        if flight.incomplete and not self.json:
            print(flight.incomplete, file=sys.stderr)
        tell_damage(log)
        return code


def _compare(args: Replay, log: Log, flight: Flight) -> int:
    from neuroflight.sim.replay.comparison import compare
    from neuroflight.sim.replay.cost import log_cost
    from neuroflight.sim.replay.program import image_note

    with progress_bars(args.json) as add:
        answers = _replay(args, flight, add(f"replaying on {args.on.said}"))
    found = compare(flight, answers)
    if args.json:
        document = {"file": str(args.file), "on": args.on.said, "equal": found.equal, **asdict(found)}
        document |= {
            "incomplete": flight.incomplete or None,
            "damaged": flight.damaged,
            "bytes_per_second": asdict(log_cost(log)),
        }
        print_json(document)
    else:
        print(f"{args.file.name} on {args.on.said}: {found}")
        if not found.equal:
            print(image_note(flight))
    return 0 if found.equal and not flight.damaged else 1


def _replay(args: Replay, flight: Flight, show: Show) -> Answers:
    """Replay the log's inputs on the machine that is asked for."""
    from neuroflight.sim.replay.program import check_policy

    folder = args.build or (built_last() if args.on == "board" else ROOT / "build" / "HOST")
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


def _ask(args: Replay, policy: Path, flight: Flight) -> int:
    """Print the answers of the other policy."""
    from neuroflight.sim.replay.other_library import answers_of, build_around
    from neuroflight.sim.replay.other_policy import opinion

    folder = args.build or ROOT / "build" / "HOST"
    with progress_bars(args.json) as add:
        add(f"building {policy.name}")
        other = build_around(policy, ROOT)
        answers = answers_of(folder, other, flight, add(f"asking {policy.name}"))
    told = opinion(flight, answers)
    if args.plot is not None:
        from neuroflight.sim.plotting import save_png
        from neuroflight.sim.replay.other_policy_plot import draw_opinion

        title = f"{args.file.name}: what {policy.parent.name}/{policy.name} would have answered"
        save_png(args.plot, draw_opinion(flight, answers, told, title))
    if args.json:
        document = {"file": str(args.file), "policy": str(policy), **asdict(told)}
        print_json(document | {"incomplete": flight.incomplete or None})
    else:
        _print(args, told)
    return 0


def _print(args: Replay, told: Opinion) -> None:
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
