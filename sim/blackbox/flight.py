"""A log as a flight with the figures that a trace's has, computed by the same functions.

A log has no true rate: its figures are those against the gyro. `Trace.by_gyro` gives a trace the same view,
so that the figures of both are equal to the bit where the log holds the exact values.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.analysis.flight_report import Flight
from sim.analysis.metrics import figures
from sim.blackbox.log import Log
from sim.blackbox.units import Channels, channels
from sim.flight.trace import COLUMNS, Trace
from toolchain.contract import IDLE_DEFAULT, Mix
from toolchain.errors import TraceError

RATE_MIN_HZ = 20.0  # rows a second, below which no response shows


@dataclass(frozen=True)
class Part:
    """The part of a log that is taken: seconds from the first armed row on."""

    start_s: float = 0.0
    stop_s: float | None = None  # None: to the last armed row


WHOLE = Part()


def armed_rows(log: Log, told: Channels, part: Part = WHOLE) -> slice:
    """Rows of `part`. Raises TraceError where the motors were never armed, or the part holds no row."""
    rows = np.flatnonzero(told.armed)
    if not len(rows):
        raise TraceError(f"{log.path}: log {log.number} has no armed row")
    first, last = int(rows[0]), int(rows[-1]) + 1
    chosen = part_rows(f"{log.path}: log {log.number}", told.time(first)[: last - first], part)
    return slice(first + chosen.start, first + chosen.stop)


def cut(trace: Trace, part: Part) -> Trace:
    """The part of a trace, whose t begins with it. Raises TraceError where it holds no row."""
    rows = part_rows("trace", trace.t, part)
    taken = {name: getattr(trace, name)[rows] for name in COLUMNS}
    # By the rate, as a log counts it: a difference of times would be another number by a bit.
    if rows.start and trace.control_rate_hz:
        taken["t"] = np.arange(rows.stop - rows.start) / trace.control_rate_hz
    return Trace(**taken)


def part_rows(what: str, t: NDArray[np.float64], part: Part) -> slice:
    """Rows of `part` in times t (N,) [s] that begin with 0. Raises TraceError where there are none."""
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
    """The armed rows of a log as a trace, the gyro in place of the true rate.

    told: `channels(log)`, if it is there already. Raises TraceError naming the fields that a trace needs and
    the log lacks.
    """
    told = channels(log) if told is None else told
    if told.setpoint is None or told.gyro is None or told.motors is None or told.dshot is None:
        lacking = [
            name
            for name, column in (
                ("setpoint[0..3]", told.setpoint),
                ("gyroADC[0..2]", told.gyro),
                ("motor[0..]", told.motors),
            )
            if column is None
        ]
        raise TraceError(
            f"{log.path}: log {log.number} has no {' and no '.join(lacking)}; figures of a flight need "
            "them: log them (blackbox_disabled_mask)"
        )
    assert told.throttle is not None  # it comes with the setpoint
    if log.rate_hz < RATE_MIN_HZ:
        raise TraceError(
            f"{log.path}: log {log.number} has {log.rate_hz:.3g} rows a second, figures of a "
            f"flight need {RATE_MIN_HZ:g}"
        )
    rows = armed_rows(log, told, part)
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
        raise TraceError(f"{log.path}: log {log.number}: {error}") from error


def log_flight(
    log: Log,
    part: Part = WHOLE,
    episodes: int = 1,
    idle: float | None = None,
    mix: Mix | None = None,
) -> Flight:
    """The flight of a log with its figures, averaged over `episodes` equal parts.

    idle: motor fraction at zero thrust, mix: of the throttle; None: as the log's header says. Raises
    TraceError.
    """
    told = channels(log)
    trace = log_trace(log, part, told)
    name = f"log {log.number}"
    return trace_flight(
        name,
        trace,
        episodes,
        told.idle if idle is None else idle,
        told.mix if mix is None else mix,
    )


def trace_flight(
    name: str,
    trace: Trace,
    episodes: int = 1,
    idle: float | None = None,
    mix: Mix | None = Mix.ATTITUDE_FIRST,
) -> Flight:
    """The figures that a log of this flight has: against the gyro. Raises TraceError if rows do not divide.

    mix: of the throttle; None: another rule than ours. Of what cannot be undone, see `controller_output`, the
    motors' whole command is taken as the controller's output.
    """
    seen = trace.by_gyro()
    try:
        found = figures(seen, episodes, IDLE_DEFAULT if idle is None else idle, mix)
    except ValueError as error:
        raise TraceError(f"{name}: {error}; choose other --episodes, --from or --to") from error
    return Flight(name, seen, found)
