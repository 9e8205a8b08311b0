"""Coefficients of [propulsion.advance_ratio] from measurements of a propeller in a wind tunnel.

A table has a heading and a row for each measurement, its columns parted by commas, semicolons or blanks:

    J          advance ratio V / (n D)
    CT         C_T = T / (rho n^2 D^4)
    CQ or CP   C_Q = Q / (rho n^2 D^5), or C_P = 2 pi C_Q

Names may have an underscore and any case; other columns are skipped, and so are lines that begin with #.
Files of the UIUC Propeller Data Site are read as they are.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sim.aircraft.advance import RATIO_LAST, AdvanceRatio, Terms, read_advance
from sim.strict_toml import StrictTable
from toolchain.errors import DynoError
from toolchain.files import file_size

Array = NDArray[np.float64]

FILE_BYTES_MAX = 1 << 20
ROWS_MAX = 10_000
COLUMNS = {"j": "J", "ct": "CT", "cq": "CQ", "cp": "CP"}
LOW, HIGH = -2.0, 2.0  # of coefficients; those of propellers are below 0.3
DIGITS = 4  # significant, of a coefficient
LEFT_MAX = 0.3  # part of the thrust at J = 0 at the largest J measured, above which the rest is a guess
END_MAX = 0.02  # part of it where the curve ends, above which the curve never reaches 0


@dataclass(frozen=True, eq=False)
class Measurements:
    """N measurements of a propeller."""

    ratio: Array  # (N,) J
    thrust: Array  # (N,) C_T
    torque: Array  # (N,) C_Q


@dataclass(frozen=True, eq=False)
class Curve:
    """A coefficient over J, fitted: static (1 + a1 J + a2 J^2)."""

    static: float  # at J = 0
    terms: Terms
    errors: Terms  # standard errors of the terms; NaN: not known, from as many rows as terms
    residual: float  # RMS of what the fit leaves, in parts of `static`


@dataclass(frozen=True, eq=False)
class PropellerFit:
    """Both coefficients, and what they were fitted to."""

    thrust: Curve
    torque: Curve
    advance: AdvanceRatio  # rounded, as a file has it
    used: Measurements
    left: float  # part of the thrust at J = 0 that is left in the fastest air used


def read_measurements(paths: Sequence[Path]) -> Measurements:
    """The measurements of all files together. Raises DynoError naming file and line."""
    rows: list[tuple[float, float, float]] = []
    for path in paths:
        rows += _read(path)
        if len(rows) > ROWS_MAX:
            raise DynoError(f"{path}: more than {ROWS_MAX} rows in all; leave some out")
    ratio, thrust, torque = np.array(rows, np.float64).reshape(-1, 3).T
    return Measurements(ratio, thrust, torque)


def fit_propeller(measured: Measurements, degree: int = 2) -> PropellerFit:
    """Least squares of both coefficients where the propeller pulls, J >= 0 and C_T > 0.

    degree: 1 leaves a2 at 0, for measurements that end long before the thrust does. Raises DynoError on
    measurements that do not show a curve, or one that no propeller has.
    """
    pulls = (measured.ratio >= 0.0) & (measured.thrust > 0.0)
    used = Measurements(measured.ratio[pulls], measured.thrust[pulls], measured.torque[pulls])
    different = len(np.unique(used.ratio))
    if different < degree + 1:
        raise DynoError(
            f"{different} different advance ratios with thrust, expected at least {degree + 1} for "
            f"{'a parabola; --degree 1 fits a line' if degree == 2 else 'a line'}"
        )
    thrust = _fit(used.ratio, used.thrust, degree, "CT")
    torque = _fit(used.ratio, used.torque, degree, "CQ")
    table = {"thrust": list(map(_rounded, thrust.terms)), "torque": list(map(_rounded, torque.terms))}
    advance = read_advance(StrictTable(table, "the fit", DynoError))
    left = float(advance.factors(used.ratio.max())[0])
    return PropellerFit(thrust, torque, advance, used, left)


def doubts(fit: PropellerFit) -> list[str]:
    """What the measurements do not show, a line each."""
    found = []
    last, end = float(fit.used.ratio.max()), fit.advance.ratio_max
    if fit.left > LEFT_MAX:
        found.append(
            f"{100 * fit.left:.0f} % of the thrust is left at the largest J measured, {last:.3g}: from there "
            f"to {end:.3g} the curve is a guess"
        )
    at_end = float(fit.advance.factors(end)[0])
    if at_end > END_MAX:
        found.append(
            f"the curve of the thrust never reaches 0: {100 * at_end:.0f} % stay from J = {end:.3g} on; give "
            f"measurements up to where the propeller stops pulling, or --degree 1"
        )
    return found


def _fit(ratio: Array, values: Array, degree: int, name: str) -> Curve:
    columns = np.vander(ratio, degree + 1, increasing=True)
    best, *_ = np.linalg.lstsq(columns, values, rcond=None)
    static = float(best[0])
    if not static > 0.0:
        raise DynoError(f"{name} is {static:.3g} at J = 0 by the fit, expected above 0; is a column swapped?")
    residuals = values - columns @ best
    freedom = len(values) - degree - 1
    variance = float(residuals @ residuals) / freedom if freedom else math.nan
    covariance = np.linalg.inv(columns.T @ columns) * variance
    terms, errors = [0.0, 0.0], [0.0, 0.0]
    for k in range(1, degree + 1):
        slope = np.zeros(degree + 1)  # of best[k] / best[0]
        slope[k], slope[0] = 1.0 / static, -best[k] / static**2
        terms[k - 1] = float(best[k]) / static
        errors[k - 1] = math.sqrt(float(slope @ covariance @ slope))
    residual = float(np.sqrt(np.mean(residuals**2))) / static
    return Curve(static, (terms[0], terms[1]), (errors[0], errors[1]), residual)


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")


def _read(path: Path) -> list[tuple[float, float, float]]:
    """J, C_T, C_Q of each row of a file."""
    if not path.is_file():
        raise DynoError(f"{path}: no such file; expected a table of J, CT and CQ or CP")
    try:
        size = file_size(path)
        data = path.read_bytes() if size <= FILE_BYTES_MAX else b""
        text = data.decode("utf-8-sig")
    except OSError as error:
        raise DynoError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise DynoError(f"{path}: not a text file ({error.reason} at byte {error.start})") from error
    if size > FILE_BYTES_MAX:
        raise DynoError(f"{path}: {size} bytes, expected at most {FILE_BYTES_MAX}; one propeller's table")
    rows: list[tuple[float, float, float]] = []
    names: list[str] = []
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        mark = r"[,;]" if re.search(r"[,;]", line) else r"\s+"
        cells = [cell.strip().strip('"') for cell in re.split(mark, line.strip())]
        where = f"{path}: line {number}"
        if not names:
            names = _names(cells, path)
            continue
        if len(rows) == ROWS_MAX:
            raise DynoError(f"{path}: more than {ROWS_MAX} rows; leave some out")
        if len(cells) != len(names):
            raise DynoError(f"{where}: {len(cells)} columns, expected {len(names)} as in the heading")
        rows.append(_row(dict(zip(names, cells, strict=True)), where))
    if not rows:
        raise DynoError(f"{path}: no measurements; expected a heading with J, CT and CQ or CP, then rows")
    return rows


def _names(cells: Sequence[str], path: Path) -> list[str]:
    names = [COLUMNS.get(cell.lower().replace("_", ""), f" {place}") for place, cell in enumerate(cells)]
    known = [name for name in names if name in COLUMNS.values()]
    twice = sorted({name for name in known if known.count(name) > 1})
    if twice:
        raise DynoError(f"{path}: two columns {twice[0]}; leave one out")
    lacks = [name for name in ("J", "CT") if name not in known]
    if "CQ" not in known and "CP" not in known:
        lacks.append("CQ or CP")
    if lacks:
        shown = ", ".join(cell[:20] for cell in cells[:8])
        raise DynoError(f"{path}: no column {lacks[0]} in the heading {shown!r}; expected J, CT and CQ or CP")
    return names


def _row(cells: dict[str, str], where: str) -> tuple[float, float, float]:
    values = {}
    for name, cell in cells.items():
        if name not in COLUMNS.values():
            continue
        low, high = (-RATIO_LAST, RATIO_LAST) if name == "J" else (LOW, HIGH)
        try:
            value = float(cell)
        except ValueError:
            value = math.nan
        if not low <= value <= high:  # NaN included
            raise DynoError(f"{where}: {name} is {cell[:40]!r}, expected a number from {low:g} to {high:g}")
        values[name] = value
    torque = values["CQ"] if "CQ" in values else values["CP"] / (2.0 * math.pi)
    return values["J"], values["CT"], torque
