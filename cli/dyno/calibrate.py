"""`neuroflight dyno calibrate`: fit a load cell's counts per unit to known masses."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Annotated

from neuroflight.cli.dyno.bench import OfSensor
from neuroflight.cli.options import Json
from neuroflight.cli.report import print_json, print_table
from neuroflight.cli.requests import Option
from neuroflight.toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from neuroflight.sim.identification.bench.load_cell import LoadCell

MASSES_MAX = 40
MASS_G_MAX = 100_000.0


@dataclass(frozen=True, kw_only=True)
class Calibrate(OfSensor):
    """A request to calibrate a load cell."""

    cell: Annotated[str, Option("COLUMN", "of the sensor, such as thrust_raw")]
    masses_g: Annotated[
        str, Option("G,G", "masses in the order in which they are put on; below 0: on the lever's other side")
    ]
    lever_mm: Annotated[
        float | None,
        Option("MM", "of a torque: from the axis to where the mass hangs", low=1.0, high=10_000.0, unit="mm"),
    ] = None
    seconds: Annotated[
        float | None, Option("S", "that a reading takes (default 2)", low=0.2, high=60.0, unit="s")
    ] = None
    out: Annotated[Path, Option("FILE.toml", "made, or given this cell beside others", suffix=".toml")]
    json: Json = False

    def run(self) -> int:
        """Ask for each mass, fit the line, write it. Returns 0."""
        from neuroflight.sim.identification.bench.calibration import READ_S, calibrate, read_still
        from neuroflight.sim.identification.bench.load_cell import read_load_cells, write_load_cells
        from neuroflight.sim.identification.bench.sensor import CELLS

        if self.cell not in CELLS:
            raise NeuroflightError(f"--cell {self.cell[:40]!r}, expected one of: {', '.join(CELLS)}")
        torque = self.cell.startswith("torque")
        if torque is not (self.lever_mm is not None):
            mend = "give the length of the lever" if torque else "leave it out: thrust needs none"
            raise NeuroflightError(f"--cell {self.cell} with{'out' if torque else ''} --lever-mm; {mend}")
        seconds = READ_S if self.seconds is None else self.seconds
        masses = _masses(self.masses_g)
        cells = read_load_cells(self.out, CELLS) if self.out.exists() else {}
        with self.opened() as sensor:

            def read(mass_kg: float) -> float:
                _ask(mass_kg)
                return read_still(sensor, self.cell, monotonic, seconds)

            lever = None if self.lever_mm is None else self.lever_mm / 1000
            cell, points = calibrate(masses, lever, read)
        write_load_cells(self.out, {**cells, self.cell: cell})
        if self.json:
            from dataclasses import asdict

            document = {"out": str(self.out), "cell": self.cell, **asdict(cell), "points": points}
            print_json(document)
        else:
            _print(self, cell, points)
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


def _print(args: Calibrate, cell: LoadCell, points: list[tuple[float, float]]) -> None:
    heads = (f"load, {cell.unit}", "counts", f"off the line, {cell.unit}")
    rows = [
        (f"{load:.4f}", f"{reading:,.0f}", f"{(reading - cell.offset) * cell.scale - load:+.5f}")
        for load, reading in points
    ]
    print_table(f"{args.cell} in {args.out}", [heads, *rows], numbers=heads)
    error = abs(100 * cell.scale_error / cell.scale)
    print(
        f"{cell.scale:.6g} {cell.unit} a count (standard error {error:.2g} %), {cell.offset:,.0f} counts "
        f"without a load, residual {cell.residual_rms:.2g} {cell.unit} rms, hysteresis {cell.hysteresis:.2g} "
        f"{cell.unit}"
    )
