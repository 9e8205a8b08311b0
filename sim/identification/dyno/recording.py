"""Recordings of a dynamometer as CSV files.

One heading line names the columns, in any order, others are skipped; lines that begin with # are skipped.
Logs of other stands' programs are read by stand.py.

    time_s      [s], rising; a pause of PAUSE_S or more begins another run
    throttle    command in force from this row on, 0..1
    rpm         rotor speed [1/min]
    thrust_n    thrust [N]
    torque_n_m  torque of the propeller's drag [N m]
"""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from neuroflight.sim.aircraft.model import RPM
from neuroflight.sim.arrays import Array
from neuroflight.sim.identification.table import read_text
from neuroflight.toolchain.errors import DynoError
from neuroflight.toolchain.files import write_text

COLUMNS = ("time_s", "throttle", "rpm", "thrust_n", "torque_n_m")
FILE_BYTES_MAX = 128 << 20
LIMITS = {"rpm": 500_000.0, "thrust_n": 10_000.0, "torque_n_m": 1_000.0}  # beyond any rotor of an aircraft
ROWS_MIN, ROWS_MAX = 50, 1_000_000
PAUSE_S = 0.5
PAUSE_PERIODS = 20  # and no pause is shorter than this many of the usual periods
THROTTLE_SLACK = 0.1  # noise of a throttle that was measured, beyond 0 and 1
THROTTLE_SLIPS = 0.02  # part of the rows that may lie further out: slips of the logger


@dataclass(frozen=True, eq=False)
class Recording:
    """N rows of one or more runs of a bench; time rises throughout, runs stand one after the other."""

    time: Array  # (N,) [s]
    throttle: Array  # (N,) in force from this row on, 0..1 but for slips of the logger
    speed: Array  # (N,) [rad/s]
    thrust: Array  # (N,) [N]
    torque: Array  # (N,) [N m]; NaN throughout where none was measured
    starts: tuple[int, ...] = (0,)  # row at which each run begins

    @property
    def has_torque(self) -> bool:
        """True if a torque was measured."""
        return not bool(np.isnan(self.torque).all())


def write_recording(path: Path, recording: Recording) -> None:
    """Write `recording` as CSV in one step; its runs stay apart only if a pause lies between them."""
    speed = recording.speed / RPM
    rows = zip(recording.time, recording.throttle, speed, recording.thrust, recording.torque, strict=True)
    lines = [",".join(COLUMNS)]
    lines += [f"{t:.6f},{u:.5f},{rpm:.2f},{thrust:.5f},{torque:.6f}" for t, u, rpm, thrust, torque in rows]
    write_text(path, "\n".join(lines) + "\n")


def is_ours(text: str) -> bool:
    """Return True if the heading names all columns of our own recordings."""
    lines = (line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#"))
    names = {cell.strip().strip('"').lower() for cell in next(lines, "").split(",")}
    return set(COLUMNS) <= names


def read_recordings(paths: Sequence[Path]) -> Recording:
    """Read the runs of all `paths`, one after the other. Raises DynoError naming file and line."""
    return join_runs([_read(path) for path in paths])


def join_runs(files: Sequence[Array]) -> Recording:
    """Join the runs of files, each (n, 5) in the order of COLUMNS with rising times, one after the other."""
    columns: list[Array] = []
    starts: list[int] = []
    rows, end = 0, 0.0
    for file in files:
        values = file.copy()
        time = values[:, 0]
        pause = np.diff(time)
        breaks = np.flatnonzero(pause >= max(PAUSE_S, PAUSE_PERIODS * float(np.median(pause)))) + 1
        starts += [rows, *(rows + int(row) for row in breaks)]
        values[:, 0] += end - time[0] if rows else 0.0
        end = float(values[-1, 0]) + PAUSE_S
        rows += len(values)
        columns.append(values)
    if rows > ROWS_MAX:
        raise DynoError(f"{rows} rows in all, expected at most {ROWS_MAX}; give fewer files")
    time, throttle, rpm, thrust, torque = np.concatenate(columns).T
    return Recording(time, throttle, rpm * RPM, thrust, torque, tuple(starts))


def _read(path: Path) -> Array:
    """Read the columns of one file in the order of COLUMNS, (n, 5)."""
    reader = csv.reader(io.StringIO(read_text(path, FILE_BYTES_MAX, DynoError)))
    lines: list[int] = []
    rows: list[list[float]] = []
    order: list[int] | None = None
    try:
        for cells in reader:
            if not cells or cells[0].lstrip().startswith("#"):
                continue
            if order is None:
                order = _order(cells, path)
                continue
            if len(rows) == ROWS_MAX:
                raise DynoError(f"{path}: more than {ROWS_MAX} rows; log slower or cut it")
            rows.append(_numbers(cells, order, f"{path}: line {reader.line_num}"))
            lines.append(reader.line_num)
    except csv.Error as error:
        raise DynoError(f"{path}: line {reader.line_num}: not CSV: {error}") from error
    if len(rows) < ROWS_MIN:
        raise DynoError(f"{path}: {len(rows)} rows, expected at least {ROWS_MIN}; record for longer")
    values = np.array(rows)
    _check(values, lines, path)
    return values


def _order(cells: list[str], path: Path) -> list[int]:
    names = [cell.strip().lower() for cell in cells]
    missing = [name for name in COLUMNS if name not in names]
    if missing:
        raise DynoError(
            f"{path}: no column {missing[0]} among {', '.join(names)[:200]}; "
            f"expected a heading line with {','.join(COLUMNS)}"
        )
    twice = [name for name in COLUMNS if names.count(name) > 1]
    if twice:
        raise DynoError(f"{path}: column {twice[0]} stands twice; keep one")
    return [names.index(name) for name in COLUMNS]


def _numbers(cells: list[str], order: list[int], where: str) -> list[float]:
    values = []
    for name, index in zip(COLUMNS, order, strict=True):
        text = cells[index].strip() if index < len(cells) else ""
        try:
            value = float(text)
        except ValueError:
            value = np.nan
        if not abs(value) < 1e12:  # NaN included
            raise DynoError(
                f"{where}: {name} is {text[:40]!r}, expected a number; leave out rows without one"
            )
        values.append(value)
    return values


def _check(values: Array, lines: list[int], path: Path) -> None:
    time, throttle = values[:, 0], values[:, 1]
    back = np.flatnonzero(np.diff(time) <= 0)
    if len(back):
        row = int(back[0])
        raise DynoError(
            f"{path}: line {lines[row + 1]}: time_s is {time[row + 1]:g} after {time[row]:g}, expected it to "
            f"rise; put another run into a file of its own, `dyno fit` takes several"
        )
    if (np.abs(throttle - 0.5) > 0.5 + THROTTLE_SLACK).mean() > THROTTLE_SLIPS:
        low, high = float(throttle.min()), float(throttle.max())
        mend = "; is it in percent? divide it by 100" if 1.5 < high <= 100.0 * (1.0 + THROTTLE_SLACK) else ""
        if 900.0 < high <= 2100.0:
            mend = "; is it in microseconds? take (x - 1000)/1000"
        raise DynoError(f"{path}: throttle reaches from {low:g} to {high:g}, expected 0 to 1{mend}")
    high_half = throttle >= np.median(throttle)
    for name, most in LIMITS.items():
        typical = float(np.median(np.abs(values[high_half, COLUMNS.index(name)])))
        if typical > most:
            raise DynoError(
                f"{path}: {name} is {typical:g} in the upper half of the throttle, expected at most "
                f"{most:g}; is it in another unit?"
            )
