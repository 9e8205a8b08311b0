"""Load cells: known masses give counts a unit; a small TOML file keeps the figures and their residuals.

A cell is taken to be linear: reading = offset + load / scale. It is loaded step by step and unloaded after
each load, so that what it does not give back (hysteresis) shows; Koch 2019, chapter 5, does the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from neuroflight.sim.arrays import Array
from neuroflight.toolchain.contract import GRAVITY
from neuroflight.toolchain.errors import DynoError
from neuroflight.toolchain.files import read_limited, write_text
from neuroflight.toolchain.strict_toml import StrictTable, parse_toml, shown

FORCE, TORQUE = "N", "N m"
LOADS_MIN = 3  # different ones, none among them: two points lie on a line whatever the cell does
RESIDUAL_MAX = 0.02  # of the largest load: more is a wrong mass, a cell that touches, or a loose screw
FILE_BYTES_MAX = 64 << 10
HEADING = "# Load cells, written by `neuroflight dyno calibrate`: load = scale (reading - offset)"


@dataclass(frozen=True)
class LoadCell:
    """The conversion of a cell's readings to a load, and the quality of its fit."""

    unit: str  # FORCE or TORQUE
    scale: float  # unit a count; its sign is the cell's
    offset: float  # counts without a load
    scale_error: float  # standard error of `scale`
    residual_rms: float  # [unit], of the loads against the line
    residual_max: float  # [unit]
    hysteresis: float  # [unit], by which the readings without a load differ at most
    load_max: float  # [unit], largest load that it was calibrated with, without sign
    loads: int  # how many


def loads_of_masses(masses_kg: ArrayLike, lever_m: float | None = None) -> Array:
    """Compute the force [N] of masses on a cell; with the length of a lever the torque [N m].

    A negative mass stands for one that pulls the other way, such as on a lever to the other side.
    """
    force: Array = np.asarray(masses_kg, np.float64) * GRAVITY
    return force if lever_m is None else force * lever_m


def fit_load_cell(loads: Array, readings: Array, unit: str) -> LoadCell:
    """Fit a line to readings, (P,) counts, under known loads, (P,) [unit], those of 0 included.

    Raises DynoError where the points do not show a line.
    """
    different = np.unique(loads)
    if len(different) < LOADS_MIN or 0.0 not in different:
        raise DynoError(
            f"{len(different)} different loads{'' if 0.0 in different else ', none of them 0'}, expected at "
            f"least {LOADS_MIN}, of which one is 0; calibrate with more masses"
        )
    if not (np.isfinite(loads).all() and np.isfinite(readings).all()):
        raise DynoError("a load or a reading is not a finite number; read the cell again")
    columns = np.stack([loads, np.ones_like(loads)], axis=1)
    (slope, offset), *_ = np.linalg.lstsq(columns, readings, rcond=None)
    off = readings - columns @ (slope, offset)
    largest = float(np.abs(loads).max())
    if abs(slope) * largest <= 2 * float(np.abs(off).max()):
        raise DynoError(
            f"readings change by {abs(slope) * largest:.4g} counts under the largest load and scatter by "
            f"{float(np.abs(off).max()):.4g}; is this the cell that was loaded, and is it connected?"
        )
    in_unit = off / slope
    worst = int(np.argmax(np.abs(in_unit)))
    if abs(in_unit[worst]) > RESIDUAL_MAX * largest:
        raise DynoError(
            f"the reading {readings[worst]:.6g} under {loads[worst]:.4g} {unit} is "
            f"{abs(in_unit[worst]):.3g} {unit} off the line, expected at most {RESIDUAL_MAX:.0%} of "
            f"{largest:.4g}; weigh that mass, see that nothing touches the cell, and calibrate again"
        )
    freedom = len(loads) - 2
    variance = float(off @ off) / freedom if freedom else 0.0
    spread = float(((loads - loads.mean()) ** 2).sum())
    unloaded = readings[loads == 0.0]
    return LoadCell(
        unit=unit,
        scale=float(1 / slope),
        offset=float(offset),
        scale_error=float(np.sqrt(variance / spread) / slope**2),
        residual_rms=float(np.sqrt(np.mean(in_unit**2))),
        residual_max=float(np.abs(in_unit).max()),
        hysteresis=float(np.ptp(unloaded) / abs(slope)),
        load_max=largest,
        loads=len(loads),
    )


def load(cell: LoadCell, reading: ArrayLike, offset: float | None = None) -> Array:
    """Compute the load [the cell's unit] of readings, any shape. offset: of today without a load [counts]."""
    zero = cell.offset if offset is None else offset
    return np.asarray((np.asarray(reading, np.float64) - zero) * cell.scale)


def write_load_cells(path: Path, cells: Mapping[str, LoadCell]) -> None:
    """Write the cells, by the name of their column, in one step."""
    lines = [HEADING]
    for name, cell in cells.items():
        lines += [
            "",
            f"[{name}]",
            f'unit = "{cell.unit}"',
            f"scale = {cell.scale!r}  # {cell.unit} a count",
            f"offset = {cell.offset!r}  # counts without a load",
            f"scale_error = {cell.scale_error!r}  # standard error of scale",
            f"residual_rms = {cell.residual_rms!r}  # {cell.unit}",
            f"residual_max = {cell.residual_max!r}  # {cell.unit}",
            f"hysteresis = {cell.hysteresis!r}  # {cell.unit}, largest difference of readings without a load",
            f"load_max = {cell.load_max!r}  # {cell.unit}, largest load of the calibration",
            f"loads = {cell.loads}",
        ]
    write_text(path, "\n".join(lines) + "\n")


def read_load_cells(path: Path, columns: Sequence[str]) -> dict[str, LoadCell]:
    """Read the cells of a file, by column. columns: those that may have one.

    Raises DynoError for a file that is missing, damaged or of another kind.
    """
    if not path.is_file():
        raise DynoError(f"{path}: no such file; `neuroflight dyno calibrate --out {path}` makes one")
    data = read_limited(path, str(path), FILE_BYTES_MAX, DynoError, " of load cells")
    document = parse_toml(data, str(path), DynoError)
    top = StrictTable(document, str(path), DynoError)
    strange = [name for name in document if name not in columns]
    if strange:
        raise DynoError(f"{path}: a cell {shown(strange[0])}, expected one of: {', '.join(columns)}")
    return {name: top.part(name, _cell) for name in document}


def _cell(table: StrictTable) -> LoadCell:
    cell = LoadCell(
        unit=table.choice("unit", {FORCE: FORCE, TORQUE: TORQUE}),
        scale=table.number("scale", -1e6, 1e6),
        offset=table.number("offset", -1e12, 1e12),
        scale_error=table.number("scale_error", 0.0, 1e6),
        residual_rms=table.number("residual_rms", 0.0, 1e6),
        residual_max=table.number("residual_max", 0.0, 1e6),
        hysteresis=table.number("hysteresis", 0.0, 1e6),
        load_max=table.number("load_max", 1e-9, 1e6),
        loads=table.integer("loads", LOADS_MIN, 1_000_000),
    )
    if cell.scale == 0.0:
        raise table.error("scale", "got 0, expected another number; calibrate the cell again")
    return cell
