"""`neuroflight dyno calibrate`: fit a load cell's counts per unit to known masses."""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING

from neuroflight.cli.dyno.bench import add_sensor, open_sensor
from neuroflight.cli.output import check_output
from neuroflight.toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from neuroflight.sim.identification.bench.load_cell import LoadCell

MASSES_MAX = 40
MASS_G_MAX = 100_000.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the sensor, the cell, the masses and the file."""
    add_sensor(parser)
    parser.add_argument("--cell", required=True, metavar="COLUMN", help="of the sensor, such as thrust_raw")
    parser.add_argument(
        "--masses-g",
        required=True,
        metavar="G,G",
        help="masses in the order in which they are put on; below 0: on the lever's other side",
    )
    parser.add_argument(
        "--lever-mm", type=float, metavar="MM", help="of a torque: from the axis to where the mass hangs"
    )
    parser.add_argument("--seconds", type=float, metavar="S", help="that a reading takes (default 2)")
    parser.add_argument(
        "--out", type=Path, required=True, metavar="FILE.toml", help="made, or given this cell beside others"
    )
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")


def run(args: argparse.Namespace) -> int:
    """Ask for each mass, fit the line, write it. Returns 0."""
    from neuroflight.sim.identification.bench.calibration import READ_S, calibrate, read_still
    from neuroflight.sim.identification.bench.load_cell import read_load_cells, write_load_cells
    from neuroflight.sim.identification.bench.sensor import CELLS

    check_output(args.out, ".toml")
    if args.cell not in CELLS:
        raise NeuroflightError(f"--cell {args.cell[:40]!r}, expected one of: {', '.join(CELLS)}")
    torque = args.cell.startswith("torque")
    if torque is not (args.lever_mm is not None):
        mend = "give the length of the lever" if torque else "leave it out: thrust needs none"
        raise NeuroflightError(f"--cell {args.cell} with{'out' if torque else ''} --lever-mm; {mend}")
    if args.lever_mm is not None and not 1 <= args.lever_mm <= 10_000:
        raise NeuroflightError(f"--lever-mm {args.lever_mm:g}, expected 1 to 10000")
    seconds = READ_S if args.seconds is None else args.seconds
    if not 0.2 <= seconds <= 60:
        raise NeuroflightError(f"--seconds {seconds:g}, expected 0.2 to 60")
    masses = _masses(args.masses_g)
    cells = read_load_cells(args.out, CELLS) if args.out.exists() else {}
    with open_sensor(args) as sensor:

        def read(mass_kg: float) -> float:
            _ask(mass_kg)
            return read_still(sensor, args.cell, monotonic, seconds)

        lever = None if args.lever_mm is None else args.lever_mm / 1000
        cell, points = calibrate(masses, lever, read)
    write_load_cells(args.out, {**cells, args.cell: cell})
    if args.json:
        from dataclasses import asdict

        document = {"out": str(args.out), "cell": args.cell, **asdict(cell), "points": points}
        print(json.dumps(document, indent=2))
    else:
        _print(args, cell, points)
    return 0


def _masses(text: str) -> list[float]:
    """Return the masses [kg] that the user wrote in grams."""
    try:
        grams = [float(word) for word in text.split(",")]
    except ValueError:
        grams = [math.nan]
    if not 2 <= len(grams) <= MASSES_MAX or not all(0 < abs(mass) <= MASS_G_MAX for mass in grams):
        raise NeuroflightError(
            f"--masses-g {text[:80]!r}, expected 2 to {MASSES_MAX} masses in grams with commas between, such "
            f"as 200,400,600; 0 is read between them anyway"
        )
    return [mass / 1000 for mass in grams]


def _ask(mass_kg: float) -> None:
    if mass_kg == 0:
        what = "Take every mass off"
    else:
        side = ", on the lever's other side" if mass_kg < 0 else ""
        what = f"Put {abs(1000 * mass_kg):g} g on{side}"
    print(f"{what}, let it come to rest, then press Enter: ", end="", file=sys.stderr, flush=True)
    if not sys.stdin.readline():
        raise NeuroflightError("the input ended, expected Enter for each mass; nothing was written")


def _print(args: argparse.Namespace, cell: LoadCell, points: list[tuple[float, float]]) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(title=Text(f"{args.cell} in {args.out}"), title_justify="left", box=None)
    for heading in (f"load, {cell.unit}", "counts", f"off the line, {cell.unit}"):
        table.add_column(heading, justify="right")
    for load, reading in points:
        off = (reading - cell.offset) * cell.scale - load
        table.add_row(f"{load:.4f}", f"{reading:,.0f}", f"{off:+.5f}")
    Console().print(table)
    error = abs(100 * cell.scale_error / cell.scale)
    print(
        f"{cell.scale:.6g} {cell.unit} a count (standard error {error:.2g} %), {cell.offset:,.0f} counts "
        f"without a load, residual {cell.residual_rms:.2g} {cell.unit} rms, hysteresis {cell.hysteresis:.2g} "
        f"{cell.unit}"
    )
