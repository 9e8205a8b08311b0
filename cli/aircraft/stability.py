"""`neuroflight aircraft stability`: drift of an aircraft's links in reduced and in maximal coordinates."""

from __future__ import annotations

import argparse
import json
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from neuroflight.toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from neuroflight.sim.aircraft.model import Aircraft
    from neuroflight.sim.identification.link_drift import Drift, Onset

STEP_MS_MIN, STEP_MS_MAX = 0.05, 20.0
THRESHOLD_MM_MAX = 1000.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--aircraft", default="nf1", metavar="NAME|FILE", help="whose links are flown")
    parser.add_argument(
        "--steps-ms", type=float, nargs="+", metavar="MS", default=[2.0, 1.0, 0.5], help="steps of the world"
    )
    parser.add_argument("--plot", type=Path, metavar="FILE.png", help="draw drift against rate")
    parser.add_argument(
        "--map", type=Path, metavar="FILE.png", help="draw roll, pitch and yaw rate, coloured by separation"
    )
    parser.add_argument(
        "--threshold-mm",
        type=float,
        metavar="MM",
        default=1.0,
        help="separation from which links count as apart; default: %(default)g",
    )
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")


def run(args: argparse.Namespace) -> int:
    """Fly all combinations of motors at each step, print the largest drifts."""
    from rich.console import Console
    from rich.progress import Progress

    from neuroflight.cli.output import check_output
    from neuroflight.sim.aircraft.model import load_aircraft
    from neuroflight.sim.identification.link_drift import FORMULATIONS, drift
    from neuroflight.sim.identification.link_drift_plot import draw_drift, draw_map
    from neuroflight.sim.plotting import save_png

    check_output(args.plot, ".png")
    check_output(args.map, ".png")
    if not 0.0 < args.threshold_mm <= THRESHOLD_MM_MAX:
        raise NeuroflightError(
            f"--threshold-mm {args.threshold_mm:g}, expected above 0, at most {THRESHOLD_MM_MAX:g} mm"
        )
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
        save_png(args.plot, draw_drift(runs, f"{aircraft.name}: do its links stay together?"))
    if args.map:
        save_png(
            args.map, draw_map(runs, args.threshold_mm / 1e3, f"{aircraft.name}: separation of its links")
        )
    if args.json:
        print(json.dumps(_document(args, aircraft, runs), indent=2))
    else:
        _print(aircraft, runs, args.threshold_mm / 1e3)
    return 0


def _document(args: argparse.Namespace, aircraft: Aircraft, runs: list[Drift]) -> dict[str, Any]:
    import numpy as np

    from neuroflight.cli.output import command_line
    from neuroflight.sim.identification.link_drift import DURATION_S, ONSET_M, RATE_MAX, onset

    threshold = None if args.threshold_mm == 1e3 * ONSET_M else args.threshold_mm
    return {
        "command": command_line(
            "aircraft stability", aircraft=args.aircraft, steps_ms=args.steps_ms, threshold_mm=threshold
        ),
        "aircraft": aircraft.name,
        "aircraft_sha256": aircraft.sha256,
        "combinations": 2**aircraft.motor_count,
        "duration_s": DURATION_S,
        "rate_limit_deg_s": float(np.rad2deg(RATE_MAX)),
        "threshold_m": args.threshold_mm / 1e3,
        "runs": [
            {
                "formulation": run.formulation,
                "step_ms": round(1e3 * run.step_s, 6),
                "drift_m": run.worst,
                "separation_m": float(run.separation.max()),
                "rate_deg_s": float(np.rad2deg(run.rate.max())),
                "onset": _onset_document(onset(run, args.threshold_mm / 1e3)),
            }
            for run in runs
        ],
    }


def _onset_document(found: Onset | None) -> dict[str, Any] | None:
    import numpy as np

    if found is None:
        return None
    return {
        "rates_deg_s": np.rad2deg(found.rates).tolist(),
        "rate_deg_s": float(np.rad2deg(found.rate)),
        "separation_m": found.separation,
    }


def _print(aircraft: Aircraft, runs: list[Drift], threshold: float) -> None:
    import numpy as np
    from rich.console import Console
    from rich.table import Table

    from neuroflight.sim.identification.link_drift import onset

    table = Table(title=f"{aircraft.name}: do its links stay together?", title_justify="left", box=None)
    headings = (
        "coordinates",
        "step, ms",
        "largest drift, mm",
        "separation, mm",
        f"above {1e3 * threshold:g} mm from, deg/s",
        "fastest, deg/s",
    )
    for number, heading in enumerate(headings):
        table.add_column(heading, justify="right" if number else "left")
    for run in runs:
        found = onset(run, threshold)
        rates = "never" if found is None else " ".join(f"{rate:z.0f}" for rate in np.rad2deg(found.rates))
        table.add_row(
            run.formulation,
            f"{1e3 * run.step_s:g}",
            f"{1e3 * run.worst:.2g}",
            f"{1e3 * float(run.separation.max()):.2g}",
            rates,
            f"{np.rad2deg(run.rate.max()):.0f}",
        )
    console = Console()
    console.print(table)
    console.print(
        f"All {2**aircraft.motor_count} combinations of motors on and off, from rest, free, without gravity. "
        "Drift: of the propeller that moved most from the airframe; separation: every link from every other, "
        "summed (Koch 2019, algorithm 1), with the lowest rates about roll, pitch and yaw at which it passes "
        "the threshold. The twin itself is one rigid body: it has no links that could drift.",
        style="dim",
    )
