"""`neuroflight dyno bench`: drive a rotor on a dynamometer through a flight controller, beside a sensor."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

from neuroflight.cli.dyno.repeats import print_repeats
from neuroflight.cli.options import PORT_HELP, add_port
from neuroflight.cli.output import check_output
from neuroflight.toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from neuroflight.sim.identification.bench.drive import Sensor
    from neuroflight.sim.identification.bench.guard import Limits
    from neuroflight.sim.identification.bench.plan import BenchPlan, Run
    from neuroflight.sim.identification.bench.quantities import Rig
    from neuroflight.sim.identification.bench.session import Told

CLEAR = "bench clear"
LIMIT_DEFAULT, LIMIT_MIN = 0.5, 0.1
TIME_LIMIT_S = 1800.0
LIMITS = {  # option: field of Limits, column that it needs, what it is
    "max_rpm": ("rpm_max", None, "RPM", "rotor speed"),
    "max_thrust": ("thrust_max_n", None, "N", "thrust"),
    "max_torque": ("torque_max_n_m", None, "N_M", "torque"),
    "max_amps": ("amps_max", "amps", "A", "current"),
    "max_temperature": ("temperature_max_c", "temperature_c", "DEG_C", "temperature"),
    "min_volts": ("volts_min", "volts", "V", "voltage"),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the ports, the experiment, the limits and the output."""
    add_sensor(parser)
    add_port(parser, f"of the flight controller, for MSP: {PORT_HELP}")
    parser.add_argument("--cells", type=Path, metavar="FILE.toml", help="load cells, by `dyno calibrate`")
    parser.add_argument("--blades", type=int, metavar="N", help="pulses a revolution, where they are counted")
    parser.add_argument(
        "--window-ms", type=float, metavar="MS", help="over which pulses are averaged (default 20, or 40)"
    )
    parser.add_argument("--motor", type=int, default=1, metavar="N", help="the motor on the rig (default 1)")
    parser.add_argument("--experiment", choices=["steps", "ramp", "all"], default="all")
    parser.add_argument("--repeats", type=int, metavar="N", help="of each experiment (default 20)")
    parser.add_argument(
        "--hold", type=float, metavar="S", help="each level, and the rest after it (default 1)"
    )
    parser.add_argument("--ramp", type=float, metavar="S", help="a ramp, up and down (default 40)")
    parser.add_argument(
        "--limit",
        type=float,
        metavar="FRACTION",
        help="throttle of the largest step and of the ramp's top (default 0.5; 1 with --full)",
    )
    parser.add_argument("--full", action="store_true", help="allow a --limit above 0.5")
    for option, (_, _, unit, what) in LIMITS.items():
        side = "below" if option.startswith("min") else "above"
        name = f"--{option.replace('_', '-')}"
        parser.add_argument(name, type=float, metavar=unit, help=f"stop at a {what} {side} this")
    parser.add_argument(
        "--time-limit",
        type=float,
        default=TIME_LIMIT_S,
        metavar="S",
        help="stop after so long (default 1800)",
    )
    parser.add_argument(
        "--bench-clear",
        action="store_true",
        help="you have seen that the rig is guarded and nobody is near; else it is asked for",
    )
    parser.add_argument("--out", type=Path, required=True, metavar="DATA.csv", help="for `dyno fit`")
    parser.add_argument("--resume", action="store_true", help="make the runs that an interrupted one lacks")
    parser.add_argument("--plot", type=Path, metavar="FILE.png", help="draw all repeats and their mean")
    parser.add_argument("--json", action="store_true", help="print JSON instead of tables")


def add_sensor(parser: argparse.ArgumentParser) -> None:
    """Declare the sensor's port."""
    parser.add_argument(
        "--sensor",
        required=True,
        metavar="PORT",
        help="serial:DEVICE[:BAUD] or a device such as /dev/ttyACM0",
    )
    parser.add_argument(
        "--columns", metavar="NAME,NAME", help="of the sensor's lines, where it sends no heading"
    )


def run(args: argparse.Namespace) -> int:
    """Make the runs, join them, print their figures. Returns 0."""
    from neuroflight.sim.identification.bench.plan import check_folder, joined, missing_runs, read_runs
    from neuroflight.sim.identification.dyno.recording import write_recording
    from neuroflight.toolchain.files import claimed_file

    check_output(args.out, ".csv")
    check_output(args.plot, ".png")
    limit = _limit(args)
    folder = args.out.with_suffix(".runs")
    with claimed_file(args.out, "dynamometer"), open_sensor(args) as sensor:
        rig = _rig(args, sensor)
        limits = _limits(args, rig)
        plan = _plan(args, limit, rig)
        check_folder(plan, folder, args.resume)
        missing = missing_runs(plan, folder)
        if missing:
            _check_time(args, plan, missing)
            _confirm(args, plan, missing, limits)
            _turn(args, plan, missing, folder, rig, limits, sensor)
        recordings = {
            kind: read_runs(folder, [run for run in plan.runs() if run.kind == kind]) for kind in plan.kinds
        }
        whole = joined([recording for group in recordings.values() for recording in group])
        write_recording(args.out, whole)
        bad = sensor.reader.bad
    if args.plot:
        from neuroflight.sim.identification.bench.plot import save_bench_plot

        save_bench_plot(args.plot, recordings, f"{args.out.name}: {plan.repeats} repeats on the bench")
    _print(args, plan, recordings, len(whole.time), bad, folder)
    return 0


@contextmanager
def open_sensor(args: argparse.Namespace) -> Iterator[Sensor]:
    """Yield the sensor, once it sends readings."""
    from neuroflight.flash.link.transport import open_transport
    from neuroflight.sim.identification.bench.drive import Sensor
    from neuroflight.sim.identification.bench.sensor import LineReader, parse_layout

    layout = parse_layout(args.columns.split(",")) if args.columns is not None else None
    line = open_transport(args.sensor)
    try:
        sensor = Sensor(line, LineReader(layout), monotonic)
        sensor.await_rows()
        yield sensor
    finally:
        line.close()


def _check(name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:  # NaN included
        raise NeuroflightError(f"{name} {value:g}, expected {low:g} to {high:g}")


def _limit(args: argparse.Namespace) -> float:
    limit = float(args.limit) if args.limit is not None else (1.0 if args.full else LIMIT_DEFAULT)
    _check("--limit", limit, LIMIT_MIN, 1.0)
    if limit > LIMIT_DEFAULT and not args.full:
        raise NeuroflightError(
            f"--limit {limit:g}, expected at most {LIMIT_DEFAULT:g} without --full; give --full if the rig "
            f"bears the thrust of full throttle"
        )
    return limit


def _rig(args: argparse.Namespace, sensor: Sensor) -> Rig:
    from neuroflight.sim.identification.bench.load_cell import read_load_cells
    from neuroflight.sim.identification.bench.pulses import BLADES_MAX, BLADES_MIN
    from neuroflight.sim.identification.bench.quantities import Rig, check_rig, usual_window
    from neuroflight.sim.identification.bench.sensor import CELLS

    layout = sensor.reader.layout
    assert layout is not None  # a layout is known once rows arrive
    blades = args.blades
    if blades is None:
        if layout.has("pulses"):
            raise NeuroflightError(
                "the sensor counts pulses, expected how many a revolution are; give --blades N: the "
                "propeller's blades, or the marks that pass"
            )
        blades = 1
    _check("--blades", blades, BLADES_MIN, BLADES_MAX)
    window = usual_window(layout) if args.window_ms is None else args.window_ms / 1000
    _check("--window-ms", 1000 * window, 1, 500)
    cells = read_load_cells(args.cells, CELLS) if args.cells is not None else {}
    rig = Rig(layout, cells, blades, window)
    check_rig(rig)
    return rig


def _limits(args: argparse.Namespace, rig: Rig) -> Limits:
    from neuroflight.sim.identification.bench.guard import Limits

    given = {}
    for option, (field, column, _, _) in LIMITS.items():
        value = getattr(args, option)
        if value is None:
            continue
        name = f"--{option.replace('_', '-')}"
        _check(name, value, 1e-6, 1e6)
        if column is not None and not rig.layout.has(column):
            raise NeuroflightError(
                f"{name} {value:g}: the sensor sends no {column}, expected it among "
                f"{', '.join(rig.layout.names)}; leave the limit out, and watch the rig yourself"
            )
        given[field] = value
    return Limits(**given)


def _plan(args: argparse.Namespace, limit: float, rig: Rig) -> BenchPlan:
    from dataclasses import asdict

    from neuroflight.sim.identification.bench.plan import HOLD_S, RAMP_S, REPEATS, BenchPlan
    from neuroflight.sim.identification.dyno.bench import KINDS

    repeats = REPEATS if args.repeats is None else args.repeats
    hold = HOLD_S if args.hold is None else args.hold
    ramp = RAMP_S if args.ramp is None else args.ramp
    _check("--repeats", repeats, 1, 99)
    _check("--hold", hold, 1, 10)
    _check("--ramp", ramp, 4, 300)
    _check("--motor", args.motor, 1, 8)
    return BenchPlan(
        kinds=KINDS if args.experiment == "all" else (args.experiment,),
        repeats=repeats,
        limit=limit,
        hold_s=hold,
        ramp_s=ramp,
        motor=args.motor,
        blades=rig.blades,
        window_s=rig.window_s,
        columns=rig.layout.names,
        cells={name: asdict(rig.cells[name]) for name in rig.raw()},
    )


def _check_time(args: argparse.Namespace, plan: BenchPlan, missing: tuple[Run, ...]) -> None:
    takes = plan.seconds(missing)
    if not 0 < args.time_limit < 1e6:
        raise NeuroflightError(f"--time-limit {args.time_limit:g}, expected above 0 to 1e6 s")
    if takes > args.time_limit:
        raise NeuroflightError(
            f"{len(missing)} runs take {takes:.0f} s, expected at most {args.time_limit:g} s; give fewer "
            f"--repeats or a longer --time-limit"
        )


def _confirm(args: argparse.Namespace, plan: BenchPlan, missing: tuple[Run, ...], limits: Limits) -> None:
    """Have a person confirm. Raises NeuroflightError without that."""
    if args.bench_clear:
        return
    if not sys.stdin.isatty():
        raise NeuroflightError(
            "nobody confirmed that the rig is guarded and clear, expected it before a motor turns; type it "
            "at a terminal, or give --bench-clear; no motor was turned"
        )
    unset = [what for field, _, _, what in LIMITS.values() if abs(getattr(limits, field)) == float("inf")]
    print(
        f"Motor {plan.motor} will turn {len(missing)} times with its propeller, up to {plan.limit:.0%} "
        f"throttle, for {plan.seconds(missing):.0f} s in all.\n"
        f"No limit is set for: {', '.join(unset) or 'nothing'}.\n"
        "Clamp the rig down, put the guard up, keep everybody out of the propeller's plane.\n"
        f'Type "{CLEAR}" to begin: ',
        end="",
        file=sys.stderr,
        flush=True,
    )
    if sys.stdin.readline().strip() != CLEAR:
        raise NeuroflightError(f'not confirmed, expected "{CLEAR}"; no motor was turned')


def _turn(
    args: argparse.Namespace,
    plan: BenchPlan,
    missing: tuple[Run, ...],
    folder: Path,
    rig: Rig,
    limits: Limits,
    sensor: Sensor,
) -> None:
    from neuroflight.flash.board.info import check_api
    from neuroflight.flash.link.client import Client
    from neuroflight.flash.link.transport import open_transport
    from neuroflight.flash.motors.bench import MotorBench
    from neuroflight.sim.identification.bench.session import run_session

    with Client(open_transport(args.port), monotonic) as client, _progress(args, plan, missing) as told:
        check_api(client)
        run_session(
            plan,
            folder,
            rig,
            limits,
            lambda: MotorBench(client, plan.motor - 1, plan.limit),
            sensor,
            monotonic,
            monotonic() + args.time_limit,
            told,
        )


@contextmanager
def _progress(args: argparse.Namespace, plan: BenchPlan, missing: tuple[Run, ...]) -> Iterator[Told]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    quiet = args.json or not sys.stderr.isatty()
    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True, disable=quiet) as bar:
        task = bar.add_task("", total=plan.seconds(missing))

        def told(run: Run, elapsed: float, throttle: float, rpm: float) -> None:
            done = missing.index(run)
            text = f"{run.name}, {done + 1} of {len(missing)}: {throttle:4.0%} {rpm:7,.0f} rpm"
            bar.update(task, completed=plan.seconds(missing[:done]) + elapsed, description=text)

        yield told


def _print(
    args: argparse.Namespace,
    plan: BenchPlan,
    recordings: dict[str, list[Any]],
    rows: int,
    bad: int,
    folder: Path,
) -> None:
    from dataclasses import asdict

    from neuroflight.sim.identification.bench.summary import peak, step_figures

    steps = step_figures(recordings.get("steps", []))
    top = peak(recordings["ramp"]) if "ramp" in recordings else None
    if args.json:
        document = {
            "out": str(args.out),
            "runs": str(folder),
            "rows": rows,
            "repeats": plan.repeats,
            "limit": plan.limit,
            "unreadable_lines": bad,
            "steps": [asdict(item) for item in steps],
            "ramp_top": None if top is None else asdict(top),
        }
        print(json.dumps(document, indent=2))
        return
    print_repeats(f"{args.out}: {rows} rows, {plan.repeats} repeats; mean ± 95 % interval", steps, top)
    if bad:
        print(f"{bad} lines of the sensor were no reading and were passed over")
