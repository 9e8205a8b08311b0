"""neuroflight manoeuvres: policies, PIDs and Betaflight in six manoeuvres and a descent, on equal terms."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from neuroflight.cli.training.evaluation.conditions import check_controllers
from neuroflight.cli.training.evaluation.contenders import CONTENDER, betaflight_tune, is_betaflight
from neuroflight.cli.training.evaluation.foreign import say_foreign
from neuroflight.cli.training.evaluation.ranges import check_ranges
from neuroflight.toolchain.workers import Crew, Show, usable_cores

if TYPE_CHECKING:
    from neuroflight.sim.aircraft.model import Aircraft
    from neuroflight.sim.analysis.confidence import Mean
    from neuroflight.sim.analysis.manoeuvre import ManoeuvreFigures
    from neuroflight.training.evaluation.manoeuvres import Air, Contender, Flown

T = TypeVar("T")
SEEDS_MAX, DESCENTS = 100, 3
GUST_MAX = 50.0  # [m/s]
DRAWN = ("roll", "split-s")
COLUMNS = (  # heading, figure, digits
    ("MAE", "mae", 2),
    ("MSE", "mse", 0),
    ("over, %", "overshoot", 0),
    ("stray", "stray", 1),
    ("its peak", "stray_peak", 0),
    ("thrust", "thrust", 2),
    ("|Δu|", "change", 4),
    ("20-80 Hz", "shake", 1),
    ("hover", "rest", 2),
    ("drift, °", "drift", 1),
)
NOTE = (
    "MAE and MSE: mean of the axes against the true rate, deg/s; ± is 95 % confidence over seeds. * the "
    "lowest of the manoeuvre, ** told from every other with 95 % confidence, seed by seed. Overshoot: the "
    "most past a command, in % of its jump. Stray: |rate| of axes that are not commanded. Thrust: of all "
    "rotors over the weight, flown; |Δu| of the motors in 1 ms. 20-80 Hz: root mean square of the errors in "
    "that band, what a pilot sees of prop wash. Hover: |rate| with the sticks centred behind "
    "the manoeuvre, and how far the aircraft drifts in it about its worst axis. Each throttle is the one "
    "whose thrust at rest is the same for all, or the nearest that the contender gives."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "contenders",
        nargs="+",
        metavar=CONTENDER,
        help="policies, PIDs of the aircraft file, or Betaflight, fetched and built at first use; "
        "differences are to the first",
    )
    parser.add_argument("--aircraft", default="nf1", metavar="NAME|FILE", help="shipped name or a .toml file")
    parser.add_argument(
        "--seeds", type=int, default=5, metavar="N", help="flights of each manoeuvre; default: 5"
    )
    parser.add_argument(
        "--seed", type=int, default=1, metavar="S", help="the first; each draws noise, bias and gusts"
    )
    parser.add_argument(
        "--battery", type=float, default=0.9, metavar="CHARGE", help="at power-on, 0..1; default: 0.9"
    )
    parser.add_argument(
        "--gust",
        type=float,
        default=7.7,
        metavar="SPEED",
        help="wind 20 feet above the ground whose turbulence is flown in [m/s]; default: 7.7, light",
    )
    parser.add_argument(
        "--jobs", type=int, metavar="N", help="flights at a time; default: the computer's cores"
    )
    parser.add_argument(
        "--plot",
        type=Path,
        metavar="FILE.png",
        help=f"draw commanded and flown rates of the first flights of: {', '.join(DRAWN)}",
    )
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")


def run(args: argparse.Namespace) -> int:
    """Fly everybody and print the figures."""
    from neuroflight.cli.output import check_output, command_line
    from neuroflight.sim.aircraft.model import load_aircraft
    from neuroflight.sim.flight.manoeuvres import SETTLE_S
    from neuroflight.training.evaluation.manoeuvres import Air, document

    check_controllers(args.contenders)
    check_output(args.plot, ".png")
    check_ranges(
        ("--seeds", args.seeds, 1, SEEDS_MAX),
        ("--seed", args.seed, 0, 2**31),
        ("--battery", args.battery, 0.0, 1.0),
        ("--gust", args.gust, 0.0, GUST_MAX),
        ("--jobs", args.jobs, 1, 1024),
    )
    aircraft = load_aircraft(args.aircraft)
    air = Air(args.battery, args.gust)
    flown = _fly(args, aircraft, air)
    if args.plot:
        _plot(args, aircraft, air, flown)
    if not args.json:
        _print(args, aircraft, flown)
        return 0
    told = {
        "command": command_line(
            "manoeuvres",
            *args.contenders,
            aircraft=args.aircraft,
            seeds=args.seeds,
            seed=args.seed,
            battery=args.battery,
            gust=args.gust,
        ),
        "aircraft": aircraft.name,
        "aircraft_sha256": aircraft.sha256,
        "manoeuvres": {
            "seeds": args.seeds,
            "seed": args.seed,
            "descents": _descents(args),
            "battery": args.battery,
            "gust_m_s": args.gust,
            "settle_s": SETTLE_S,
            "contenders": document(flown),
        },
    }
    print(json.dumps(told, indent=2))
    return 0


def _fly(args: argparse.Namespace, aircraft: Aircraft, air: Air) -> list[Flown]:
    """The curves of all, then all flights, in processes of their own."""
    from neuroflight.sim.flight.manoeuvres import MANOEUVRES
    from neuroflight.training.evaluation.manoeuvres import Flown, fly_descent, fly_manoeuvre, thrust_curve

    contenders = _contenders(args, aircraft)
    say_foreign(contenders)
    seeds = range(args.seed, args.seed + args.seeds)
    curves = _all(
        args, "thrust at rest", [partial(thrust_curve, one, aircraft, air, args.seed) for one in contenders]
    )
    pairs = list(zip(contenders, curves, strict=True))
    flights = _all(
        args,
        "manoeuvres",
        [
            partial(fly_manoeuvre, one, aircraft, air, manoeuvre, curve, seed)
            for one, curve in pairs
            for manoeuvre in MANOEUVRES
            for seed in seeds
        ],
    )
    descents = _all(
        args,
        "descents",
        [
            partial(fly_descent, one, aircraft, air, curve, seed)
            for one, curve in pairs
            for seed in seeds[: _descents(args)]
        ],
    )
    flight, descent = iter(flights), iter(descents)
    return [
        Flown(
            one,
            curve,
            {each.name: tuple(next(flight) for _ in seeds) for each in MANOEUVRES},
            tuple(next(descent) for _ in range(_descents(args))),
        )
        for one, curve in pairs
    ]


def _plot(args: argparse.Namespace, aircraft: Aircraft, air: Air, flown: Sequence[Flown]) -> None:
    """Fly the first seed of some manoeuvres again, as it was flown, and draw it."""
    import numpy as np

    from neuroflight.sim.flight.manoeuvres import MANOEUVRES
    from neuroflight.sim.plotting import save_png
    from neuroflight.training.evaluation.manoeuvres import trace_manoeuvre
    from neuroflight.training.evaluation.manoeuvres_plot import Shown, draw

    pairs = [(each, one) for each in MANOEUVRES if each.name in DRAWN for one in flown]
    tasks = [
        partial(trace_manoeuvre, one.contender, aircraft, air, each, one.curve, args.seed)
        for each, one in pairs
    ]
    traces = _all(args, "pictures", tasks)
    shown = [
        Shown(
            each.name,
            one.contender.label,
            trace.t,
            np.rad2deg(trace.setpoint.astype(np.float64)),
            np.rad2deg(trace.rate.astype(np.float64)),
        )
        for (each, one), trace in zip(pairs, traces, strict=True)
    ]
    save_png(args.plot, draw(shown, f"{aircraft.name}: manoeuvres at equal thrust, seed {args.seed}"))


def _descents(args: argparse.Namespace) -> int:
    return min(int(args.seeds), DESCENTS)


def _contenders(args: argparse.Namespace, aircraft: Aircraft) -> list[Contender]:
    """All of them; Betaflight is built if it is not there, whose stages go to stderr."""
    from neuroflight.cli.sim.fly_ports import BETAFLIGHT as FOLDER
    from neuroflight.sim.ports.betaflight.build import build_betaflight
    from neuroflight.training.evaluation.manoeuvres import betaflight_contender, load_contender

    found = []
    for name in args.contenders:
        if is_betaflight(name):
            tune = betaflight_tune(name, args.aircraft)
            built = build_betaflight(
                FOLDER, lambda stage: print(f"Betaflight is not built yet, once: {stage}", file=sys.stderr)
            )
            found.append(betaflight_contender(name, aircraft, built, tune))
        else:
            found.append(load_contender(name, aircraft))
    return found


def _all(args: argparse.Namespace, title: str, tasks: Sequence[Callable[[Show], T]]) -> list[T]:
    """Results of all tasks, in their order."""
    import neuroflight.sim.physics.twin  # noqa: F401 - once, before the processes are forked

    jobs = usable_cores() if args.jobs is None else args.jobs
    with _bar(args, title, len(tasks)) as shows, Crew(tasks, jobs) as crew:
        return crew.results(shows)


@contextmanager
def _bar(args: argparse.Namespace, title: str, count: int) -> Iterator[list[Show]]:
    """One bar for `count` tasks on stderr, hidden with --json or in a log: what hears of each."""
    from rich.console import Console
    from rich.progress import Progress

    quiet = args.json or not sys.stderr.isatty()
    parts = [0.0] * count
    with Progress(console=Console(stderr=True), transient=True, disable=quiet) as bars:
        task = bars.add_task(title, total=float(count))

        def show(number: int, part: float) -> None:
            parts[number] = part
            bars.update(task, completed=sum(parts))

        yield [partial(show, number) for number in range(count)]


def _print(args: argparse.Namespace, aircraft: Aircraft, flown: Sequence[Flown]) -> None:
    from neuroflight.cli.output import print_table

    rows: list[tuple[str, ...]] = [("", *(heading for heading, _, _ in COLUMNS))]
    for name in flown[0].manoeuvres:
        rows.append((name, *("" for _ in COLUMNS)))
        for index, one in enumerate(flown):
            rows.append((f"  {one.contender.label}", *_cells(flown, index, name, one.manoeuvres[name])))
    title = (
        f"{aircraft.name}: {args.seeds} flights each from seed {args.seed}, free, battery charged to "
        f"{100 * args.battery:g} %, gusts of a wind of {args.gust:g} m/s"
    )
    print_table(title, rows, NOTE)
    print_table("", _descent_rows(flown), "Level, the throttle closed for ten seconds from the hover.")


def _cells(flown: Sequence[Flown], index: int, name: str, flights: Sequence[ManoeuvreFigures]) -> list[str]:
    from neuroflight.training.evaluation.manoeuvres import COMPARED, means, significant, winner

    found, cells = means(flights), []
    for _, figure, digits in COLUMNS:
        mark = ""
        if figure in COMPARED and len(flown) > 1 and winner(flown, name, figure) == index:
            mark = "** " if significant(flown, name, figure, index) else "* "
        cells.append(mark + _interval(found[figure], digits, figure in COMPARED))
    return cells


def _descent_rows(flown: Sequence[Flown]) -> list[tuple[str, ...]]:
    from neuroflight.training.evaluation.manoeuvres import means

    rows: list[tuple[str, ...]] = [("", "thrust, throttle closed", "throttle of the hover", "sinks, m/s")]
    for one in flown:
        sink = _interval(means(one.descents)["sink_m_s"], 1, True)
        hover = f"{one.curve.throttle_of(1.0):.3f}"
        rows.append((one.contender.label, f"{one.curve.thrust[0]:.2f}", hover, sink))
    return rows


def _interval(mean: Mean, digits: int, with_margin: bool) -> str:
    value = f"{float(mean.value):,.{digits}f}"
    return f"{value} ± {float(mean.high - mean.low) / 2:,.{digits}f}" if with_margin else value
