"""A log as a flight with the figures that a trace's has, computed by the same functions.

A log has no true rate: its figures are those against the gyro. `Trace.by_gyro` gives a trace the same view,
so that the figures of both are equal to the bit where the log holds the exact values.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuroflight.sim.analysis.flight_report import Flight
from neuroflight.sim.analysis.metrics import figures
from neuroflight.sim.arrays import Array
from neuroflight.sim.blackbox.log import Log
from neuroflight.sim.blackbox.sticks import RATE_MOST_DEG_S, check
from neuroflight.sim.blackbox.units import Channels, channels
from neuroflight.sim.flight.trace import COLUMNS, Trace
from neuroflight.toolchain.contract import IDLE_DEFAULT, Mix
from neuroflight.toolchain.errors import TraceError

RATE_MIN_HZ = 20.0  # rows a second, below which no response shows
GYRO_LOST = "no line gyro_scale in its headers: tell it by --header gyro_scale=DEG_S, deg/s of a count"


@dataclass(frozen=True)
class Part:
    """The part of a log that is taken: seconds from the first armed row on."""

    start_s: float = 0.0
    stop_s: float | None = None  # None: to the last armed row


WHOLE = Part()


def armed_rows(log: Log, told: Channels, part: Part = WHOLE) -> slice:
    """Return the rows of `part`. Raises TraceError if the motors were never armed, or the part has no row."""
    rows = np.flatnonzero(told.armed)
    if not len(rows):
        raise TraceError(f"{log.where} has no armed row")
    first, last = int(rows[0]), int(rows[-1]) + 1
    chosen = part_rows(log.where, told.time(first)[: last - first], part)
    return slice(first + chosen.start, first + chosen.stop)


def cut(trace: Trace, part: Part) -> Trace:
    """Cut a part out of a trace; its t begins at 0. Raises TraceError if it has no row."""
    rows = part_rows("trace", trace.t, part)
    taken = {name: getattr(trace, name)[rows] for name in COLUMNS}
    # Computed from the rate, as for a log: a difference of times would differ in the last bit.
    if rows.start and trace.control_rate_hz:
        taken["t"] = np.arange(rows.stop - rows.start) / trace.control_rate_hz
    return Trace(**taken)


def part_rows(what: str, t: Array, part: Part) -> slice:
    """Return the rows of `part` in times t (N,) [s] that begin with 0. Raises TraceError without any."""
    # Half a row's tolerance: 0.3 s are 300 rows at 1 kHz, whatever 0.3 is in binary.
    half = 0.5 * float(np.median(np.diff(t))) if len(t) > 1 else 0.0
    start = int(np.searchsorted(t, part.start_s - half))
    stop = len(t) if part.stop_s is None else int(np.searchsorted(t, part.stop_s - half))
    if start >= stop:
        to = "its end" if part.stop_s is None else f"{part.stop_s:g} s"
        raise TraceError(
            f"{what} has no row from {part.start_s:g} s to {to}; it is {float(t[-1]):.3f} s long"
        )
    return slice(start, stop)


def log_trace(log: Log, part: Part = WHOLE, told: Channels | None = None) -> Trace:
    """Convert the armed rows of a log to a trace, the gyro in place of the true rate.

    told: `channels(log)`, if it is there already. Raises TraceError naming the fields that a trace needs and
    the log lacks.
    """
    told = channels(log) if told is None else told
    if told.setpoint is None or told.throttle is None or told.gyro is None or told.motors is None:
        raise TraceError(f"{log.where} has {_lacking(log, told)}; figures of a flight need them")
    assert told.dshot is not None  # set whenever motors are
    if log.rate_hz < RATE_MIN_HZ:
        raise TraceError(
            f"{log.where} has {log.rate_hz:.3g} rows a second, figures of a flight need {RATE_MIN_HZ:g}"
        )
    rows = armed_rows(log, told, part)
    check_sticks(log, told, rows)
    check_motors(log, told, rows)
    gyro = told.gyro[rows]
    try:
        return Trace(
            t=told.time(rows.start)[: rows.stop - rows.start],
            setpoint=told.setpoint[rows],
            rate=gyro.astype(np.float64),
            gyro=gyro,
            motors=told.motors[rows],
            dshot=told.dshot[rows],
            throttle=told.throttle[rows],
        )
    except TraceError as error:
        raise TraceError(f"{log.where}: {error}") from error


def check_sticks(log: Log, told: Channels, rows: slice, most_deg_s: float = RATE_MOST_DEG_S) -> None:
    """Raise TraceError, naming the first, for armed rows with a command that no stick gives."""
    asked = told.pilot
    assert asked.rates is not None
    throttle = None if asked.throttle is None else asked.throttle[rows]
    check(log.where, asked.rates[rows], throttle, _seconds(told, rows), rows.start, most_deg_s)


def check_motors(log: Log, told: Channels, rows: slice) -> None:
    """Raise TraceError, naming the first, for armed rows with a motor value that no motor is given."""
    assert told.motors is not None
    bad = np.isnan(told.motors[rows])
    if bad.any():
        row = int(bad.any(axis=1).argmax())
        motor = int(bad[row].argmax())
        value = log.columns[f"motor[{motor}]"][rows.start + row]
        raise TraceError(
            f"{log.where}: in row {rows.start + row}, {_seconds(told, rows)[row]:.3f} s, "
            f"motor[{motor}] is {value}, which no motor is given; leave them out by --from and --to"
        )


def _seconds(told: Channels, rows: slice) -> Array:
    """Return the times of the armed rows `rows` [s], from the first armed row."""
    first = int(np.flatnonzero(told.armed)[0])
    return told.time(first)[rows.start - first : rows.stop - first]


def _lacking(log: Log, told: Channels) -> str:
    """Return what a trace needs and this log does not have, and what the user can do about it."""
    found = []
    if told.setpoint is None:
        found.append(told.pilot.lacks)
    elif told.throttle is None:
        found.append("no throttle (setpoint[3] or rcCommand[3])")
    if told.gyro is None:
        lost = log.matrix("gyroADC", 3) is not None
        found.append(GYRO_LOST if lost else "no gyroADC[0..2]: log it (blackbox_disabled_mask)")
    if told.motors is None:
        found.append(told.motors_note or "no motor[0..]: log it (blackbox_disabled_mask)")
    return "; ".join(found)


def log_flight(
    log: Log,
    part: Part = WHOLE,
    episodes: int = 1,
    idle: float | None = None,
    mix: Mix | None = None,
) -> Flight:
    """Compute the flight of a log with its figures, averaged over `episodes` equal parts.

    idle: motor fraction at zero thrust, mix: of the throttle; None: as the log's header says. Raises
    TraceError.
    """
    told = channels(log)
    idle, mix = told.idle if idle is None else idle, told.mix if mix is None else mix
    return trace_flight(f"log {log.number}", log_trace(log, part, told), episodes, idle, mix)


def trace_flight(
    name: str,
    trace: Trace,
    episodes: int = 1,
    idle: float | None = None,
    mix: Mix | None = Mix.ATTITUDE_FIRST,
) -> Flight:
    """Compute the figures that a log of this flight has: against the gyro. Raises TraceError if rows do not
    divide.

    mix: of the throttle; None: another rule than ours. Of what cannot be undone, see `controller_output`, the
    motors' whole command is taken as the controller's output.
    """
    seen = trace.by_gyro()
    try:
        found = figures(seen, episodes, IDLE_DEFAULT if idle is None else idle, mix)
    except ValueError as error:
        raise TraceError(f"{name}: {error}; choose other --episodes, --from or --to") from error
    return Flight(name, seen, found)
