"""`neuroflight log metrics`: the figures of a flight, of a log or of a trace, by the same functions."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from typing import TYPE_CHECKING

from neuroflight.cli.log.reading import add_file_arguments, add_part_arguments, open_log, part, tell_damage
from neuroflight.cli.report import print_table
from neuroflight.toolchain.contract import Mix
from neuroflight.toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from neuroflight.sim.analysis.flight_report import Flight

NOTE = "errors are setpoint minus gyro: no log has the true rate"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_file_arguments(parser)
    add_part_arguments(parser, "the first armed row")
    parser.add_argument("--episodes", type=int, default=1, metavar="N", help="average over N equal parts (1)")
    parser.add_argument(
        "--idle", type=float, metavar="PART", help="motor fraction at zero thrust; default: as the log says"
    )
    parser.add_argument(
        "--mix",
        choices=[mix.text for mix in Mix],
        help="of outputs and throttle; default: as the log says, attitude-first of a trace",
    )


def run(args: argparse.Namespace) -> int:
    """Decode, compute, print. FILE may be a trace of `fly --trace`, which is then seen as a log sees it."""
    from neuroflight.cli.output import plain

    if args.idle is not None and not 0.0 <= args.idle < 1.0:
        raise NeuroflightError(f"--idle: got {args.idle:g}, expected a part of full power, 0 to below 1")
    if args.episodes < 1:
        raise NeuroflightError(f"--episodes: got {args.episodes}, expected at least 1")
    flight = _trace(args) if args.file.suffix == ".npz" else _log(args)
    if args.json:
        told = {
            "file": str(args.file),
            "rows": len(flight.trace.t),
            "episodes": args.episodes,
            "armed": flight.armed,
            **asdict(flight.figures),
        }
        print(json.dumps(plain(told), indent=2, default=plain))
        return 0
    from neuroflight.sim.analysis.flight_report import table

    length = f"{len(flight.trace.t)} rows at {flight.trace.control_rate_hz} Hz"
    print_table(f"{args.file.name}: {flight.name}, {length}", table([flight]), NOTE)
    return 0


def _log(args: argparse.Namespace) -> Flight:
    from neuroflight.sim.blackbox.flight import log_flight

    chosen = part(args)
    log = open_log(args)
    flight = log_flight(log, chosen, args.episodes, args.idle, _mix(args))
    tell_damage(log)
    return flight


def _trace(args: argparse.Namespace) -> Flight:
    from neuroflight.sim.blackbox.flight import cut, trace_flight
    from neuroflight.sim.flight.trace import load_trace

    chosen = part(args)
    return trace_flight(
        "trace",
        cut(load_trace(args.file), chosen),
        args.episodes,
        args.idle,
        _mix(args) or Mix.ATTITUDE_FIRST,
    )


def _mix(args: argparse.Namespace) -> Mix | None:
    return None if args.mix is None else Mix.of(args.mix)
