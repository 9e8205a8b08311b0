"""`neuroflight stability`: drift of an aircraft's links in reduced and in maximal coordinates."""

from __future__ import annotations

import argparse
import json
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from sim.aircraft.model import Aircraft
    from sim.identification.link_drift import Drift

STEP_MS_MIN, STEP_MS_MAX = 0.05, 20.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("--aircraft", default="nf1", metavar="NAME|FILE", help="whose links are flown")
    parser.add_argument(
        "--steps-ms", type=float, nargs="+", metavar="MS", default=[2.0, 1.0, 0.5], help="steps of the world"
    )
    parser.add_argument("--plot", type=Path, metavar="FILE.png", help="draw drift against rate")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")


def run(args: argparse.Namespace) -> int:
    """Fly all combinations of motors at each step, print the largest drifts."""
    from rich.console import Console
    from rich.progress import Progress

    from cli.output import check_output
    from sim.aircraft.model import load_aircraft
    from sim.identification.link_drift import FORMULATIONS, drift
    from sim.identification.link_drift_plot import draw
    from sim.plotting import save_png

    check_output(args.plot, ".png")
    for step in args.steps_ms:
        if not STEP_MS_MIN <= step <= STEP_MS_MAX:
            raise NeuroflightError(f"--steps-ms {step:g}, expected {STEP_MS_MIN:g} to {STEP_MS_MAX:g} ms")
    aircraft = load_aircraft(args.aircraft)
    flights = 2**aircraft.motor_count
    runs = []
    quiet = args.json or not sys.stderr.isatty()
    with Progress(console=Console(stderr=True), transient=True, disable=quiet) as bar:
        for formulation in FORMULATIONS:
            for step in args.steps_ms:
                task = bar.add_task(f"{formulation}, {step:g} ms", total=flights)
                runs.append(drift(aircraft, formulation, step / 1e3, partial(bar.advance, task)))
    if args.plot:
        save_png(args.plot, draw(runs, f"{aircraft.name}: do its links stay together?"))
    if args.json:
        print(json.dumps(_document(args, aircraft, runs), indent=2))
    else:
        _print(aircraft, runs)
    return 0


def _document(args: argparse.Namespace, aircraft: Aircraft, runs: list[Drift]) -> dict[str, Any]:
    import numpy as np

    from cli.output import command_line
    from sim.identification.link_drift import DURATION_S, RATE_MAX

    return {
        "command": command_line("stability", aircraft=args.aircraft, steps_ms=args.steps_ms),
        "aircraft": aircraft.name,
        "aircraft_sha256": aircraft.sha256,
        "combinations": 2**aircraft.motor_count,
        "duration_s": DURATION_S,
        "rate_limit_deg_s": float(np.rad2deg(RATE_MAX)),
        "runs": [
            {
                "formulation": run.formulation,
                "step_ms": round(1e3 * run.step_s, 6),
                "drift_m": run.worst,
                "rate_deg_s": float(np.rad2deg(run.rate.max())),
            }
            for run in runs
        ],
    }


def _print(aircraft: Aircraft, runs: list[Drift]) -> None:
    import numpy as np
    from rich.console import Console
    from rich.table import Table

    table = Table(title=f"{aircraft.name}: do its links stay together?", title_justify="left", box=None)
    for number, heading in enumerate(("coordinates", "step, ms", "largest drift, mm", "fastest, deg/s")):
        table.add_column(heading, justify="right" if number else "left")
    for run in runs:
        table.add_row(
            run.formulation,
            f"{1e3 * run.step_s:g}",
            f"{1e3 * run.worst:.2g}",
            f"{np.rad2deg(run.rate.max()):.0f}",
        )
    console = Console()
    console.print(table)
    console.print(
        f"All {2**aircraft.motor_count} combinations of motors on and off, from rest, free, without gravity. "
        "The twin itself is one rigid body: it has no links that could drift.",
        style="dim",
    )
