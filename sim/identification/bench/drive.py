"""Drives one rotor through an experiment beside a sensor; whatever goes wrong leaves by an exception.

Nothing here stops the motor: it stands in a `with` of the caller's, which stops it however this ends.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from neuroflight.sim.arrays import Array
from neuroflight.sim.identification.bench.guard import Guard, StoppedError
from neuroflight.sim.identification.bench.sensor import LineReader, SensorRow
from neuroflight.sim.identification.dyno.bench import Phase, duration, throttle_at
from neuroflight.toolchain.errors import DynoError

Clock = Callable[[], float]

TICK_S = 0.02  # between two commands: a ramp of 20 s moves by 0.1 %, the resolution of SET_MOTOR
CHECK_S = 0.2  # between two looks at the board's state
HELD_UP_S = 0.25  # a longer gap between two commands stops: the board would, after 0.5 s
SETTLE_S = 0.3  # for reading and discarding old bytes of the sensor's line
START_S = 6.0  # in which a sensor has to send readings: a board that resets when its port opens takes 2 s
START_ROWS = 5


class Motor(Protocol):
    """One motor that turns while it is told to."""

    def give(self, throttle: float) -> float:
        """Command it, 0..1; return the command after rounding."""

    def check(self) -> None:
        """Raise an error unless the board is in the state in which the run began."""


class Line(Protocol):
    """The sensor's line; see flash.transport.Transport."""

    def read(self, timeout: float) -> bytes:
        """Return what has arrived, or what arrives first within `timeout` > 0 [s]; b"" for silence."""


class Sensor:
    """A line and the reader of what comes over it."""

    def __init__(self, line: Line, reader: LineReader, clock: Clock) -> None:
        self._line, self._clock = line, clock
        self.reader = reader

    def rows(self, timeout: float) -> list[SensorRow]:
        """Return the rows that have arrived, or arrive first within `timeout` > 0 [s]."""
        data = self._line.read(timeout)
        return self.reader.feed(data, self._clock()) if data else []

    def await_rows(self) -> None:
        """Wait for the first readings. Raises DynoError that says what comes instead."""
        end, count = self._clock() + START_S, 0
        while count < START_ROWS:
            left = end - self._clock()
            if left <= 0:
                raise DynoError(
                    f"the sensor sent {self._seen()} within {START_S:g} s, expected lines of numbers"
                )
            count += len(self.rows(left))

    def settle(self) -> None:
        """Discard bytes that wait in the line."""
        end = self._clock() + SETTLE_S
        while (left := end - self._clock()) > 0:
            self.rows(left)

    def _seen(self) -> str:
        reader = self.reader
        if reader.layout is None and reader.headless:
            return f"{reader.headless} lines of numbers without a heading (give --columns)"
        if reader.bad:
            return f"{reader.bad} lines that are no reading (check the baud rate: serial:DEVICE:BAUD)"
        return "nothing (check its cable and power)"


@dataclass(frozen=True, eq=False)
class Log:
    """One run as it was recorded: K commands and N rows, times of the host's clock [s] since its begin."""

    command_time: Array  # (K,) when each was sent
    throttle: Array  # (K,) 0..1
    arrival: Array  # (N,) when each row was read
    values: Array  # (N, C), columns of the layout
    zeros: Mapping[str, float]  # counts of load cells at rest, by column


def drive(
    motor: Motor,
    sensor: Sensor,
    guard: Guard,
    experiment: tuple[Phase, ...],
    clock: Clock,
    deadline: float = math.inf,
    told: Callable[[float, float, float], None] = lambda elapsed, throttle, rpm: None,
) -> Log:
    """Take the rotor through `experiment`, which begins and ends with it at rest.

    deadline: [s] of `clock`, the end of all. told: is told time, throttle and rpm at every command.
    Raises StoppedError and whatever motor and sensor raise.
    """
    length = duration(experiment)
    rows: list[SensorRow] = []
    commands: list[tuple[float, float]] = []
    begin = last = checked = clock()
    rested = False
    while (elapsed := (now := clock()) - begin) < length:
        if now > deadline:
            raise StoppedError("the time limit is over; give more with --time-limit, then --resume")
        if now - last > HELD_UP_S:
            raise StoppedError(
                f"this computer was held up for {now - last:.2f} s between two commands, expected "
                f"{HELD_UP_S:g} s at most; close other programs"
            )
        last = now
        throttle = float(throttle_at(np.array(elapsed), experiment))
        if throttle > 0.0 and not rested:
            guard.rest(rows)
            rested = True
        given = motor.give(throttle)
        commands.append((elapsed, given))
        if now - checked >= CHECK_S:
            motor.check()
            checked = now
        told(elapsed, given, guard.rpm)
        due = begin + (math.floor(elapsed / TICK_S + 1e-6) + 1) * TICK_S
        while (left := due - clock()) > 0:
            for row in sensor.rows(left):
                guard.take(row)
                rows.append(row)
        guard.look(clock(), given)
    times, throttles = np.array(commands).T
    values = np.array([row.values for row in rows], np.float64)
    arrival = np.array([row.arrival for row in rows]) - begin
    return Log(times, throttles, arrival, values, dict(guard.zeros))
