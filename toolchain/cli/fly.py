"""`neuroflight fly`: the firmware and a PID fly the same scenario in the same twin, side by side."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from toolchain.contract import GYRO_RATE_DEFAULT_HZ, GYRO_RATES_HZ
from toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from sim.aircraft import Aircraft
    from sim.port import FirmwarePort
    from sim.report import Flight
    from sim.scenario import Scenario

BUILD = Path(__file__).resolve().parents[2] / "build" / "HOST"
MOUNTS = ("centre", "rig", "free")
FIRMWARES = ("reference", "host")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what flies, where, and what is kept."""
    parser.add_argument(
        "--on",
        choices=FIRMWARES,
        default="host",
        help="what runs the firmware: host, the program over UDP; reference, its C core as a library",
    )
    parser.add_argument(
        "--build", type=Path, default=BUILD, metavar="DIR", help="the host build to fly; default: build/HOST"
    )
    parser.add_argument(
        "--scenario", default="pulse", metavar="NAME|FILE", help="pulse, pulses, roll, flip or a .toml file"
    )
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="of commands, noise and bias")
    parser.add_argument("--count", type=int, default=100, metavar="N", help="commands of `pulses`")
    parser.add_argument("--aircraft", default="nf1", metavar="NAME|FILE", help="whose twin is flown")
    parser.add_argument("--gyro-hz", type=int, choices=GYRO_RATES_HZ, default=GYRO_RATE_DEFAULT_HZ)
    parser.add_argument("--mount", choices=MOUNTS, help="what holds the aircraft; default: the scenario's")
    parser.add_argument("--trace", type=Path, metavar="FILE.npz", help="keep the firmware's flight")
    parser.add_argument("--plot", type=Path, metavar="FILE.png", help="draw it")
    parser.add_argument("--report", type=Path, metavar="FILE.html", help="plot and figures on one page")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")


def run(args: argparse.Namespace) -> int:
    """Fly, write what was asked for, print the figures. Returns 0."""
    for path, suffix in ((args.trace, ".npz"), (args.plot, ".png"), (args.report, ".html")):
        _check_output(path, suffix)

    from sim.aircraft import load_aircraft
    from sim.report import save_plot, save_report
    from sim.scenario import load_scenario
    from sim.trace import save_trace
    from sim.world import Mount

    aircraft = load_aircraft(args.aircraft)
    mount = None if args.mount is None else Mount(args.mount)
    scenario = load_scenario(args.scenario, args.seed, args.count, mount)
    flights = _fly_all(args, aircraft, scenario)
    title = f"{aircraft.name}: {scenario.name}, seed {args.seed}"
    note = (
        f"{scenario.duration_s:g} s, mount {scenario.mount.value}, gyro {args.gyro_hz} Hz, "
        f"firmware on {args.on}"
    )
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


def _fly_all(args: argparse.Namespace, aircraft: Aircraft, scenario: Scenario) -> list[Flight]:
    """The firmware's flight, then the PID's if the aircraft has gains for one."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    from sim.controller_port import ControllerPort
    from sim.pid import aircraft_pid

    def pid_port(control_rate_hz: int) -> FirmwarePort:
        pid = aircraft_pid(aircraft, 1, control_rate_hz)
        return ControllerPort(pid, aircraft.motor_count, args.gyro_hz, control_rate_hz)

    columns = (TextColumn("{task.description:<10}"), BarColumn(), TimeElapsedColumn())
    quiet = args.json or not sys.stderr.isatty()
    with Progress(*columns, console=Console(stderr=True), transient=True, disable=quiet) as progress:

        def fly_one(name: str, port: FirmwarePort) -> Flight:
            task = progress.add_task(name, total=1.0)
            flight = _fly(
                args, aircraft, scenario, name, port, lambda part: progress.update(task, completed=part)
            )
            progress.update(task, completed=1.0)
            return flight

        firmware = _open(args.on, args.build, args.gyro_hz)
        flights = [fly_one("firmware", firmware)]
        if aircraft.pids:
            flights.append(fly_one("PID", pid_port(firmware.control_rate_hz)))
    return flights


def _open(kind: str, build: Path, gyro_rate_hz: int) -> FirmwarePort:
    from sim.host_port import HostPort
    from sim.reference_port import ReferencePort

    if kind == "host":
        return HostPort(build / "neuroflight", gyro_rate_hz)
    return ReferencePort(build / "libneuroflight.so", gyro_rate_hz)


def _fly(
    args: argparse.Namespace,
    aircraft: Aircraft,
    scenario: Scenario,
    name: str,
    port: FirmwarePort,
    progress: Callable[[float], None],
) -> Flight:
    """One flight in a fresh twin of the seed; closes the port."""
    import numpy as np

    from sim.loop import fly
    from sim.metrics import figures
    from sim.report import Flight
    from sim.twin import Twin

    rng = np.random.default_rng((args.seed, 1))  # another stream than the scenario's commands
    with closing(port), closing(Twin(aircraft, rate_hz=args.gyro_hz, mount=scenario.mount, rng=rng)) as twin:
        trace = fly(twin, port, scenario, progress=progress)
    return Flight(name, trace, figures(trace, scenario.episodes()))


def _check_output(path: Path | None, suffix: str) -> None:
    """Refuse a file that could not be written after the flight."""
    if path is None:
        return
    if path.suffix != suffix:
        raise NeuroflightError(f"{path}: expected a name that ends in {suffix}")
    if path.is_dir():
        raise NeuroflightError(f"{path}: is a directory, expected a file to write")
    parent = next(folder for folder in path.absolute().parents if folder.exists())
    if not parent.is_dir():
        raise NeuroflightError(f"{path}: {parent} is no directory; choose another place")
    if not os.access(parent, os.W_OK):
        raise NeuroflightError(f"{path}: may not be written in {parent}; choose another place")


def _document(
    args: argparse.Namespace, aircraft: Aircraft, scenario: Scenario, flights: list[Flight]
) -> dict[str, Any]:
    import numpy as np

    def plain(value: Any) -> Any:  # noqa: ANN401 - dataclasses of arrays and floats
        if isinstance(value, dict):
            return {key: plain(item) for key, item in value.items()}
        return value.tolist() if isinstance(value, np.ndarray) else value

    return {
        "on": args.on,
        "scenario": scenario.name,
        "seed": args.seed,
        "episodes": scenario.episodes(),
        "duration_s": scenario.duration_s,
        "mount": scenario.mount.value,
        "gyro_rate_hz": args.gyro_hz,
        "aircraft": aircraft.name,
        "aircraft_sha256": aircraft.sha256,
        "flights": {
            flight.name: {**plain(asdict(flight.figures)), "armed": flight.armed} for flight in flights
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
