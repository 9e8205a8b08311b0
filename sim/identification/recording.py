"""Gyro and accelerometer recordings: traces, and CSV files, ours or those of Betaflight's blackbox tools."""

from __future__ import annotations

import csv
import math
import re
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sim.flight.trace import load_trace
from toolchain.contract import GRAVITY
from toolchain.errors import TraceError
from toolchain.files import file_size

Array = NDArray[np.float64]

BYTES_MAX = 256 << 20  # of a CSV file: more than an hour at 1 kHz
HEADER_CHARACTERS_MAX = 1 << 16
SAMPLES_MIN = 1000  # fewer know a standard deviation no better than 2 %
RATE_MIN_HZ, RATE_MAX_HZ = 20.0, 40_000.0
GAP = 1.5  # an interval longer than this many periods has lost samples
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
ROTATION = {"": math.radians(1.0), "deg/s": math.radians(1.0), "rad/s": 1.0}
OURS = ("t_s", "gyro_x_deg_s", "gyro_y_deg_s", "gyro_z_deg_s")
OURS_ACCELERATION = ("acc_x_m_s2", "acc_y_m_s2", "acc_z_m_s2")
_NAME = re.compile(r"([^( ]+)(?: \((.*)\))?")  # of a blackbox column, with its unit
BLACKBOX = ("time (us)", "gyroADC[0]", "gyroADC[1]", "gyroADC[2]")


@dataclass(frozen=True, eq=False)
class Recording:
    """N samples of a gyro, evenly spaced, and of the accelerometer beside it if there was one."""

    rate_hz: float  # samples a second
    gyro: Array  # (N, 3) [rad/s], body axes
    acceleration: Array | None  # (N, 3) [m/s^2], specific force, body axes
    gaps: int  # places where samples are missing


def read_recording(path: Path, unit_deg_s: float = 1.0) -> Recording:
    """Read a trace (.npz) or a CSV file (.csv).

    CSV columns are `OURS`, with `OURS_ACCELERATION` if there is an accelerometer, or those that
    `blackbox_decode` writes: time, gyroADC[0..2], accSmooth[0..2]. Betaflight's body axes are x forward,
    y left, z up like ours (its simulator link's FRD is turned on arrival), so nothing changes sign; raw
    gyroADC counts `unit_deg_s` [deg/s], and accSmooth is scaled to 1 g at rest.

    Raises TraceError on a file that is missing, damaged, too large, too short or of another kind.
    """
    if path.suffix == ".npz":
        trace = load_trace(path)
        time, gyro, acceleration = trace.t, np.asarray(trace.gyro, dtype=np.float64), None
    elif path.suffix == ".csv":
        time, gyro, acceleration = _read_csv(path, unit_deg_s)
    else:
        raise TraceError(f"log {path}: expected a trace (.npz) or a table (.csv)")
    if len(time) < SAMPLES_MIN:
        raise TraceError(f"log {path}: {len(time)} samples, expected at least {SAMPLES_MIN}; record longer")
    rate_hz, gaps = _spacing(time, path)
    return Recording(rate_hz, gyro, acceleration, gaps)


def _spacing(time: Array, path: Path) -> tuple[float, int]:
    """Samples a second and number of gaps, of rising times [s]."""
    intervals = np.diff(time)
    if not (intervals > 0).all():
        row = int(np.argmin(intervals > 0)) + 2
        raise TraceError(f"log {path}: time does not rise at sample {row}; expected one record in order")
    whole = intervals < GAP * float(np.median(intervals))
    rate_hz = float(whole.sum() / intervals[whole].sum())
    if not RATE_MIN_HZ <= rate_hz <= RATE_MAX_HZ:
        raise TraceError(
            f"log {path}: {rate_hz:.4g} samples a second, expected {RATE_MIN_HZ:g} to {RATE_MAX_HZ:g}; "
            "check the unit of the time column"
        )
    return rate_hz, int((~whole).sum())


def _read_csv(path: Path, unit_deg_s: float) -> tuple[Array, Array, Array | None]:
    """Time [s], gyro [rad/s] and specific force [m/s^2] of the columns that `read_recording` names."""
    if not path.is_file():
        raise TraceError(f"log {path}: no such file")
    try:
        size = file_size(path)
        if size > BYTES_MAX:
            raise TraceError(
                f"log {path}: {size} bytes, expected at most {BYTES_MAX}; cut a minute at rest out of it"
            )
        with path.open(encoding="utf-8-sig", newline="") as file:
            heading = file.readline(HEADER_CHARACTERS_MAX)
            names = [name.strip() for name in next(csv.reader([heading], skipinitialspace=True), [])]
            columns, scales, raw_acceleration = _columns(names, path, unit_deg_s)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of an empty table: it is refused for its length
                table = np.loadtxt(
                    file, delimiter=",", usecols=columns, ndmin=2, comments=None, quotechar='"'
                )
    except (OSError, ValueError, csv.Error) as error:
        reason = " ".join(str(error).split())
        raise TraceError(f"log {path}: damaged or no table ({reason})") from error
    if not np.isfinite(table).all():
        row, column = np.argwhere(~np.isfinite(table))[0]
        raise TraceError(
            f"log {path}: {names[columns[column]]} of sample {row + 1} is {table[row, column]}, "
            "expected a finite number"
        )
    table = table.reshape(-1, len(columns)) * scales
    acceleration = table[:, 4:] if len(columns) > 4 else None
    if acceleration is not None and raw_acceleration and len(acceleration):
        rest = float(np.linalg.norm(acceleration.mean(axis=0)))
        if rest == 0.0:
            raise TraceError(
                f"log {path}: accSmooth is zero throughout; log an accelerometer or leave it out"
            )
        acceleration = acceleration * (GRAVITY / rest)
    return table[:, 0], table[:, 1:4], acceleration


def _columns(names: list[str], path: Path, unit_deg_s: float) -> tuple[list[int], Array, bool]:
    """Where time, gyro and maybe acceleration stand, what turns them into SI, whether 1 g is to be found."""
    if set(OURS) <= set(names):
        if unit_deg_s != 1.0:
            raise TraceError(f"log {path}: its gyro is in deg/s, a unit is for blackbox logs; leave it out")
        found, scales = [*OURS], [1.0, *[ROTATION["deg/s"]] * 3]
        if set(OURS_ACCELERATION) <= set(names):
            found += OURS_ACCELERATION
            scales += [1.0] * 3
        return [names.index(name) for name in found], np.array(scales), False
    # blackbox_decode puts a unit behind a name, unless the column is raw.
    bare = {
        match[1]: (at, match[2] or "") for at, name in enumerate(names) if (match := _NAME.fullmatch(name))
    }
    wanted = ["time", *(f"gyroADC[{axis}]" for axis in range(3))]
    missing = [name for name in wanted if name not in bare]
    if missing or bare["time"][1] not in SECONDS or bare["gyroADC[0]"][1] not in ROTATION:
        raise TraceError(
            f"log {path}: columns are {', '.join(names)[:120] or 'none'}; expected {', '.join(OURS)} "
            f"or {', '.join(BLACKBOX)}"
        )
    unit = bare["gyroADC[0]"][1]
    turn = ROTATION[unit] * (1.0 if unit else unit_deg_s)
    more = [f"accSmooth[{axis}]" for axis in range(3)]
    scales = [SECONDS[bare["time"][1]], turn, turn, turn]
    if all(name in bare for name in more):
        wanted += more
        scales += [1.0] * 3
    return [bare[name][0] for name in wanted], np.array(scales), True
