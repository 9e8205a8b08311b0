"""`neuroflight fly`: the firmware and a PID fly the same scenario in the same twin, side by side."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from contextlib import closing, nullcontext
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from toolchain.contract import GYRO_RATE_DEFAULT_HZ, GYRO_RATES_HZ
from toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from rich.progress import TaskID

    from sim.aircraft import Aircraft
    from sim.port import FirmwarePort
    from sim.report import Flight
    from sim.scenario import Scenario

BUILD = Path(__file__).resolve().parents[2] / "build" / "HOST"
BETAFLIGHT, BOARD = BUILD.with_name("BETAFLIGHT"), BUILD.with_name("MATEKF722")
MOUNTS = ("centre", "rig", "free")
FIRMWARES = ("reference", "host", "emulator", "betaflight")
CONTROLLERS = ("policy", "pid")
COUNT, COUNT_BETAFLIGHT = 100, 10  # commands of `pulses`
WIND_MAX = 50.0  # [m/s]; beyond any wind that such an aircraft could fly in


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what flies, where, and what is kept."""
    parser.add_argument(
        "--on",
        choices=FIRMWARES,
        default="host",
        help="what runs the firmware: host, the program over UDP; reference, its C core as a library; "
        "emulator, the image for the MATEKF722 on an emulated board; "
        "betaflight, Betaflight with its default PID instead, fetched and built at first use",
    )
    parser.add_argument(
        "--build",
        type=Path,
        metavar="DIR",
        help="the build to fly; default: build/HOST, with emulator build/MATEKF722, with betaflight "
        "build/BETAFLIGHT",
    )
    parser.add_argument(
        "--controller",
        choices=CONTROLLERS,
        default=CONTROLLERS[0],
        help="what the pilot's switch chooses: the policy, or the PID that is built in beside it",
    )
    parser.add_argument(
        "--scenario", default="pulse", metavar="NAME|FILE", help="pulse, pulses, roll, flip or a .toml file"
    )
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="of commands, noise and bias")
    parser.add_argument(
        "--count",
        type=int,
        metavar="N",
        help=f"commands of `pulses`; default: {COUNT}, with betaflight {COUNT_BETAFLIGHT}",
    )
    parser.add_argument("--aircraft", default="nf1", metavar="NAME|FILE", help="whose twin is flown")
    parser.add_argument("--gyro-hz", type=int, choices=GYRO_RATES_HZ, default=GYRO_RATE_DEFAULT_HZ)
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
    parser.add_argument("--report", type=Path, metavar="FILE.html", help="plot and figures on one page")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")


def run(args: argparse.Namespace) -> int:
    """Fly, write what was asked for, print the figures. Returns 0."""
    from toolchain.cli.output import check_output

    for path, suffix in ((args.trace, ".npz"), (args.plot, ".png"), (args.report, ".html")):
        check_output(path, suffix)
    _check_air(args)

    from sim.aircraft import load_aircraft
    from sim.report import save_plot, save_report
    from sim.scenario import load_scenario
    from sim.trace import save_trace
    from sim.world import Mount

    aircraft = load_aircraft(args.aircraft)
    mount = None if args.mount is None else Mount(args.mount)
    default_count = COUNT_BETAFLIGHT if args.on == "betaflight" else COUNT
    count = default_count if args.count is None else args.count
    scenario = load_scenario(args.scenario, args.seed, count, mount)
    if args.controller == "pid":
        if args.on == "betaflight":
            raise NeuroflightError("--controller: Betaflight flies its own PID; leave it out")
        scenario = scenario.under_pid()
    if args.ground and scenario.mount is not Mount.FREE:
        raise NeuroflightError(
            f"--ground: the aircraft hangs in mount {scenario.mount.value}, expected free; add --mount free"
        )
    flights = _fly_all(args, aircraft, scenario)
    title = f"{aircraft.name}: {scenario.name}, seed {args.seed}"
    note = ", ".join(_conditions(args, scenario))
    if args.trace:
        save_trace(args.trace, flights[0].trace)
    if args.plot:
        save_plot(args.plot, flights, title)
    if args.report:
        save_report(args.report, flights, title, note)
    if args.json:
        print(json.dumps(_document(args, aircraft, scenario, flights), indent=2))
    else:
        _print(title, note, flights)
    return 0


@dataclass(frozen=True)
class _Entry:
    """A controller that takes part, freshly booted."""

    name: str
    port: FirmwarePort
    idle: float  # motor fraction of its armed motors at zero thrust
    own_mixer: bool = False  # it lays the throttle on by another rule than ours


def _fly_all(args: argparse.Namespace, aircraft: Aircraft, scenario: Scenario) -> list[Flight]:
    """The firmware's flight, then the PID's if the aircraft has gains for one."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description:<10}"), BarColumn(), TimeElapsedColumn())
    flights = []
    firmware = _open(args, aircraft)
    with (
        closing(firmware.port),
        Progress(*columns, console=Console(stderr=True), transient=True, disable=_quiet(args)) as progress,
    ):
        entries = [firmware]
        if aircraft.pids:
            entries.append(_pid(args, aircraft, firmware.port.control_rate_hz))
        for entry in entries:
            task = progress.add_task(entry.name, total=1.0)

            def show(part: float, task: TaskID = task) -> None:
                progress.update(task, completed=part)

            flights.append(_fly(args, aircraft, scenario, entry, show))
            show(1.0)
    return flights


def _open(args: argparse.Namespace, aircraft: Aircraft) -> _Entry:
    """What `--on` names."""
    from sim.host_port import HostPort
    from sim.port import twin_settings
    from sim.reference_port import ReferencePort
    from toolchain.report import built_idle

    if args.on == "betaflight":
        return _open_betaflight(args, aircraft)
    if args.on == "emulator":
        return _open_emulator(args, aircraft)
    name, kind = ("neuroflight", HostPort) if args.on == "host" else ("libneuroflight.so", ReferencePort)
    product = (args.build or BUILD) / name
    port: FirmwarePort = kind(product, args.gyro_hz, twin_settings(aircraft))
    try:
        return _Entry("firmware", port, built_idle(product, pid=args.controller == "pid"))
    except NeuroflightError:
        port.close()
        raise


def _open_emulator(args: argparse.Namespace, aircraft: Aircraft) -> _Entry:
    """The image on a board of its own, with the settings that it has when freshly flashed."""
    from sim.emulated_port import EmulatedPort
    from sim.port import setting_changes, twin_settings
    from toolchain.report import built_idle

    image = (args.build or BOARD) / "neuroflight.bin"
    changes = setting_changes(twin_settings(aircraft))
    if changes:
        raise NeuroflightError(
            f"--on emulator: aircraft {aircraft.name} needs the settings {', '.join(changes)}, the image "
            f"flies with its own; use --on host"
        )
    port = EmulatedPort(image, args.gyro_hz)
    try:
        return _Entry("firmware", port, built_idle(image, pid=args.controller == "pid"))
    except NeuroflightError:
        port.close()
        raise


def _open_betaflight(args: argparse.Namespace, aircraft: Aircraft) -> _Entry:
    """Betaflight, built first where it is not yet; each stage of that is told on stderr."""
    from rich.console import Console

    from sim.betaflight_build import build_betaflight
    from sim.betaflight_port import IDLE, BetaflightPort, aircraft_settings

    settings = aircraft_settings(aircraft)
    console = Console(stderr=True)
    with nullcontext() if _quiet(args) else console.status("Betaflight") as status:

        def say(stage: str) -> None:
            console.print(f"Betaflight is not built yet, once: {stage}", highlight=False)
            if status is not None:
                status.update(stage)

        betaflight = build_betaflight(args.build or BETAFLIGHT, say)
        port = BetaflightPort(betaflight, args.gyro_hz, settings)
    return _Entry("Betaflight", port, IDLE, own_mixer=True)


def _pid(args: argparse.Namespace, aircraft: Aircraft, control_rate_hz: int) -> _Entry:
    """The aircraft's PID behind the firmware's frame."""
    from sim.controller_port import ControllerPort
    from sim.pid import aircraft_pid, pid_settings

    idle = pid_settings(aircraft).idle
    pid = aircraft_pid(aircraft, 1, control_rate_hz)
    port = ControllerPort(pid, aircraft.motor_count, args.gyro_hz, control_rate_hz, idle)
    return _Entry("PID", port, idle)


def _fly(
    args: argparse.Namespace,
    aircraft: Aircraft,
    scenario: Scenario,
    entry: _Entry,
    progress: Callable[[float], None],
) -> Flight:
    """One flight in a fresh twin of the seed; closes the port."""
    import numpy as np

    from sim.loop import fly
    from sim.metrics import figures
    from sim.report import Flight
    from sim.twin import Twin

    rng = np.random.default_rng((args.seed, 1))  # another stream than the scenario's commands
    with closing(entry.port) as port:
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
            trace = fly(twin, port, scenario, progress=progress)
    # A mixer that is not ours cannot be undone: its output is then all that it asks of the motors.
    asked = replace(trace, throttle=np.zeros_like(trace.throttle)) if entry.own_mixer else trace
    return Flight(entry.name, trace, figures(asked, scenario.episodes(), entry.idle))


def _quiet(args: argparse.Namespace) -> bool:
    return bool(args.json) or not sys.stderr.isatty()


def _conditions(args: argparse.Namespace, scenario: Scenario) -> list[str]:
    """In words, what was flown and where."""
    words = [f"{scenario.duration_s:g} s", f"mount {scenario.mount.value}", f"gyro {args.gyro_hz} Hz"]
    if args.battery is not None:
        words.append(f"battery charged to {100 * args.battery:g} %")
    if any(args.wind):
        words.append(f"wind {', '.join(f'{speed:g}' for speed in args.wind)} m/s")
    if args.gust:
        words.append(f"gusts of a wind of {args.gust:g} m/s")
    if args.ground:
        words.append("over ground")
    if args.on == "betaflight":
        return [*words, "Betaflight 4.6 with its default PID, airmode and idle"]
    flown = "its PID" if args.controller == "pid" else "its policy"
    return [*words, f"firmware on {args.on}, {flown}"]


def _check_air(args: argparse.Namespace) -> None:
    """Refuse a battery, wind or gust that nobody can fly with."""
    if args.battery is not None and not 0.0 <= args.battery <= 1.0:
        raise NeuroflightError(f"--battery: got {args.battery:g}, expected a charge of 0 to 1")
    if not all(abs(speed) <= WIND_MAX for speed in args.wind):
        wind = " ".join(f"{speed:g}" for speed in args.wind)
        raise NeuroflightError(f"--wind: got {wind}, expected at most {WIND_MAX:g} m/s each way")
    if not 0.0 <= args.gust <= WIND_MAX:
        raise NeuroflightError(f"--gust: got {args.gust:g}, expected 0 to {WIND_MAX:g} m/s")


def _document(
    args: argparse.Namespace, aircraft: Aircraft, scenario: Scenario, flights: list[Flight]
) -> dict[str, Any]:
    from toolchain.cli.output import plain

    return {
        "on": args.on,
        "controller": args.controller,
        "scenario": scenario.name,
        "seed": args.seed,
        "episodes": scenario.episodes(),
        "duration_s": scenario.duration_s,
        "mount": scenario.mount.value,
        "gyro_rate_hz": args.gyro_hz,
        "battery": args.battery,
        "wind_m_s": list(args.wind),
        "gust_m_s": args.gust,
        "ground": args.ground,
        "aircraft": aircraft.name,
        "aircraft_sha256": aircraft.sha256,
        "flights": {
            # The first flight is the firmware's, whichever it is: "on" says.
            name: plain({**asdict(flight.figures), "armed": flight.armed})
            for name, flight in zip(("firmware", "PID"), flights, strict=False)
        },
    }


def _print(title: str, note: str, flights: list[Flight]) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from sim.report import table

    heading, *rows = table(flights)
    shown = Table(
        title=Text(title), caption=Text(note), title_justify="left", caption_justify="left", box=None
    )
    for number, cell in enumerate(heading):
        shown.add_column(cell, justify="right" if number else "left")
    for row in rows:
        shown.add_row(*row)
    Console().print(shown)
