"""Tables of propellers as their measurers and makers publish them.

A table has a heading and a row for each measurement, its columns parted by commas, semicolons, tabs, blanks:

    J          advance ratio V / (n D)
    RPM        in place of J: measured at rest
    CT         C_T = T / (rho n^2 D^4)
    CQ or CP   C_Q = Q / (rho n^2 D^5), or C_P = 2 pi C_Q

Names may have an underscore and any case; other columns are skipped, and so are lines that begin with #.
Files of the UIUC Propeller Data Site are read as they are, those measured at rest (`_static_`) too, and so
are APC's performance files (PER3_*.dat), which have a table of J for each of many speeds.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from neuroflight.sim.aircraft.advance import RATIO_LAST
from neuroflight.sim.arrays import Array
from neuroflight.sim.identification.table import find_table, numbers, read_text
from neuroflight.toolchain.errors import DynoError

FILE_BYTES_MAX = 1 << 20
ROWS_MAX = 10_000
COLUMNS = {"j": "J", "rpm": "RPM", "ct": "CT", "cq": "CQ", "cp": "CP"}
COLUMNS |= dict.fromkeys(("advance ratio", "advanceratio", "advratio", "v/nd", "v/(nd)"), "J")
LOW, HIGH = -2.0, 2.0  # of coefficients; those of propellers are below 0.3
RPM_LAST = 500_000.0
RANGES = {"J": (-RATIO_LAST, RATIO_LAST), "RPM": (0.0, RPM_LAST)}
GEOMETRY = frozenset(("r/r", "c/r"))  # headings of a blade's shape
_BLOCK = re.compile(r"\s*PROP\s+RPM\s*=\s*([0-9.]+)\s*", re.IGNORECASE)  # APC's


@dataclass(frozen=True, eq=False)
class Measurements:
    """N measurements of a propeller in wind."""

    ratio: Array  # (N,) J
    thrust: Array  # (N,) C_T
    torque: Array  # (N,) C_Q


@dataclass(frozen=True, eq=False)
class Static:
    """N measurements of a propeller at rest."""

    rpm: Array  # (N,)
    thrust: Array  # (N,) C_T
    torque: Array  # (N,) C_Q


@dataclass(frozen=True, eq=False)
class Tables:
    """The measurements in the files of one propeller."""

    wind: Measurements
    rest: Static
    speeds_rpm: tuple[float, ...]  # of the tables over J that name their speed, ascending
    notes: tuple[str, ...]

    @property
    def measurements(self) -> Measurements:
        """All measurements; those at rest have J = 0."""
        ratio = np.concatenate([self.wind.ratio, np.zeros(len(self.rest.rpm))])
        thrust, torque = (
            np.concatenate([getattr(self.wind, name), getattr(self.rest, name)])
            for name in ("thrust", "torque")
        )
        return Measurements(ratio, thrust, torque)


@dataclass(frozen=True, eq=False)
class _Rows:
    """Rows of one table, (n, 3): J, C_T, C_Q; at rest the speed [rpm] stands in place of J."""

    values: Array
    at_rest: bool
    rpm: float | None  # of a table over J that names its speed


def read_tables(paths: Sequence[Path], rpm: float | None = None) -> Tables:
    """Read all files together. Raises DynoError naming file and line.

    rpm: of tables that tell their speed, and of measurements at rest, only the one that is nearest is taken;
    None: all are.
    """
    found = [rows for path in paths for rows in _read(path)]
    if sum(len(rows.values) for rows in found) > ROWS_MAX:
        raise DynoError(f"{paths[-1]}: more than {ROWS_MAX} rows in all; leave some out")
    notes = []
    speeds = sorted({rows.rpm for rows in found if rows.rpm is not None})
    wind = [rows for rows in found if not rows.at_rest]
    rest = np.concatenate([np.zeros((0, 3)), *(rows.values for rows in found if rows.at_rest)])
    if rpm is not None and not speeds and not len(rest):
        raise DynoError(f"{paths[0]}: the table does not tell its speed; leave --rpm out")
    if rpm is not None and speeds:
        nearest = min(speeds, key=lambda speed: abs(speed - rpm))
        wind = [rows for rows in wind if rows.rpm in (None, nearest)]
        notes.append(
            f"of {len(speeds)} speeds from {speeds[0]:g} to {speeds[-1]:g} rpm, {nearest:g} rpm is taken"
        )
        speeds = [nearest]
    elif len(speeds) > 1:
        notes.append(
            f"{len(speeds)} speeds from {speeds[0]:g} to {speeds[-1]:g} rpm are taken together; --rpm N: one"
        )
    if rpm is not None and len(rest):
        rest = rest[[int(np.abs(rest[:, 0] - rpm).argmin())]]
        notes.append(f"of the measurements at rest, {rest[0, 0]:g} rpm is taken")
    if wind and len(rest):
        notes.append(f"{len(rest)} measurements at rest are taken as those of J = 0")
    ratio, thrust, torque = np.concatenate([np.zeros((0, 3)), *(rows.values for rows in wind)]).T
    return Tables(Measurements(ratio, thrust, torque), Static(*rest.T), tuple(speeds), tuple(notes))


def _read(path: Path) -> list[_Rows]:
    """Read the tables of a file; only a file of APC's has several."""
    if not path.is_file():
        raise DynoError(f"{path}: no such file; expected a table of J, CT and CQ or CP")
    text = read_text(path, FILE_BYTES_MAX, DynoError)
    lines = text.splitlines()
    blocks = [number for number, line in enumerate(lines) if _BLOCK.fullmatch(line)]
    if blocks:
        ends = [*blocks[1:], len(lines)]
        return [_apc(lines, begin, end, path) for begin, end in zip(blocks, ends, strict=True)]

    def score(cells: Sequence[str]) -> int:
        return len({_name(cell) for cell in cells} - {None})

    table = find_table(text, score, 2, bool, ROWS_MAX, str(path), DynoError)
    if table is None:
        if any({cell.lower() for cell in line.split()} >= GEOMETRY for line in lines[:5]):
            raise DynoError(f"{path}: a blade's shape (r/R, c/R, beta); take the file with its CT and CP")
        raise DynoError(
            f"{path}: no measurements; expected a heading with J or RPM, CT and CQ or CP, then rows"
        )
    columns = _columns(table.names, path)
    if not table.rows:
        raise DynoError(f"{path}: no measurements; expected rows below the heading")
    values = numbers(table, list(columns.values()), str(path), DynoError)
    for place, (name, column) in enumerate(columns.items()):
        low, high = RANGES.get(name, (LOW, HIGH))
        wrong = np.flatnonzero(~((values[:, place] >= low) & (values[:, place] <= high)))
        if len(wrong):
            row = int(wrong[0])
            raise DynoError(
                f"{path}: line {table.lines[row]}: {name} is {table.rows[row][column][:40]!r}, expected a "
                f"number from {low:g} to {high:g}"
            )
    if "CP" in columns:
        values[:, 2] /= 2.0 * math.pi
    return [_Rows(values, "RPM" in columns, None)]


def _name(cell: str) -> str | None:
    """Return the column's quantity: J, RPM, CT, CQ or CP; None for another column."""
    return COLUMNS.get(cell.lower().replace("_", ""))


def _columns(names: Sequence[str], path: Path) -> dict[str, int]:
    """Return the positions of J (or RPM at rest), CT, and CQ (or CP), in this order."""
    known = [name for name in map(_name, names) if name is not None]
    twice = sorted({name for name in known if known.count(name) > 1})
    if twice:
        raise DynoError(f"{path}: two columns {twice[0]}; leave one out")
    first = "J" if "J" in known else "RPM"
    last = "CQ" if "CQ" in known else "CP"
    lacks = [
        text for name, text in ((first, "J or RPM"), ("CT", "CT"), (last, "CQ or CP")) if name not in known
    ]
    if lacks:
        shown = ", ".join(cell[:20] for cell in names[:8])
        raise DynoError(
            f"{path}: no column {lacks[0]} in the heading {shown!r}; expected J or RPM, CT and CQ or CP"
        )
    places = [_name(name) for name in names]
    return {name: places.index(name) for name in (first, "CT", last)}


def _apc(lines: Sequence[str], begin: int, end: int, path: Path) -> _Rows:
    """Read the table of one speed in a file of APC's; rows without a number in CT or CP are left out."""
    found = _BLOCK.fullmatch(lines[begin])
    rpm = float(found[1].rstrip(".")) if found else math.nan
    places: dict[str, int] = {}
    rows: list[list[float]] = []
    for number, line in enumerate(lines[begin + 1 : end], begin + 2):
        cells = line.split()
        if not places:
            names = [_name(cell) for cell in cells]
            if {"J", "CT", "CP"} <= set(names):
                places = {name: names.index(name) for name in ("J", "CT", "CP")}
            continue
        try:
            row = [float(cells[at]) for at in places.values()]
        except (ValueError, IndexError):
            if cells and cells[0].replace(".", "").isdigit():  # a row, with *** in place of a number
                continue
            if rows and cells:
                raise DynoError(
                    f"{path}: line {number}: {line.strip()[:60]!r}, expected a row of numbers"
                ) from None
            continue  # the units below the heading
        if all(math.isfinite(value) for value in row):
            rows.append(row)
    if not rows or not 0.0 < rpm <= RPM_LAST:
        raise DynoError(
            f"{path}: line {begin + 1}: no rows with J, Ct and Cp below {lines[begin].strip()[:40]!r}"
        )
    values = np.array(rows)
    if (np.abs(values[:, 0]) > RATIO_LAST).any() or (np.abs(values[:, 1:]) > HIGH).any():
        raise DynoError(f"{path}: line {begin + 1}: J, Ct or Cp of {rpm:g} rpm beyond any propeller's")
    values[:, 2] /= 2.0 * math.pi
    return _Rows(values, False, rpm)
