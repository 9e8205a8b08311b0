"""Shared by `evaluate` and `compare`: who flies, Betaflight included, and the conditions that suit all."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from neuroflight.cli.training.evaluation.conditions import THROTTLES_MAX
from neuroflight.cli.training.evaluation.foreign import say_foreign
from neuroflight.cli.training.evaluation.ranges import check_ranges

if TYPE_CHECKING:
    from neuroflight.sim.aircraft.model import Aircraft
    from neuroflight.sim.ports.betaflight.tune import Tune
    from neuroflight.training.evaluation.betaflight import BetaflightSpec
    from neuroflight.training.evaluation.controllers import Conditions, Contender

BETAFLIGHT = "betaflight"
CONTENDER = "POLICY.onnx|pid[:NAME]|FILE.py:CLASS[:VALUES.toml]|betaflight[:tuned|:DIFF]"
THRUST_MAX = 20.0  # of the weight


def add_contender_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of who flies besides, and at which thrust."""
    add_betaflight_arguments(parser)
    parser.add_argument(
        "--thrust",
        type=float,
        nargs="+",
        metavar="W",
        help="fly each controller at the throttle that gives this thrust at rest, of the aircraft's weight, "
        "or the nearest that it can; 0: throttle closed. Prints thrust against throttle too",
    )


def add_betaflight_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of who flies besides."""
    parser.add_argument(
        "--on",
        choices=(BETAFLIGHT,),
        help="add Betaflight with its default PID, filters, mixer and idle, fetched and built at first use; "
        "all then fly at the gyro rate of 4 kHz, commands rounded as sticks are",
    )
    parser.add_argument(
        "--build", type=Path, metavar="DIR", help="Betaflight's build; default: build/BETAFLIGHT"
    )


@contextmanager
def open_contenders(
    args: argparse.Namespace, names: Sequence[str], flown: Conditions
) -> Iterator[tuple[list[Contender], Conditions]]:
    """The controllers called `names`, Betaflight last if only `--on` asks for it, and what they fly in.

    All fly the gyro rate that one of them needs; beside Betaflight, and where thrusts are compared, the
    commands are those that sticks can say. Betaflight ends with the `with`.
    """
    from neuroflight.training.evaluation.controllers import load_controller

    thrusts = args.thrust is not None or getattr(args, "transparency", False)
    with ExitStack() as ends:
        contenders: list[Contender] = []
        for name in all_names(args, names):
            if is_betaflight(name):
                contenders.append(armed_betaflight(args, name, flown.aircraft, ends))
            else:
                contenders.append(load_controller(name, flown.aircraft, args.idle))
        say_foreign(contenders)
        sticks = thrusts or any(map(is_betaflight, all_names(args, names)))
        yield contenders, _at_gyro_rate(flown, contenders, sticks)


def all_names(args: argparse.Namespace, names: Sequence[str]) -> list[str]:
    """The names of all that fly."""
    return [*names, *([BETAFLIGHT] if args.on == BETAFLIGHT and BETAFLIGHT not in names else [])]


def check_thrusts(args: argparse.Namespace) -> None:
    """Raise TrainingError on thrusts outside their range, too many, or beside throttles."""
    from neuroflight.toolchain.errors import TrainingError

    if args.thrust is None:
        return
    if args.throttle is not None:
        raise TrainingError("--throttle: --thrust finds each controller's throttle; leave one of them out")
    if len(args.thrust) > THROTTLES_MAX:
        raise TrainingError(f"--thrust: {len(args.thrust)} values, expected 1 to {THROTTLES_MAX}")
    check_ranges(*(("--thrust", thrust, 0.0, THRUST_MAX) for thrust in args.thrust))


def _at_gyro_rate(flown: Conditions, contenders: Sequence[Contender], sticks: bool) -> Conditions:
    """The conditions at one gyro rate; sticks: whether commands are rounded as sticks are."""
    from neuroflight.toolchain.contract import GYRO_RATE_DEFAULT_HZ

    if sticks or any(contender.gyro_mean for contender in contenders):
        return replace(flown, gyro_rate_hz=GYRO_RATE_DEFAULT_HZ, sticks=sticks)
    return flown


def is_betaflight(name: str) -> bool:
    """Whether a contender is Betaflight: `betaflight`, or with a pilot's settings `betaflight:FILE`."""
    return name.partition(":")[0] == BETAFLIGHT


def betaflight_tune(name: str, aircraft: str) -> Tune | None:
    """The settings in the name of a Betaflight; None: its defaults. aircraft: as the user wrote it.

    Settings that the simulator cannot obey are told on stderr. Raises LinkError.
    """
    from neuroflight.sim.ports.betaflight.tune import TUNED, read_tune, tune_path

    _, colon, which = name.partition(":")
    if not colon:
        return None
    tune = read_tune(tune_path(which, aircraft), TUNED if which == TUNED else None)
    if tune.without_effect:
        print(
            f"{name}: without effect in Betaflight's simulator, which has no DShot, dynamic notch or "
            f"voltage: {', '.join(tune.without_effect)}",
            file=sys.stderr,
        )
    return tune


def armed_betaflight(
    args: argparse.Namespace, name: str, aircraft: Aircraft, ends: ExitStack
) -> BetaflightSpec:
    """The Betaflight called `name`, built if need be, armed and at rest; it ends with `ends`."""
    from neuroflight.cli.sim.fly_ports import built_betaflight
    from neuroflight.sim.ports.betaflight.fleet import ArmedBetaflight
    from neuroflight.training.evaluation.betaflight import BetaflightSpec

    tune = betaflight_tune(name, args.aircraft)
    built = built_betaflight(args, aircraft)
    return BetaflightSpec(ends.enter_context(ArmedBetaflight(built, aircraft, tune)), name)
