"""A flight as the fit takes it: motors and gyro of its pieces without gaps, evenly spaced, in SI units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from neuroflight.sim.arrays import Array, Array32, Flags
from neuroflight.sim.blackbox.firmware import Maker
from neuroflight.sim.blackbox.flight import WHOLE, Part, armed_rows, check_motors, part_rows
from neuroflight.sim.blackbox.log import Log, read_log
from neuroflight.sim.blackbox.units import Channels, channels, control_rate_hz
from neuroflight.sim.flight.trace import load_trace
from neuroflight.sim.identification.fit.gyro_path import GyroPath, logged_path, mean_path, raw_gyro
from neuroflight.sim.recorded.log import SUFFIXES, split_number
from neuroflight.toolchain.errors import TraceError

RATE_MIN_HZ = 200.0  # of a log: rotors move much between slower rows
GRID_HZ = 1000.0  # that a piece is brought near to: faster logs are averaged, slower ones interpolated
GAP_S = 0.0045  # and what is longer than this and than 2.5 rows ends a piece
PIECE_MAX_S = 20.0  # longer ones are cut
PIECE_MIN_S = 1.6  # shorter ones tell little beyond the rotors' settling
FLOWN_MIN_S = 3.0
TWIN_STEP_S = 1.0 / 4000.0  # of a twin that is flown; its Euler step leads by half of it
GROUND_RATE = np.deg2rad(6.0)  # [rad/s], root mean square below which an aircraft with slow motors stands
GROUND_WINDOW_S = 0.5


@dataclass(frozen=True, eq=False)
class Piece:
    """Rows without a gap, `step_s` apart."""

    start_s: float  # since the first armed row
    step_s: float
    motors: Array  # (N, M) fractions 0..1
    gyro: Array  # (N, 3) [rad/s]
    speed: Array | None  # (N, M) [rad/s] of the rotors as ESCs tell
    voltage: Array | None  # (N,) [V]
    force: Array | None  # (N, 3) [m/s^2], specific force
    flown: Flags  # (N,) in the air, as far as the gyro tells
    asked: Array | None = None  # (N, 4) setpoints [rad/s], and the throttle, 0 where it is not logged

    @property
    def seconds(self) -> float:
        return len(self.motors) * self.step_s


@dataclass(frozen=True, eq=False)
class Flight:
    """A log's pieces, and what is known of its gyro's and its motors' way."""

    name: str
    pieces: tuple[Piece, ...]
    rate_hz: float  # rows a second in the log
    control_s: float  # [s] between two commands of the loop
    twin_s: float  # [s] of a twin's step that the delay is told for: by its half, it leads
    path: GyroPath  # of the gyro that was logged
    idle: float | None  # motor fraction at zero thrust
    current: float | None  # [A] on average
    notes: tuple[str, ...]
    pack: bool = True  # on a battery; simulated flights are on a bench supply, unless they are told a charge

    @property
    def motor_count(self) -> int:
        return int(self.pieces[0].motors.shape[1])

    @property
    def seconds(self) -> float:
        """Length of its pieces [s]."""
        return sum(piece.seconds for piece in self.pieces)

    @property
    def has_speed(self) -> bool:
        return any(piece.speed is not None for piece in self.pieces)

    @property
    def has_voltage(self) -> bool:
        return any(piece.voltage is not None for piece in self.pieces)


NAMES = ("motors", "gyro", "speed", "voltage", "force", "asked")


@dataclass(frozen=True, eq=False)
class _Rows:
    """The armed rows of a log."""

    time: Array
    motors: Array
    gyro: Array
    speed: Array | None
    voltage: Array | None
    force: Array | None
    asked: Array | None


def read_flight(
    path: Path, motors: int, part: Part = WHOLE, lines: Mapping[str, str] | None = None
) -> Flight:
    """Read a trace (.npz) or a blackbox log (FILE:N) of an aircraft with that many motors.

    lines: of the header that the user tells. Raises TraceError on a file that is none, without motors or
    gyro, with other motors, too slow or too short.
    """
    file, number = split_number(path)
    if file.suffix == ".npz":
        trace = load_trace(file)
        rows = part_rows(str(path), trace.t, part)
        told = _Rows(
            trace.t[rows],
            trace.motors[rows],
            trace.gyro[rows].astype(np.float64),
            None,
            None,
            None,
            _asked(trace.setpoint[rows], trace.throttle[rows]),
        )
        control = trace.step_s
        late = _late(trace.rate[rows], told.gyro, control)
        step = TWIN_STEP_S if late > 0.3 * control > 0.3 * TWIN_STEP_S else control
        flight = _flight(path, told, motors, control, step, mean_path(control, step), None, None, ())
        return replace(flight, pack=False)
    if file.suffix.lower() not in SUFFIXES:
        raise TraceError(f"log {path}: expected a trace (.npz) or a blackbox log ({', '.join(SUFFIXES)})")
    log = read_log(file, number, lines=lines)
    return log_flight(path, log, motors, part)


def _asked(setpoint: Array32, throttle: Array32 | None) -> Array:
    """Return what the pilot asked (N, 4); 0 where the stick commanded an angle, and without a throttle."""
    other = np.zeros(len(setpoint)) if throttle is None else throttle
    return np.nan_to_num(np.column_stack([setpoint, other]).astype(np.float64))


def _late(rate: Array, gyro: Array, step: float) -> float:
    """Return how late [s] a trace's gyro is beside the true rate, 0 to half a step: a mean of samples."""
    slope = np.gradient(rate, step, axis=0)
    other = np.column_stack([rate, np.ones(len(rate))])  # a chip that is turned reads the other axes, too
    lates = [
        -float(np.linalg.lstsq(np.column_stack([slope[:, axis], other]), gyro[:, axis], rcond=None)[0][0])
        for axis in range(3)
    ]
    return float(np.clip(np.average(lates, weights=slope.var(axis=0) + 1e-12), 0.0, 0.5 * step))


def log_flight(path: Path, log: Log, motors: int, part: Part = WHOLE) -> Flight:
    """Take the flight from a decoded log; see read_flight."""
    told = channels(log)
    if told.motors is None or told.gyro is None:
        raise TraceError(f"log {path}: has {told.motors_note or 'no motors or no gyro; log both'}")
    rows = armed_rows(log, told, part)
    check_motors(log, told, rows)
    raw, whence = raw_gyro(log, told)
    gyro = told.gyro if raw is None else raw
    ours = log.maker is Maker.NEUROFLIGHT
    loop = control_rate_hz(log)
    control = 1.0 / loop if loop else log.row_us / 1e6
    if ours:
        gyro_path = mean_path(control, control if raw is not None else TWIN_STEP_S)
    else:
        gyro_path = logged_path(log.headers, raw is not None, whence)
    speed = None if told.rpm is None else told.rpm[rows] * (2 * np.pi / 60)
    if speed is not None and not speed.any():
        speed = None
    voltage = told.voltage
    if voltage is not None and not ((voltage[rows] > 2.0).mean() > 0.9 and np.ptp(voltage[rows]) > 0.0):
        voltage = None
    found = _Rows(
        told.time(rows.start)[: rows.stop - rows.start],
        told.motors[rows],
        gyro[rows].astype(np.float64),
        speed,
        None if voltage is None else voltage[rows],
        None if told.acceleration is None else told.acceleration[rows],
        None
        if told.setpoint is None
        else _asked(told.setpoint[rows], None if told.throttle is None else told.throttle[rows]),
    )
    current = None if told.current is None else float(np.mean(told.current[rows]))
    return _flight(
        path, found, motors, control, TWIN_STEP_S, gyro_path, told.idle, current, _doubts(log, told)
    )


def _doubts(log: Log, told: Channels) -> tuple[str, ...]:
    notes = [*log.notes]
    if told.motors_note:
        notes.append(told.motors_note)
    return tuple(notes)


def _flight(
    path: Path,
    rows: _Rows,
    motors: int,
    control_s: float,
    twin_s: float,
    gyro_path: GyroPath,
    idle: float | None,
    current: float | None,
    notes: tuple[str, ...],
) -> Flight:
    if rows.motors.shape[1] != motors:
        raise TraceError(f"log {path}: {rows.motors.shape[1]} motors, the aircraft has {motors}")
    if len(rows.time) < 100:
        raise TraceError(f"log {path}: {len(rows.time)} armed rows, expected at least {FLOWN_MIN_S:g} s")
    usual = float(np.median(np.diff(rows.time)))
    if usual <= 0 or 1.0 / usual < RATE_MIN_HZ:
        told = 0.0 if usual <= 0 else 1.0 / usual
        raise TraceError(
            f"log {path}: {told:.0f} rows a second, expected at least {RATE_MIN_HZ:g}; set "
            "blackbox_sample_rate so that 500 or more are logged"
        )
    gaps = 1 + np.flatnonzero(np.diff(rows.time) > max(GAP_S, 2.5 * usual))
    pieces = []
    for start, stop in zip([0, *gaps], [*gaps, len(rows.time)], strict=True):
        seconds = rows.time[stop - 1] - rows.time[start]
        if seconds < PIECE_MIN_S:
            continue
        cuts = np.linspace(start, stop, int(np.ceil(seconds / PIECE_MAX_S)) + 1).astype(int)
        pieces += [_piece(rows, slice(int(a), int(b)), usual) for a, b in pairwise(cuts)]
    seconds = sum(piece.step_s * float(piece.flown.sum()) for piece in pieces)
    if seconds < FLOWN_MIN_S:
        raise TraceError(
            f"log {path}: {seconds:.1f} s in the air without a gap, expected at least {FLOWN_MIN_S:g}; fly "
            "longer"
        )
    if len(gaps):
        notes = (*notes, f"{len(gaps)} gaps: {len(pieces)} pieces between them are taken")
    return Flight(str(path), tuple(pieces), 1.0 / usual, control_s, twin_s, gyro_path, idle, current, notes)


def _piece(rows: _Rows, part: slice, usual: float) -> Piece:
    """Bring a part to even steps near GRID_HZ."""
    time = rows.time[part]
    count = round((time[-1] - time[0]) / usual) + 1
    even = np.linspace(time[0], time[-1], count)
    step = float(even[1] - even[0])

    def brought(values: Array | None) -> Array | None:
        if values is None:
            return None
        taken = values[part].reshape(len(time), -1)
        level = np.column_stack([np.interp(even, time, column) for column in taken.T])
        return level.reshape(count, *values.shape[1:])

    told = {name: brought(getattr(rows, name)) for name in NAMES}
    merged = max(1, int(1.0 / (GRID_HZ * step) + 0.05))
    if merged > 1:
        count //= merged

        def mean(values: Array | None) -> Array | None:
            if values is None:
                return None
            each = values[: count * merged].reshape(count, merged, *values.shape[1:])
            return np.asarray(each.mean(axis=1), np.float64)

        told = {name: mean(values) for name, values in told.items()}
    assert told["motors"] is not None and told["gyro"] is not None
    flown = _flown(told["motors"], told["gyro"], step * merged)
    return Piece(float(time[0]), step * merged, flown=flown, **told)  # type: ignore[arg-type]


def _flown(motors: Array, gyro: Array, step: float) -> Flags:
    """Return where the aircraft is in the air: not where it is still with motors far below the usual."""
    width = max(1, round(GROUND_WINDOW_S / step))
    kernel = np.ones(width) / width
    power = np.convolve((motors**2).mean(axis=1), kernel, mode="same")
    still = np.sqrt(np.convolve((gyro**2).sum(axis=1), kernel, mode="same")) < GROUND_RATE
    slow = power < 0.3 * np.median(power[power > 0.1 * power.max()])
    return np.asarray(~(still & slow))
