"""neuroflight power: what controllers draw from the battery, disarmed, armed idling and in flight."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from neuroflight.cli.output import with_margin
from neuroflight.cli.training.evaluation.conditions import (
    IDLE_MAX,
    THROTTLES_MAX,
    check_controllers,
    progress_bars,
)
from neuroflight.cli.training.evaluation.contenders import (
    CONTENDER,
    THRUST_MAX,
    add_betaflight_arguments,
    all_names,
    open_contenders,
)
from neuroflight.cli.training.evaluation.ranges import check_ranges

if TYPE_CHECKING:
    from neuroflight.sim.analysis.confidence import Mean
    from neuroflight.training.evaluation.controllers import Conditions
    from neuroflight.training.evaluation.power import Draw, Drawn

EPISODES_MAX = 500
SECONDS_MIN, SECONDS_MAX = 0.1, 60.0
NOTE = (
    "Disarmed: any controller. Armed: on the ground, throttle closed, with gyro noise. 1 g: at the throttle "
    "that gives a thrust at rest of the aircraft's weight, or (*) the nearest that a controller can; without "
    "commands, and following pulses. Voltage is under load. MAE in deg/s against the true rate; ± is 95 % "
    "confidence of the mean over aircraft."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("controllers", nargs="*", metavar=CONTENDER)
    parser.add_argument("--aircraft", default="nf1", metavar="NAME|FILE", help="shipped name or a .toml file")
    add_betaflight_arguments(parser)
    parser.add_argument(
        "--thrust",
        type=float,
        nargs="*",
        default=[1.0],
        metavar="W",
        help="thrusts to fly at, of the weight; none: idle only; default: 1, hover",
    )
    parser.add_argument("--seconds", type=float, default=5.0, metavar="S", help="of idling; default: 5")
    parser.add_argument("--episodes", type=int, default=10, metavar="N", help="aircraft, a command each")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="of commands, noise and bias")
    parser.add_argument(
        "--idle", type=float, metavar="U", help="motor fraction at no thrust; default: the controller's own"
    )
    parser.add_argument(
        "--battery", type=float, default=1.0, metavar="CHARGE", help="its charge at the start, 0..1 (1)"
    )
    parser.add_argument("--plot", type=Path, metavar="FILE.png", help="draw currents, and errors over them")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")


def run(args: argparse.Namespace) -> int:
    """Let all controllers idle and fly, print what they draw."""
    from neuroflight.cli.output import check_output
    from neuroflight.sim.plotting import save_png
    from neuroflight.toolchain.errors import TrainingError
    from neuroflight.training.evaluation.power import disarmed, power
    from neuroflight.training.evaluation.power_plot import draw

    names = all_names(args, args.controllers)
    if not names:
        raise TrainingError("no controller; expected policies, pid, pid:NAME, or betaflight")
    check_controllers(names)
    check_output(args.plot, ".png")
    flown = _conditions(args)
    with (
        open_contenders(args, args.controllers, flown) as (contenders, conditions),
        progress_bars(args) as bar,
    ):
        drawn = [power(each, conditions, args.thrust, args.seconds, bar) for each in contenders]
    assert flown.aircraft.battery is not None
    still = disarmed(flown.aircraft.battery, args.battery)
    title = f"{flown.aircraft.name}: power from the battery, {args.episodes} aircraft, seed {args.seed}"
    if args.plot:
        save_png(args.plot, draw(still, drawn, title))
    if args.json:
        print(json.dumps(_document(args, conditions, still, drawn), indent=2))
    else:
        _print(title, still, drawn)
    return 0


def _conditions(args: argparse.Namespace) -> Conditions:
    """What all fly in. Raises TrainingError on values outside their range, NaN included."""
    from neuroflight.sim.aircraft.model import load_aircraft
    from neuroflight.toolchain.errors import AircraftError, TrainingError
    from neuroflight.training.evaluation.controllers import Conditions
    from neuroflight.training.tasks.task import PulseTask

    check_ranges(
        ("--seconds", args.seconds, SECONDS_MIN, SECONDS_MAX),
        ("--episodes", args.episodes, 1, EPISODES_MAX),
        ("--seed", args.seed, 0, sys.maxsize),
        ("--idle", args.idle, 0.0, IDLE_MAX),
        ("--battery", args.battery, 0.0, 1.0),
        *(("--thrust", thrust, 0.0, THRUST_MAX) for thrust in args.thrust),
    )
    if len(args.thrust) > THROTTLES_MAX:
        raise TrainingError(f"--thrust: {len(args.thrust)} values, expected at most {THROTTLES_MAX}")
    aircraft = load_aircraft(args.aircraft)
    if aircraft.battery is None:
        raise AircraftError(f"aircraft {aircraft.name}: no [battery] table; power is drawn from a battery")
    return Conditions(aircraft, PulseTask(), args.episodes, args.seed, charge=args.battery)


def _document(
    args: argparse.Namespace, flown: Conditions, still: Draw, drawn: Sequence[Drawn]
) -> dict[str, object]:
    from neuroflight.cli.output import command_line
    from neuroflight.training.evaluation.power import document

    given = {
        name: getattr(args, name)
        for name in ("aircraft", "on", "thrust", "seconds", "episodes", "seed", "idle", "battery")
    }
    assert flown.aircraft.battery is not None
    return {
        "command": command_line("power", *args.controllers, **given),
        "aircraft": flown.aircraft.name,
        "aircraft_sha256": flown.aircraft.sha256,
        "task": flown.task.name,
        "episodes": flown.episodes,
        "seed": flown.seed,
        "gyro_rate_hz": flown.gyro_rate_hz,
        "idling_s": args.seconds,
        "charge": args.battery,
        "electronics_w": flown.aircraft.battery.electronics_power,
        "disarmed": still.document(),
        "controllers": [document(each) for each in drawn],
    }


def _print(title: str, still: Draw, drawn: Sequence[Drawn]) -> None:
    from rich.console import Console

    from neuroflight.cli.output import print_table

    rows: list[tuple[str, ...]] = [("", "V", "A", "W", "MAE"), _row("disarmed", still)]
    for each in drawn:
        rows.append(_row(f"{each.controller.label}, armed", each.idling))
        for flown in each.flown:
            mark = "" if flown.trim.reached else " (*)"
            rows.append(_row(f"  {flown.trim.wanted:g} g{mark}, rest", flown.rest))
            rows.append(_row(f"  {flown.trim.wanted:g} g{mark}, pulses", flown.commands, flown.mae))
    print_table(title, rows)
    Console().print(NOTE, style="dim")


def _row(name: str, drawn: Draw, mae: Mean | None = None) -> tuple[str, ...]:
    error = "" if mae is None else _interval(mae, 3)
    return (name, _interval(drawn.volts, 3), _interval(drawn.amps, 3), _interval(drawn.watts, 2), error)


def _interval(mean: Mean, digits: int) -> str:
    return with_margin(float(mean.value), float(mean.high - mean.low) / 2, digits)
