"""Gyro and accelerometer recordings in the forms that pilots have.

Blackbox logs (.BBL, .BFL, .TXT), what `log decode` makes of them (.npz, .csv), what blackbox_decode and the
Blackbox Explorer export (.csv), traces (.npz), and tables of ours (.csv). The gyro's scale is that of the
log's header, which an export may have above its columns or in a file beside it, or the unit in a heading;
else it is asked for.
"""

from __future__ import annotations

import csv
import json
import re
import warnings
import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.arrays import Array
from neuroflight.sim.blackbox.flight import WHOLE, Part, part_rows
from neuroflight.sim.blackbox.headers import Headers
from neuroflight.sim.blackbox.log import Frames, Log, list_logs, read_log
from neuroflight.sim.blackbox.scales import fine
from neuroflight.sim.blackbox.units import channels
from neuroflight.sim.flight.trace import load_trace
from neuroflight.sim.recorded.log import split_number
from neuroflight.sim.recorded.sidecar import headers_beside
from neuroflight.toolchain.contract import GRAVITY
from neuroflight.toolchain.errors import TraceError
from neuroflight.toolchain.files import file_size

BYTES_MAX = 256 << 20  # of a CSV file: more than an hour at 1 kHz; of an .npz file's arrays four times that
LINE_CHARACTERS_MAX = 1 << 16  # of a heading, and of lines above it
LINES_BEFORE_MAX = 2000  # above a heading: the Explorer writes some hundred
SAMPLES_MIN = 1000  # fewer know a standard deviation no better than 2 %
RATE_MIN_HZ, RATE_MAX_HZ = 20.0, 40_000.0
GAP = 1.5  # an interval longer than this many periods has lost samples
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
ROTATION = {"deg/s": np.deg2rad(1.0), "rad/s": 1.0}
OURS = ("t_s", "gyro_x_deg_s", "gyro_y_deg_s", "gyro_z_deg_s")
OURS_ACCELERATION = ("acc_x_m_s2", "acc_y_m_s2", "acc_z_m_s2")
GYRO, ACCELERATION = (tuple(f"{name}[{axis}]" for axis in range(3)) for name in ("gyroADC", "accSmooth"))
BLACKBOX = ("time (us)", *GYRO)
SCALE = "gyro_scale"  # the header
EXPLORER_SCALE = "gyroScale"  # in the Explorer's export: rad/us of a count
EXPLORER_LOST = 1e-4  # its value where the log had none
FINE = "blackbox_high_resolution"
LOGS = (".bbl", ".bfl", ".txt")
PRODUCT = b"H Product:Blackbox"
PRODUCT_WITHIN = 1 << 20  # bytes of a file
_NAME = re.compile(r"([^( ]+)(?: \((.*)\))?")  # of a blackbox column, with its unit
_PAIR = 2  # cells of a header line in an export


@dataclass(frozen=True)
class Choice:
    """The user's choice of a log, of a part of it, and of the gyro's scale."""

    number: int | None = None  # of a log in its file, from 1; None: the last that has frames
    part: Part = WHOLE  # seconds since the first sample
    unit_deg_s: float | None = None  # one count of the gyro, where the file does not say


@dataclass(frozen=True, eq=False)
class Recording:
    """N samples of a gyro, evenly spaced, and of the accelerometer beside it if there was one."""

    rate_hz: float  # samples a second
    gyro: Array  # (N, 3) [rad/s], body axes
    acceleration: Array | None  # (N, 3) [m/s^2], specific force, body axes
    gaps: int  # places where samples are missing
    notes: tuple[str, ...] = ()  # on the choice that was made and on damage, a line each


@dataclass(frozen=True, eq=False)
class Samples:
    """The samples of a file."""

    time: Array  # (N,) [s]
    gyro: Array  # (N, 3) [rad/s]
    acceleration: Array | None  # (N, 3) [m/s^2]
    notes: tuple[str, ...] = ()


def read_recording(path: Path, choice: Choice = Choice()) -> Recording:
    """Read a file of any of the forms; FILE:N names a log of a file as well.

    Betaflight's body axes are x forward, y left, z up like ours (its simulator link's FRD is turned on
    arrival), so nothing changes sign. Raises TraceError on a file that is missing, damaged, too large, too
    short or of another kind, and where nothing tells the gyro's scale.
    """
    path, number = split_number(path)
    number = choice.number if number is None else number
    if not path.is_file():
        raise TraceError(f"log {path}: no such file")
    if is_log(path):
        samples = _of_file(path, number, choice.unit_deg_s)
    elif number is not None:
        raise TraceError(f"log {path}: log {number} was asked for, but it is no blackbox log; leave it out")
    elif path.suffix.lower() == ".npz":
        samples = _of_arrays(path, choice.unit_deg_s)
    elif path.suffix.lower() in (".csv", ".txt"):
        samples = _of_table(path, choice.unit_deg_s)
    else:
        raise TraceError(
            f"log {path}: expected a blackbox log (.BBL, .BFL, .TXT), a trace or a decoded log (.npz), or a "
            "table (.csv)"
        )
    return _recording(samples, path, choice.part)


def _recording(samples: Samples, path: Path, part: Part) -> Recording:
    time, gyro, acceleration = samples.time, samples.gyro, samples.acceleration
    if part != WHOLE and len(time):
        rows = part_rows(f"log {path}", time - time[0], part)
        time, gyro = time[rows], gyro[rows]
        acceleration = None if acceleration is None else acceleration[rows]
    if len(time) < SAMPLES_MIN:
        raise TraceError(f"log {path}: {len(time)} samples, expected at least {SAMPLES_MIN}; record longer")
    rate_hz, gaps = _spacing(time, path)
    return Recording(rate_hz, gyro, acceleration, gaps, samples.notes)


def _spacing(time: Array, path: Path) -> tuple[float, int]:
    """Return samples a second and number of gaps of rising times [s]."""
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


def is_log(path: Path) -> bool:
    """Return True if the file at `path` is a blackbox log, whatever its name."""
    if not path.is_file():
        return False
    if path.suffix.lower() in LOGS[:2]:
        return True
    with path.open("rb") as file:
        return PRODUCT in file.read(PRODUCT_WITHIN)


def _of_file(path: Path, number: int | None, unit_deg_s: float | None) -> Samples:
    """Read the samples of a log, disarmed rows included."""
    log = read_log(path, number)
    notes = [f"{path.name}: log {log.number}: {note}" for note in log.notes]
    if number is None and (count := len(list_logs(path))) > 1:
        notes.insert(
            0, f"{path.name} holds {count} logs: number {log.number} is taken; --log N takes another"
        )
    return _of_log(log, unit_deg_s, notes)


def _of_log(log: Log, unit_deg_s: float | None, notes: Iterable[str] = ()) -> Samples:
    """Return the samples of a decoded log. Raises TraceError where nothing tells the gyro's scale."""
    where = f"log {log.path}"
    if log.matrix("gyroADC", len(GYRO)) is None:
        raise TraceError(f"{where}: log {log.number} has no gyroADC; log the gyro (blackbox_disabled_mask)")
    told = channels(log)
    if unit_deg_s is not None:
        if told.gyro is not None:
            raise TraceError(f"{where}: its header tells the gyro's scale; leave --gyro-unit out")
        told = channels(_made_log(log.path, log.columns, {**log.header, SCALE: repr(unit_deg_s), FINE: "0"}))
    if told.gyro is None:
        raise TraceError(
            f"{where}: nothing tells what a count of gyroADC is; give the log itself (.BBL), or --gyro-unit, "
            f"deg/s: {SCALE} of the log's header, a tenth of it where {FINE} is 1 there"
        )
    forces = told.acceleration
    if forces is None and (counts := log.matrix("accSmooth", len(ACCELERATION))) is not None:
        forces = _resting(counts.astype(np.float64))
    if forces is not None and not forces.any():
        forces = None  # the accelerometer was switched off
    gyro, acceleration = told.gyro.astype(np.float64), None if forces is None else forces.astype(np.float64)
    return Samples(log.t, gyro, acceleration, tuple(notes))


def _resting(counts: Array) -> Array:
    """Scale counts of unknown unit to specific force: at rest their mean is 1 g."""
    rest = float(np.linalg.norm(counts.mean(axis=0))) if len(counts) else 0.0
    return counts * (GRAVITY / rest) if rest else counts


def _made_log(path: Path, columns: Mapping[str, NDArray[np.int64]], values: Mapping[str, str]) -> Log:
    """Make a log from columns that another program has decoded."""
    return Log(
        path=path,
        number=1,
        size=0,
        headers=Headers(dict(values), {}, ()),
        columns=dict(columns),
        slow={},
        slow_row=np.zeros(0, np.int64),
        gps={},
        events=(),
        frames=Frames(0, 0, 0, 0),
        ended=True,
        notes=(),
    )


def _of_arrays(path: Path, unit_deg_s: float | None) -> Samples:
    """Read the samples of a trace, or of a file that `log decode --npz` wrote."""
    try:
        with zipfile.ZipFile(path) as archive:
            sizes = {member.filename: member.file_size for member in archive.infolist()}
    except (OSError, zipfile.BadZipFile, zipfile.LargeZipFile, NotImplementedError) as error:
        raise TraceError(f"log {path}: damaged or no .npz file ({error})") from error
    if "headers.npy" not in sizes:
        trace = load_trace(path)
        if unit_deg_s is not None:
            raise TraceError(f"log {path}: a trace's gyro is in rad/s; leave --gyro-unit out")
        return Samples(trace.t, np.asarray(trace.gyro, dtype=np.float64), None)
    names = {"time", "loopIteration", *GYRO, *ACCELERATION, *(f"gyroFloat[{axis}]" for axis in range(3))}
    names |= {f"setpointFloat[{axis}]" for axis in range(4)}
    wanted = [name for name in sorted(names) if f"field/{name}.npy" in sizes]
    size = sum(sizes[f"field/{name}.npy"] for name in wanted) + sizes["headers.npy"]
    if size > 4 * BYTES_MAX:
        raise TraceError(f"log {path}: {size} bytes of arrays, expected at most {4 * BYTES_MAX}")
    try:
        with np.load(path, allow_pickle=False) as arrays:
            columns = {name: np.asarray(arrays[f"field/{name}"], np.int64) for name in wanted}
            values = {str(name): str(value) for name, value in json.loads(str(arrays["headers"])).items()}
        if len({column.shape for column in columns.values()} | {(len(next(iter(columns.values()))),)}) > 1:
            raise ValueError("its columns differ in length")
    except (OSError, ValueError, EOFError, KeyError, AttributeError, zipfile.BadZipFile) as error:
        reason = " ".join(str(error).split())
        raise TraceError(f"log {path}: damaged or no decoded log ({reason}); decode it anew") from error
    return _of_log(_made_log(path, columns, values), unit_deg_s)


def _of_table(path: Path, unit_deg_s: float | None) -> Samples:
    """Read the samples of a CSV file, ours or of a blackbox tool."""
    try:
        size = file_size(path)
        if size > BYTES_MAX:
            raise TraceError(
                f"log {path}: {size} bytes, expected at most {BYTES_MAX}; cut a minute at rest out of it"
            )
        with path.open(encoding="utf-8-sig", newline="") as file:
            names, values = _heading(file, path)
            columns, scales = _columns(names, values, path)
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
    table = table.reshape(-1, len(columns))
    acceleration = table[:, 4:] if len(columns) > 4 else None
    if scales is None:
        counts = np.rint(table).astype(np.int64)
        found = dict(zip(("time", *GYRO, *ACCELERATION), counts.T, strict=False))
        values = values or headers_beside(path)
        samples = _of_log(_made_log(path, found, _log_headers(values)), unit_deg_s)
        time_us = table[:, 0] * SECONDS[_unit(names, "time") or "us"] / SECONDS["us"]
        return Samples((time_us - time_us[:1]) / 1e6, samples.gyro, samples.acceleration)
    if unit_deg_s is not None:
        raise TraceError(f"log {path}: its gyro is in deg/s, a unit is for raw counts; leave it out")
    # blackbox_decode --unit-rotation does not know high resolution: what it calls deg/s are tenths of it.
    parts = 1.0 if values or set(OURS) <= set(names) else fine(headers_beside(path))
    notes = [f"{path.name}: its header tells {FINE}, its rates are taken as tenths"] if parts != 1.0 else []
    gyro = table[:, 1:4] * (scales[1] / parts)
    return Samples(table[:, 0] * scales[0], gyro, _forces(acceleration, names), tuple(notes))


def _forces(values: Array | None, names: list[str]) -> Array | None:
    """Return specific force [m/s^2] of a table whose gyro has a unit."""
    if values is None or set(OURS) <= set(names):
        return values
    unit = _unit(names, ACCELERATION[0])
    if unit in ("m/s/s", "m/s2", "m/s^2"):
        return values
    if unit == "g":
        return values * GRAVITY
    return _resting(values) if values.any() else None


def _heading(file: TextIO, path: Path) -> tuple[list[str], dict[str, str]]:
    """Read the column names and the NAME,VALUE lines above them, which the Explorer writes."""
    values: dict[str, str] = {}
    first: list[str] = []
    for _ in range(LINES_BEFORE_MAX):
        line = file.readline(LINE_CHARACTERS_MAX)
        if not line:
            break
        cells = [cell.strip() for cell in next(csv.reader([line], skipinitialspace=True), [])]
        if set(OURS) <= set(cells) or {_bare(cell) for cell in cells} >= {"time", *GYRO}:
            return cells, values
        first = first or cells
        if len(cells) == _PAIR:
            values.setdefault(*cells)
    raise TraceError(
        f"log {path}: columns are {', '.join(first)[:120] or 'none'}; expected {', '.join(OURS)} "
        f"or {', '.join(BLACKBOX)}"
    )


def _bare(name: str) -> str:
    """Return a blackbox column's name without its unit."""
    match = _NAME.fullmatch(name)
    return match[1] if match else name


def _unit(names: list[str], bare: str) -> str:
    """Return the unit in a blackbox column's heading; "" if it has none or there is no such column."""
    found = next((match[2] for name in names if (match := _NAME.fullmatch(name)) and match[1] == bare), None)
    return found or ""


def _columns(
    names: list[str], values: Mapping[str, str], path: Path
) -> tuple[list[int], tuple[float, float] | None]:
    """Find time, gyro and, if present, acceleration; factors of time and gyro to SI, None for raw counts."""
    if set(OURS) <= set(names):
        found = [*OURS, *(OURS_ACCELERATION if set(OURS_ACCELERATION) <= set(names) else ())]
        return [names.index(name) for name in found], (1.0, ROTATION["deg/s"])
    bare = [_bare(name) for name in names]
    wanted = ["time", *GYRO, *(ACCELERATION if set(ACCELERATION) <= set(bare) else ())]
    places = [bare.index(name) for name in wanted]
    clock, turn = _unit(names, "time"), _unit(names, GYRO[0])
    # The Explorer names no unit of the time; it writes its header above, and microseconds.
    if (clock not in SECONDS and not (values and not clock)) or (turn and turn not in ROTATION):
        raise TraceError(
            f"log {path}: columns are {', '.join(names)[:120]}; expected {', '.join(OURS)} "
            f"or {', '.join(BLACKBOX)}"
        )
    return places, (SECONDS[clock or "us"], ROTATION[turn]) if turn else None


def _log_headers(values: Mapping[str, str]) -> dict[str, str]:
    """Return an export's header lines under the names that they have in a log."""
    found = dict(values)
    if SCALE not in found and (told := found.get(EXPLORER_SCALE)):
        try:
            lost = float(told) == EXPLORER_LOST
        except ValueError:
            lost = True
        if not lost:
            found[SCALE] = told
    return found
