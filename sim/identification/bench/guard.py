"""The stop conditions on the bench: a sensor that is silent, stale or beyond a limit; a rotor at rest."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from neuroflight.sim.identification.bench.clocks import DRIFT_MAX
from neuroflight.sim.identification.bench.quantities import Rig, pulse_wrap, thrust_of, torque_of
from neuroflight.sim.identification.bench.sensor import TIMES, WRAP, SensorRow
from neuroflight.toolchain.errors import DynoError

SILENCE_S = 0.5  # [s] without a fresh reading
LATE_S = 0.25  # [s] by which readings may be older than the first was, beyond the drift of a clock
BLIND_THROTTLE, BLIND_S = 0.1, 0.6  # the slowest rotor turns within that time at that throttle
BLIND_RPM = 60.0  # below this it does not turn
ZERO_ROWS_MIN = 5  # from which the zero of a load cell is taken
ZERO_MAX = 0.5  # of a cell's largest load, that may weigh on it while the rotor rests: the motor's weight
REST_RPM = 300.0  # a rotor that turns faster does not rest


class StoppedError(DynoError):
    """The motor was stopped, for the reason in the message."""


@dataclass(frozen=True)
class Limits:
    """The limits beyond which a reading stops the motor."""

    rpm_max: float = math.inf
    thrust_max_n: float = math.inf
    torque_max_n_m: float = math.inf
    amps_max: float = math.inf
    temperature_max_c: float = math.inf
    volts_min: float = -math.inf


class Guard:
    """A guard of one run of the rotor, row by row."""

    def __init__(self, rig: Rig, limits: Limits, now: float) -> None:
        """now: [s] of the host's clock; the sensor has SILENCE_S from then on."""
        self._rig, self._limits = rig, limits
        self._fresh = now  # when the last reading came whose clock had moved
        self._own: float | None = None  # last reading of the sensor's clock
        self._elapsed = 0.0  # of the sensor's clock since the first row
        self._first = now  # arrival of the first row
        self._turned = now  # when the rotor turned last, or was not asked to
        self._pulses: deque[tuple[float, float]] = deque()  # time and count of the last rows
        self.zeros: dict[str, float] = {}  # counts of load cells at rest, by column, once they are known
        self.rpm = 0.0

    def take(self, row: SensorRow) -> None:
        """Check a row as it comes. Raises StoppedError."""
        if self._moved(row):
            self._fresh = row.arrival
        values = np.array([row.values])
        self.rpm = self._speed(row)
        limits = self._limits
        self._check("rotor speed", self.rpm, limits.rpm_max, "rpm")
        if self.zeros or not self._rig.raw():
            thrust, torque = (
                abs(float(of(self._rig, values, self.zeros)[0])) for of in (thrust_of, torque_of)
            )
            self._check("thrust", thrust, limits.thrust_max_n, "N")
            self._check("torque", torque, limits.torque_max_n_m, "N m")
        for name, most, unit in (
            ("amps", limits.amps_max, "A"),
            ("temperature_c", limits.temperature_max_c, "deg C"),
        ):
            if self._rig.layout.has(name):
                self._check(name, self._value(row, name), most, unit)
        if self._rig.layout.has("volts") and self._value(row, "volts") < limits.volts_min:
            raise StoppedError(
                f"volts is {self._value(row, 'volts'):g} V, expected at least {limits.volts_min:g} V; charge "
                f"the pack"
            )

    def look(self, now: float, throttle: float) -> None:
        """Check what no row shows: silence, and a rotor at rest at this throttle. Raises StoppedError."""
        if now - self._fresh > SILENCE_S:
            raise StoppedError(
                f"the sensor sent no fresh reading for {now - self._fresh:.2f} s, expected one at least "
                f"every {SILENCE_S:g} s; check its cable and that its clock runs"
            )
        if throttle < BLIND_THROTTLE or self.rpm >= BLIND_RPM:
            self._turned = now
        if now - self._turned > BLIND_S:
            raise StoppedError(
                f"the sensor shows {self.rpm:.0f} rpm at {throttle:.0%} throttle, expected a rotor that "
                f"turns; check that it is free, and the optical sensor"
            )

    def rest(self, rows: Sequence[SensorRow]) -> None:
        """Take the zeros of the load cells from rows of a rotor at rest. Raises StoppedError."""
        if len(rows) < ZERO_ROWS_MIN:
            raise StoppedError(
                f"{len(rows)} readings before the first step, expected at least {ZERO_ROWS_MIN}; send more "
                f"lines a second"
            )
        if self.rpm > REST_RPM:
            raise StoppedError(f"the rotor turns at {self.rpm:.0f} rpm before the first step, expected rest")
        values = np.array([row.values for row in rows])
        for name in self._rig.raw():
            zero = float(np.median(self._rig.column(values, name)))
            cell = self._rig.cells[name]
            away = abs((zero - cell.offset) * cell.scale)
            if away > ZERO_MAX * cell.load_max:
                raise StoppedError(
                    f"{name} shows {away:.3g} {cell.unit} at rest, expected less than half of the "
                    f"{cell.load_max:.3g} {cell.unit} of its calibration; unload it or calibrate it again"
                )
            self.zeros[name] = zero

    def _value(self, row: SensorRow, name: str) -> float:
        return row.values[self._rig.layout.names.index(name)]

    def _moved(self, row: SensorRow) -> bool:
        """Return True if the sensor's clock has moved. Raises StoppedError if it went back, or lags."""
        name = self._rig.layout.time
        if name is None:
            return True
        own = self._value(row, name)
        if self._own is None:
            self._own, self._first = own, row.arrival
            return True
        step = own - self._own
        if step < 0 and name != "time_s":
            step += WRAP
        if step < 0 or step > WRAP / 2:
            raise StoppedError(
                f"the sensor's clock went from {self._own:g} to {own:g} ({name}), expected it to rise; did "
                f"it start anew?"
            )
        self._own = own
        self._elapsed += step * TIMES[name]
        passed = row.arrival - self._first
        if passed - self._elapsed > LATE_S + DRIFT_MAX * passed:
            raise StoppedError(
                f"the sensor's readings are {passed - self._elapsed:.2f} s older than at the start, expected "
                f"them within {LATE_S:g} s; send fewer lines a second or raise the baud rate"
            )
        return step > 0

    def _speed(self, row: SensorRow) -> float:
        """Return the present rotor speed [1/min]."""
        if self._rig.layout.has("rpm"):
            return self._value(row, "rpm")
        count = self._value(row, "pulses")
        time = self._elapsed if self._rig.layout.time else row.arrival
        self._pulses.append((time, count))
        while len(self._pulses) > 2 and time - self._pulses[1][0] >= self._rig.window_s:
            self._pulses.popleft()
        before, first = self._pulses[0]
        if time - before < 0.5 * self._rig.window_s:
            return 0.0
        passed = count - first
        if passed < 0:
            passed += pulse_wrap(np.array([count, first]))
        return passed / (time - before) * 60.0 / self._rig.blades

    @staticmethod
    def _check(what: str, value: float, most: float, unit: str) -> None:
        if not value <= most:
            raise StoppedError(
                f"{what} is {value:g} {unit}, expected at most {most:g} {unit}; raise the limit only if the "
                f"rig bears it"
            )
