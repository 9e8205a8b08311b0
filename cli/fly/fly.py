"""`neuroflight fly`: the firmware and a PID fly the same scenario in the same twin, side by side."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from neuroflight.cli.fly.blackbox import add_blackbox_argument, check_blackbox
from neuroflight.cli.fly.emulator import (
    add_emulator_arguments,
    check_emulator,
    emulator_words,
    exit_code,
    keep,
    say,
)
from neuroflight.cli.fly.output import (
    Flown,
    conditions,
    document,
    print_flight,
    print_several,
    sentence,
)
from neuroflight.cli.fly.ports import (
    RECEIVERS,
    Entry,
    built_firmware,
    foreign_note,
    open_firmware,
    open_pid,
    prepare,
    quiet,
)
from neuroflight.cli.fly.telemetry import (
    add_telemetry_arguments,
    asks_telemetry,
    check_telemetry,
    save_telemetry,
)
from neuroflight.cli.fly.thrust import Thrust, add_throttle_argument, chosen_thrust
from neuroflight.cli.log.reading import add_recording_arguments, header_lines, part
from neuroflight.cli.options import ON, ON_HELP, machine
from neuroflight.toolchain.contract import GYRO_RATE_DEFAULT_HZ, GYRO_RATES_HZ
from neuroflight.toolchain.errors import NeuroflightError
from neuroflight.toolchain.workers import Crew, Show, usable_cores

if TYPE_CHECKING:
    from rich.progress import TaskID

    from neuroflight.sim.aircraft.model import Aircraft
    from neuroflight.sim.flight.scenario import Scenario
    from neuroflight.sim.flight.trace import Trace

MOUNTS = ("centre", "rig", "free")
CONTROLLERS = ("policy", "pid")
DEFAULT_AIRCRAFT = "nf1"
COUNT, COUNTED = 10, ("flight", "pulses")  # commands, of these scenarios
# Options that belong to one flight.
OUTPUTS = ("trace", "plot", "telemetry", "telemetry_plot", "report", "blackbox")
SINGLE = (*OUTPUTS, "profile", "gdb", "serial", "fault", "card")
WIND_MAX = 50.0  # [m/s]; beyond any wind that such an aircraft could fly in


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of a flight and its outputs."""
    parser.add_argument(
        "--on",
        type=machine,
        choices=ON,
        default="host",
        help=f"what flies; default host. {ON_HELP}",
    )
    parser.add_argument(
        "--build",
        type=Path,
        metavar="DIR",
        help="the build to fly; default: build/HOST, with board build/MATEKF722, with betaflight "
        "build/BETAFLIGHT",
    )
    parser.add_argument(
        "--controller",
        choices=CONTROLLERS,
        default=CONTROLLERS[0],
        help="what the pilot's switch chooses: the policy, or the PID that is built in beside it",
    )
    parser.add_argument(
        "--scenario",
        nargs="+",
        default=["flight"],
        metavar="NAME|FILE",
        help="flight (ten commands and a hover, the default), pulse, pulses, roll, flip, turns, sticks, "
        "freestyle, a .toml file, or a flight's recorded commands: a trace "
        "(.npz), a table (.csv), a blackbox log (.bbl, .bfl, .txt; FILE:N for its log N); of several only "
        "the firmware's flights, a row each",
    )
    add_recording_arguments(parser)
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="of commands, noise and bias")
    parser.add_argument(
        "--count",
        type=int,
        metavar="N",
        help=f"commands of `flight` and `pulses` ({COUNT})",
    )
    add_throttle_argument(parser)
    parser.add_argument(
        "--aircraft",
        metavar="NAME|FILE",
        help="whose twin is flown; default: the one that the firmware was built for",
    )
    parser.add_argument("--gyro-hz", type=int, choices=GYRO_RATES_HZ, default=GYRO_RATE_DEFAULT_HZ)
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="fly with this setting of the firmware, see docs/reference/settings.md",
    )
    parser.add_argument(
        "--receiver", choices=RECEIVERS, default=RECEIVERS[0], help="what brings the pilot's sticks"
    )
    parser.add_argument("--mount", choices=MOUNTS, help="what holds the aircraft; default: the scenario's")
    parser.add_argument(
        "--battery",
        type=float,
        nargs="?",
        const=1.0,
        metavar="CHARGE",
        help="fly on the aircraft's battery, charged so far, 0..1 (1); default: the bench supply",
    )
    parser.add_argument(
        "--wind",
        type=float,
        nargs=3,
        default=(0.0, 0.0, 0.0),
        metavar=("NORTH", "WEST", "UP"),
        help="where the air moves [m/s]",
    )
    parser.add_argument(
        "--gust",
        type=float,
        default=0.0,
        metavar="SPEED",
        help="wind 20 feet above the ground whose turbulence is flown in [m/s]; 7.7 light, 15.4 moderate",
    )
    parser.add_argument("--ground", action="store_true", help="put ground below; with mount free only")
    parser.add_argument("--trace", type=Path, metavar="FILE.npz", help="keep the firmware's flight")
    parser.add_argument("--plot", type=Path, metavar="FILE.png", help="draw it")
    add_telemetry_arguments(parser)
    parser.add_argument("--report", type=Path, metavar="FILE.html", help="plot and figures on one page")
    add_blackbox_argument(parser)
    parser.add_argument("--all", action="store_true", help="print every figure, not the five of most use")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    parser.add_argument(
        "--jobs",
        type=int,
        metavar="N",
        help="flights at a time, each in a process of its own; default: the computer's cores; they are the "
        "same with any N",
    )
    add_emulator_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Fly, write the outputs, print the figures. Returns 0, or STOPPED."""
    from neuroflight.sim.aircraft.model import load_aircraft
    from neuroflight.sim.analysis.flight_report import save_plot, save_report
    from neuroflight.sim.flight.trace import save_trace

    _check(args)
    firmware = built_firmware(args)
    known = None if firmware is None else firmware.aircraft
    aircraft = load_aircraft(args.aircraft or (DEFAULT_AIRCRAFT if known is None else known.file))
    if (note := foreign_note(args, firmware, aircraft)) is not None:
        say(note)
    thrust = chosen_thrust(args, aircraft, firmware)
    scenarios = _scenarios(args, thrust)
    prepare(args, aircraft)
    if len(scenarios) > 1:
        return _run_several(args, aircraft, scenarios, thrust)
    (scenario,) = scenarios
    flown = _fly_all(args, aircraft, scenario)
    flights = [one.flight for one in flown]
    title = f"{aircraft.name}: {scenario.name}, seed {args.seed}"
    note = ", ".join(conditions(args, scenario, thrust, flown[0].refused))
    verdict = sentence(scenario, thrust, flown)
    try:
        if args.trace:
            save_trace(args.trace, flights[0].trace)
        if args.plot:
            save_plot(args.plot, flights, title)
        save_telemetry(args, flown[0].esc, flights[0].trace.control_rate_hz, title)
        if args.report:
            words = f"{note}{emulator_words(flown[0].report)}. {verdict}"
            save_report(args.report, flights, title, words)
    finally:  # print the figures even if an output file cannot be written
        if args.json:
            print(json.dumps(document(args, aircraft, scenario, thrust, flown), indent=2))
        else:
            print_flight(title, note, flown, verdict, every=args.all)
    return exit_code(args, flown[0].report)


def _check(args: argparse.Namespace) -> None:
    """Check scenarios and output files before anything is loaded."""
    from neuroflight.cli.output import check_output

    for path, suffix in ((args.trace, ".npz"), (args.plot, ".png"), (args.report, ".html")):
        check_output(path, suffix)
    check_telemetry(args)
    _check_air(args)
    check_emulator(args)
    check_blackbox(args)
    if args.jobs is not None and args.jobs < 1:
        raise NeuroflightError(f"--jobs: got {args.jobs}, expected at least 1")
    if args.on == "betaflight" and args.set:
        raise NeuroflightError("--set: Betaflight has settings of its own; leave it out")
    if args.on == "betaflight" and args.receiver != RECEIVERS[0]:
        raise NeuroflightError("--receiver: Betaflight takes the sticks from the simulator; leave it out")
    if len(args.scenario) > 1:
        for name in SINGLE:
            if getattr(args, name) not in (None, []):
                option = name.replace("_", "-")
                raise NeuroflightError(f"--{option}: belongs to one flight; give one scenario")


def _scenarios(args: argparse.Namespace, thrust: Thrust) -> list[Scenario]:
    """Return the scenarios, in the order of flight."""
    from neuroflight.sim.physics.world import Mount
    from neuroflight.sim.recorded.files import load_flight

    if args.count is not None and not set(args.scenario) & set(COUNTED):
        say(f"--count: of {' and '.join(COUNTED)} alone; {', '.join(args.scenario)} has its own commands")
    count = COUNT if args.count is None else args.count
    mount = None if args.mount is None else Mount(args.mount)
    throttle = thrust.value or 0.0
    taken, told = part(args), header_lines(args)
    scenarios = []
    for name in args.scenario:
        scenario, warnings = load_flight(
            name, args.seed, count, mount, taken, told, cut=args.cut_rates, throttle=throttle
        )
        scenarios.append(scenario)
        for words in warnings:
            say(words)
    if args.controller == "pid":
        if args.on == "betaflight":
            raise NeuroflightError("--controller: Betaflight flies its own PID; leave it out")
        scenarios = [scenario.under_pid() for scenario in scenarios]
    for scenario in scenarios:
        if scenario.by_eye and not args.ground:
            raise NeuroflightError(f"scenario {scenario.name}: takes off and lands; add --ground")
        if args.ground and scenario.mount is not Mount.FREE:
            raise NeuroflightError(
                f"--ground: the aircraft hangs in mount {scenario.mount.value}, expected free; "
                f"add --mount free"
            )
    return scenarios


def _run_several(
    args: argparse.Namespace, aircraft: Aircraft, scenarios: list[Scenario], thrust: Thrust
) -> int:
    """Fly each scenario with the firmware, and print one table."""
    tasks = [_task(args, aircraft, scenario) for scenario in scenarios]
    names = [scenario.name for scenario in scenarios]
    flown = []
    if (jobs := _jobs(args)) == 1:
        for name, task in zip(names, tasks, strict=True):
            with _bar(args) as show:
                flown.append(task(show(name)))
    else:
        import neuroflight.sim.physics.twin  # noqa: F401 - once, before the processes are forked

        with Crew(tasks, jobs) as crew, _bar(args) as show:
            flown = crew.results([show(name) for name in names])
    if args.json:
        documents = [
            document(args, aircraft, scenario, thrust, [one])
            for scenario, one in zip(scenarios, flown, strict=True)
        ]
        print(json.dumps(documents, indent=2))
    else:
        print_several(f"{aircraft.name}, seed {args.seed}", args, scenarios, thrust, flown)
    return 0


def _task(args: argparse.Namespace, aircraft: Aircraft, scenario: Scenario) -> Callable[[Show], Flown]:
    """Return a function that flies `scenario` with the firmware from its boot on."""
    return lambda show: _fly(args, aircraft, scenario, open_firmware(args, aircraft), show)


def _jobs(args: argparse.Namespace) -> int:
    """Return the number of flights at a time; one where a debugger, serial line or profile is on."""
    if any(getattr(args, name) is not None for name in ("gdb", "serial", "profile")):
        return 1
    return usable_cores() if args.jobs is None else int(args.jobs)


@contextmanager
def _bar(args: argparse.Namespace) -> Iterator[Callable[[str], Show]]:
    """Show the progress of flights by name, on a terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description:<10}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True, disable=quiet(args)) as progress:

        def begin(name: str) -> Show:
            task: TaskID = progress.add_task(name, total=1.0)
            return lambda part: progress.update(task, completed=part)

        yield begin


def _fly_all(args: argparse.Namespace, aircraft: Aircraft, scenario: Scenario) -> list[Flown]:
    """Fly the firmware, and beside it the PID if the aircraft has gains for one."""
    import neuroflight.sim.physics.twin  # noqa: F401 - once, before a process is forked

    firmware = open_firmware(args, aircraft)
    with closing(firmware):
        rate_hz = firmware.port.control_rate_hz

        def beside(show: Show) -> Flown:
            return _fly(args, aircraft, scenario, open_pid(args, aircraft, rate_hz), show)

        if not aircraft.pids or _jobs(args) == 1:
            with _bar(args) as show:
                flown = [_fly(args, aircraft, scenario, firmware, show(firmware.name))]
                return [*flown, beside(show("PID"))] if aircraft.pids else flown
        with Crew([beside], 1) as crew, _bar(args) as show:
            here, there = show(firmware.name), show("PID")

            def both(part: float) -> None:
                here(part)
                for other in crew.poll().values():
                    there(other)

            return [_fly(args, aircraft, scenario, firmware, both), *crew.results([there])]


def _fly(
    args: argparse.Namespace,
    aircraft: Aircraft,
    scenario: Scenario,
    entry: Entry,
    progress: Show,
) -> Flown:
    """Fly once in a fresh twin of the seed, and close the port."""
    import numpy as np

    from neuroflight.sim.analysis.flight_report import Flight
    from neuroflight.sim.analysis.holding import holding
    from neuroflight.sim.analysis.metrics import figures
    from neuroflight.sim.analysis.stick_flight import stick_figures
    from neuroflight.sim.flight.esc_record import EscRecord
    from neuroflight.sim.flight.loop import fly
    from neuroflight.sim.flight.motion import Motion
    from neuroflight.sim.flight.trace import save_trace
    from neuroflight.sim.physics.twin import Twin

    rng = np.random.default_rng((args.seed, 1))  # another stream than the scenario's commands

    def broken_off(trace: Trace) -> None:
        """Write the trace up to an error, if it was asked for."""

        def write() -> None:
            save_trace(args.trace, trace)
            length = len(trace.t) / entry.port.control_rate_hz
            say(f"{args.trace}: {length:.3f} of {scenario.duration_s:g} s, up to the error")

        if args.trace is not None and entry.kept:
            keep("trace", write)

    with closing(entry):
        twin = Twin(
            aircraft,
            rate_hz=args.gyro_hz,
            mount=scenario.mount,
            charge=args.battery,
            wind=tuple(args.wind),
            gust=args.gust,
            ground=args.ground,
            rng=rng,
        )
        with closing(twin):
            try:
                motion, esc = Motion(twin), EscRecord(twin)
                watched = [motion] * scenario.by_eye + [esc] * asks_telemetry(args)

                def watch() -> None:
                    for one in watched:
                        one()

                trace = fly(
                    twin,
                    entry.port,
                    scenario,
                    progress=progress,
                    broken_off=broken_off,
                    logged=None if entry.log is None else entry.log.watch,
                    watch=watch,
                )
            except BaseException:  # an interruption by the user as well
                entry.on_error()
                if entry.log is not None:
                    keep("log", entry.log.rescue)
                raise
        log = None if entry.log is None else entry.log.report()
        report = None if entry.report is None else entry.report(scenario.duration_s)
        refused = None if entry.refused is None else entry.refused()
    progress(1.0)
    hover = round(scenario.hover_s * entry.port.control_rate_hz)
    before, held = len(trace.t) - hover, None
    if hover:
        count, step_s = scenario.episodes(), 1.0 / entry.port.control_rate_hz
        held = holding(trace.setpoint[None], trace.rate[None], step_s, count, before)
    name = entry.flies(scenario)
    flight = Flight(
        f"{name}, then PID" if refused else name,
        trace,
        figures(trace.first(before), scenario.episodes(), entry.idle, entry.mix),
        held,
        hover,
    )
    by_eye = stick_figures(scenario, motion, entry.port.control_rate_hz) if scenario.by_eye else None
    topics = esc.topics if asks_telemetry(args) else None
    return Flown(flight, report, log, by_eye, topics, refused.name if refused else None)


def _check_air(args: argparse.Namespace) -> None:
    """Check the ranges of battery, wind and gust."""
    if args.battery is not None and not 0.0 <= args.battery <= 1.0:
        raise NeuroflightError(f"--battery: got {args.battery:g}, expected a charge of 0 to 1")
    if not all(abs(speed) <= WIND_MAX for speed in args.wind):
        wind = " ".join(f"{speed:g}" for speed in args.wind)
        raise NeuroflightError(f"--wind: got {wind}, expected at most {WIND_MAX:g} m/s each way")
    if not 0.0 <= args.gust <= WIND_MAX:
        raise NeuroflightError(f"--gust: got {args.gust:g}, expected 0 to {WIND_MAX:g} m/s")
