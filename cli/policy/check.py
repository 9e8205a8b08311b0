"""`neuroflight policy check POLICY --aircraft FILE`: judge if a policy is fit to fly, and write its stamp."""

from __future__ import annotations

import argparse
import json
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    from rich.console import Console

    from neuroflight.sim.aircraft.model import Aircraft
    from neuroflight.sim.ports.betaflight.build import Betaflight
    from neuroflight.training.fitness.check import Verdict


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("policy", type=Path, metavar="POLICY.onnx")
    parser.add_argument(
        "--aircraft",
        required=True,
        metavar="NAME|FILE",
        help="that it is to fly: shipped name or a .toml file",
    )
    parser.add_argument(
        "--no-stamp", action="store_true", help="write no POLICY.check.json, which build and flash ask for"
    )
    parser.add_argument(
        "--build", type=Path, metavar="DIR", help="Betaflight's build; default: build/BETAFLIGHT"
    )
    parser.add_argument("--json", action="store_true", help="print all figures as JSON")


def run(args: argparse.Namespace) -> int:
    """Check, write the stamp, print. Returns 0 if the policy is fit, else 1."""
    from neuroflight.cli.compare.controllers import say_foreign
    from neuroflight.cli.output import check_output
    from neuroflight.sim.aircraft.model import load_aircraft
    from neuroflight.toolchain.policy.check_stamp import stamp_path, write_stamp
    from neuroflight.training.evaluation.controllers import load_controller
    from neuroflight.training.fitness.check import check
    from neuroflight.training.fitness.references import References

    aircraft = load_aircraft(args.aircraft)
    say_foreign([load_controller(str(args.policy), aircraft)])
    if not args.no_stamp:
        check_output(stamp_path(args.policy), ".json")
    betaflight, missing = find_betaflight(aircraft, args.build, build=True)
    with ExitStack() as ends:
        references = ends.enter_context(References(aircraft, args.aircraft, betaflight, missing))
        progress = ends.enter_context(Checking())
        verdict = check(args.policy, aircraft, references, progress.of(args.policy.name))
    if not args.no_stamp:
        write_stamp(args.policy, verdict.document())
    if args.json:
        print(json.dumps(verdict.document() | {"cases": verdict.cases()}, indent=2))
    else:
        print_verdict(verdict, args.policy)
    return int(not verdict.fit)


def find_betaflight(aircraft: Aircraft, folder: Path | None, *, build: bool) -> tuple[Betaflight | None, str]:
    """Return Betaflight, if it can fly the aircraft; else None and why. build: unless built already."""
    from neuroflight.cli.fly.ports import BETAFLIGHT
    from neuroflight.sim.ports.betaflight.build import build_betaflight, is_built
    from neuroflight.sim.ports.betaflight.port import aircraft_settings
    from neuroflight.toolchain.errors import NeuroflightError

    place = folder or BETAFLIGHT
    try:
        aircraft_settings(aircraft)
        if not build and not is_built(place):
            return None, "Betaflight is not built; `neuroflight policy check` builds it"
        return build_betaflight(
            place, lambda stage: print(f"Betaflight is not built yet, once: {stage}", file=sys.stderr)
        ), ""
    except NeuroflightError as error:
        return None, f"Betaflight: {error}"


class Checking:
    """A progress bar on a terminal, as a context manager."""

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import Progress

        console = Console(stderr=True)
        self._bar = Progress(console=console, transient=True, disable=not console.is_terminal)

    def __enter__(self) -> Checking:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def of(self, name: str) -> Callable[[float], None]:
        """Show the check of a policy instead of the one before. Returns its update."""
        for number in self._bar.task_ids:
            self._bar.remove_task(number)
        task = self._bar.add_task(f"checking {name}", total=1.0)
        return lambda part: self._bar.update(task, completed=part)


def print_verdict(verdict: Verdict, policy: Path) -> None:
    """Print the table of the bars, the reasons, and one line with the verdict."""
    from rich.console import Console
    from rich.table import Table

    console = Console(highlight=False, soft_wrap=True)
    table = Table(box=None, padding=(0, 2, 0, 0))
    for name in ("", "seen", "at most"):
        table.add_column(name, justify="left" if not name else "right", no_wrap=True)
    for name in ("unit", "where", ""):
        table.add_column(name, overflow="fold")
    for bar in verdict.bars:
        worst = bar.worst
        table.add_row(
            bar.name,
            f"{worst.seen:.3g}",
            f"{worst.limit:.3g}",
            bar.unit,
            worst.where,
            "" if bar.met else "FAILED",
        )
    console.print(table)
    print_end(verdict, policy, console)


def print_end(verdict: Verdict, policy: Path, console: Console) -> None:
    """Print the reasons, the missing parts, and one line with the verdict."""
    for reason in verdict.reasons:
        console.print(f"- {reason}")
    for missing in verdict.missing:
        console.print(f"not compared with one reference: {missing}")
    if above := verdict.above_least:
        words = ", ".join(f"{where} {100 * mae:.0f} and {100 * mse:.0f} %" for where, mae, mse in above)
        console.print(f"MAE and MSE above the least that any motors could leave, without noise: {words}")
    met = sum(bar.met for bar in verdict.bars)
    told = "fit" if verdict.fit else "NOT fit"
    console.print(
        f"{policy} is {told} to fly {verdict.aircraft.name}: {met} of {len(verdict.bars)} bars met, beside "
        f"{' and '.join(each.label for each in verdict.references)}"
    )
