"""`neuroflight dyno bench`: drive a rotor on a dynamometer through a flight controller, beside a sensor."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Annotated, Any

from neuroflight.cli.dyno.repeats import print_repeats
from neuroflight.cli.options import PORT_HELP, Json, find_port, picture
from neuroflight.cli.progress import progress_bars
from neuroflight.cli.report import print_json
from neuroflight.cli.requests import Option, Request
from neuroflight.toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from neuroflight.sim.identification.bench.drive import Sensor
    from neuroflight.sim.identification.bench.guard import Limits
    from neuroflight.sim.identification.bench.plan import BenchPlan, Run
    from neuroflight.sim.identification.bench.quantities import Rig
    from neuroflight.sim.identification.bench.session import Told

CLEAR = "bench clear"
LIMIT_DEFAULT = 0.5
LIMITS = {  # option: field of Limits, column that it needs, what it is
    "max_rpm": ("rpm_max", None, "rotor speed"),
    "max_thrust": ("thrust_max_n", None, "thrust"),
    "max_torque": ("torque_max_n_m", None, "torque"),
    "max_amps": ("amps_max", "amps", "current"),
    "max_temperature": ("temperature_max_c", "temperature_c", "temperature"),
    "min_volts": ("volts_min", "volts", "voltage"),
}
Experiment = Annotated[str, Option(None, "what the rotor runs through", choices=("steps", "ramp", "all"))]


@dataclass(frozen=True, kw_only=True)
class OfSensor(Request):
    """A request about a dynamometer's sensor."""

    sensor: Annotated[str, Option("PORT", "serial:DEVICE[:BAUD] or a device such as /dev/ttyACM0")]
    columns: Annotated[
        str | None, Option("NAME,NAME", "of the sensor's lines, where it sends no heading")
    ] = None

    @contextmanager
    def opened(self) -> Iterator[Sensor]:
        """Yield the sensor, once it sends readings."""
        from neuroflight.flash.link.transport import open_transport
        from neuroflight.sim.identification.bench.drive import Sensor
        from neuroflight.sim.identification.bench.sensor import LineReader, parse_layout

        layout = parse_layout(self.columns.split(",")) if self.columns is not None else None
        line = open_transport(self.sensor)
        try:
            sensor = Sensor(line, LineReader(layout), monotonic)
            sensor.await_rows()
            yield sensor
        finally:
            line.close()


@dataclass(frozen=True, kw_only=True)
class Bench(OfSensor):
    """A request to drive a rotor on a dynamometer."""

    port: Annotated[str, Option("PORT", f"of the flight controller, for MSP: {PORT_HELP}", find=find_port)]
    cells: Annotated[Path | None, Option("FILE.toml", "load cells, by `dyno calibrate`")] = None
    blades: Annotated[
        int | None, Option("N", "pulses a revolution, where they are counted", low=1, high=12)
    ] = None
    window_ms: Annotated[
        float | None,
        Option("MS", "over which pulses are averaged (default 20, or 40)", low=1.0, high=500.0, unit="ms"),
    ] = None
    motor: Annotated[int, Option("N", "the motor on the rig (default 1)", low=1, high=8)] = 1
    experiment: Experiment = "all"
    repeats: Annotated[int | None, Option("N", "of each experiment (default 20)", low=1, high=99)] = None
    hold: Annotated[
        float | None,
        Option("S", "each level, and the rest after it (default 1)", low=1.0, high=10.0, unit="s"),
    ] = None
    ramp: Annotated[
        float | None, Option("S", "a ramp, up and down (default 40)", low=4.0, high=300.0, unit="s")
    ] = None
    limit: Annotated[
        float | None,
        Option(
            "FRACTION",
            "throttle of the largest step and of the ramp's top (default 0.5; 1 with --full)",
            low=0.1,
            high=1.0,
            name="--top-throttle",
            old=("--limit",),
        ),
    ] = None
    full: Annotated[bool, Option(None, "allow a --top-throttle above 0.5")] = False
    max_rpm: Annotated[float | None, Option("RPM", "stop at a rotor speed above this", above=0.0)] = None
    max_thrust: Annotated[float | None, Option("N", "stop at a thrust above this", above=0.0)] = None
    max_torque: Annotated[float | None, Option("N_M", "stop at a torque above this", above=0.0)] = None
    max_amps: Annotated[float | None, Option("A", "stop at a current above this", above=0.0)] = None
    max_temperature: Annotated[
        float | None, Option("DEG_C", "stop at a temperature above this", above=0.0)
    ] = None
    min_volts: Annotated[float | None, Option("V", "stop at a voltage below this", above=0.0)] = None
    time_limit: Annotated[
        float, Option("S", "stop after so long (default 1800)", above=0.0, high=1e6, unit="s")
    ] = 1800.0
    bench_clear: Annotated[
        bool, Option(None, "you have seen that the rig is guarded and nobody is near; else it is asked for")
    ] = False
    out: Annotated[Path, Option("DATA.csv", "for `dyno fit`", suffix=".csv")]
    resume: Annotated[bool, Option(None, "make the runs that an interrupted one lacks")] = False
    plot: Annotated[Path | None, picture("draw all repeats and their mean")] = None
    json: Json = False

    def run(self) -> int:
        """Make the runs, join them, print their figures. Returns 0."""
        from neuroflight.sim.identification.bench.plan import check_folder, joined, missing_runs, read_runs
        from neuroflight.sim.identification.dyno.recording import write_recording
        from neuroflight.toolchain.files import claimed_file

        limit = _limit(self)
        folder = self.out.with_suffix(".runs")
        with claimed_file(self.out, "dynamometer"), self.opened() as sensor:
            rig = _rig(self, sensor)
            limits = _limits(self, rig)
            plan = _plan(self, limit, rig)
            check_folder(plan, folder, self.resume)
            missing = missing_runs(plan, folder)
            if missing:
                _check_time(self, plan, missing)
                _confirm(self, plan, missing, limits)
                _turn(self, plan, missing, folder, rig, limits, sensor)
            runs = {kind: [run for run in plan.runs() if run.kind == kind] for kind in plan.kinds}
            recordings = {kind: read_runs(folder, each) for kind, each in runs.items()}
            whole = joined([recording for group in recordings.values() for recording in group])
            write_recording(self.out, whole)
            bad = sensor.reader.bad
        if self.plot:
            from neuroflight.sim.identification.bench.plot import save_bench_plot

            save_bench_plot(self.plot, recordings, f"{self.out.name}: {plan.repeats} repeats on the bench")
        _print(self, plan, recordings, len(whole.time), bad, folder)
        return 0


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


def _limit(args: Bench) -> float:
    limit = args.limit if args.limit is not None else (1.0 if args.full else LIMIT_DEFAULT)
    if limit > LIMIT_DEFAULT and not args.full:
        raise NeuroflightError(
            f"--top-throttle {limit:g}, expected at most {LIMIT_DEFAULT:g} without --full; give --full if "
            f"the rig bears the thrust of full throttle"
        )
    return limit


def _rig(args: Bench, sensor: Sensor) -> Rig:
    from neuroflight.sim.identification.bench.load_cell import read_load_cells
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
    window = usual_window(layout) if args.window_ms is None else args.window_ms / 1000
    cells = read_load_cells(args.cells, CELLS) if args.cells is not None else {}
    rig = Rig(layout, cells, blades, window)
    check_rig(rig)
    return rig


def _limits(args: Bench, rig: Rig) -> Limits:
    from neuroflight.sim.identification.bench.guard import Limits

    given = {}
    for option, (field, column, _) in LIMITS.items():
        value = getattr(args, option)
        if value is None:
            continue
        name = f"--{option.replace('_', '-')}"
        if column is not None and not rig.layout.has(column):
            raise NeuroflightError(
                f"{name} {value:g}: the sensor sends no {column}, expected it among "
                f"{', '.join(rig.layout.names)}; leave the limit out, and watch the rig yourself"
            )
        given[field] = value
    return Limits(**given)


def _plan(args: Bench, limit: float, rig: Rig) -> BenchPlan:
    from dataclasses import asdict

    from neuroflight.sim.identification.bench.plan import HOLD_S, RAMP_S, REPEATS, BenchPlan
    from neuroflight.sim.identification.dyno.bench import KINDS

    repeats = REPEATS if args.repeats is None else args.repeats
    hold = HOLD_S if args.hold is None else args.hold
    ramp = RAMP_S if args.ramp is None else args.ramp
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


def _check_time(args: Bench, plan: BenchPlan, missing: tuple[Run, ...]) -> None:
    takes = plan.seconds(missing)
    if takes > args.time_limit:
        raise NeuroflightError(
            f"{len(missing)} runs take {takes:.0f} s, expected at most {args.time_limit:g} s; give fewer "
            f"--repeats or a longer --time-limit"
        )


def _confirm(args: Bench, plan: BenchPlan, missing: tuple[Run, ...], limits: Limits) -> None:
    """Have a person confirm. Raises NeuroflightError without that."""
    if args.bench_clear:
        return
    if not sys.stdin.isatty():
        raise NeuroflightError(
            "nobody confirmed that the rig is guarded and clear, expected it before a motor turns; type it "
            "at a terminal, or give --bench-clear; no motor was turned"
        )
    unset = [what for field, _, what in LIMITS.values() if abs(getattr(limits, field)) == float("inf")]
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
    args: Bench,
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
def _progress(args: Bench, plan: BenchPlan, missing: tuple[Run, ...]) -> Iterator[Told]:
    with progress_bars(args.json) as bar:
        show = bar("")

        def told(run: Run, elapsed: float, throttle: float, rpm: float) -> None:
            done = missing.index(run)
            text = f"{run.name}, {done + 1} of {len(missing)}: {throttle:4.0%} {rpm:7,.0f} rpm"
            show(plan.seconds(missing[:done]) + elapsed, plan.seconds(missing), text)

        yield told


def _print(
    args: Bench, plan: BenchPlan, recordings: dict[str, list[Any]], rows: int, bad: int, folder: Path
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
        print_json(document)
        return
    print_repeats(f"{args.out}: {rows} rows, {plan.repeats} repeats; mean ± 95 % interval", steps, top)
    if bad:
        print(f"{bad} lines of the sensor were no reading and were passed over")
