"""The attitude-rate PID: the opponent every policy is held against.

u_axis = (K_P e + K_I sum(e) dt - K_D d gyro/dt) / 1000 with the rate error e and the gyro in deg/s, spread
over the motors by a mixer that follows from the geometry. The sum is then lifted until no motor is below
zero, and scaled down if it spans more than the whole range: differences turn the aircraft and survive.

Three choices were open. The derivative is the gyro's, not the error's: same tracking, and no kick when
the sticks jump. It is low-passed, as on every flight controller: bare, the NF1's gyro noise alone moves
the motors by a sixth of their range each step. And the outputs are lifted, not clipped at zero: without
noise and delay that gives the tracking and the mean output that Koch 2019 prints for these gains, while
clipping costs half as much error again.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sim.aircraft import Aircraft, PidSettings
from toolchain.errors import AircraftError

Array = NDArray[np.float64]
SCALE = 1e-3  # motor fraction of one unit of the sum; Koch 2019, ch. 5, after Betaflight's mixer
INTEGRAL_OUTPUT_MAX = 1.0  # motor fraction that the integral term alone may ask for


def mixer(aircraft: Aircraft) -> Array:
    """Share of each motor (M) in roll, pitch and yaw (3), shape (M, 3).

    A rotor left of the centre of mass (y > 0) rolls right, one behind it (x < 0) pitches the nose down,
    one that turns clockwise yaws left by its reaction. The longest lever of roll and pitch counts 1.
    """
    levers = aircraft.rotor_positions[:, :2]
    levers = levers / np.abs(levers).max()
    return np.column_stack([levers[:, 1], -levers[:, 0], -aircraft.spins])


def desaturated(demand: Array) -> Array:
    """Demands (N, M) moved into 0..1: narrowed where they span more than 1, lifted to be >= 0, cut at 1."""
    lowest, highest = demand.min(axis=1, keepdims=True), demand.max(axis=1, keepdims=True)
    scale = np.maximum(1.0, highest - lowest)
    moved: Array = (demand - np.minimum(lowest, 0.0)) / scale
    return moved.clip(0.0, 1.0)


class Pid:
    """N PID controllers in float64."""

    def __init__(self, mix: Array, settings: PidSettings, count: int, control_rate_hz: int) -> None:
        """mix: (M, 3), the share of each motor in roll, pitch, yaw."""
        self._mix = mix
        self._p, self._i, self._d = (np.array(settings.gains) * SCALE).T
        with np.errstate(divide="ignore"):
            self._integral_max = np.where(self._i > 0, INTEGRAL_OUTPUT_MAX / self._i, 0.0)
        self._dt = 1.0 / control_rate_hz
        self._smoothing = 1.0 - math.exp(-2 * math.pi * settings.derivative_cutoff_hz * self._dt)
        self._integral = np.zeros((count, 3))  # [deg]
        self._slope = np.zeros((count, 3))  # [deg/s^2], of the gyro, low-passed
        self._previous: Array | None = None  # gyro of the step before [deg/s]

    def reset(self) -> None:
        """Forget the past; the derivative of the next step is zero."""
        self._integral[:] = 0.0
        self._slope[:] = 0.0
        self._previous = None

    def step(
        self, setpoint: NDArray[np.float32], gyro: NDArray[np.float32], throttle: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """See Controller; `throttle` has no part in it."""
        rate = np.rad2deg(gyro.astype(np.float64))
        error = np.rad2deg(setpoint.astype(np.float64)) - rate
        slope = 0.0 if self._previous is None else (rate - self._previous) / self._dt
        self._slope += self._smoothing * (slope - self._slope)
        self._previous = rate
        self._integral = np.clip(self._integral + error * self._dt, -self._integral_max, self._integral_max)
        demand = self._p * error + self._i * self._integral - self._d * self._slope
        y: NDArray[np.float32] = desaturated(demand @ self._mix.T).astype(np.float32)
        return y


def aircraft_pid(
    aircraft: Aircraft, count: int = 1, control_rate_hz: int = 1000, name: str | None = None
) -> Pid:
    """The PID called `name` in the aircraft file, its first one unless given. Raises AircraftError."""
    return Pid(mixer(aircraft), pid_settings(aircraft, name), count, control_rate_hz)


def pid_settings(aircraft: Aircraft, name: str | None = None) -> PidSettings:
    """Settings of the PID called `name`, the first one unless given. Raises AircraftError."""
    pids = dict(aircraft.pids)
    if not pids:
        raise AircraftError(
            f"aircraft {aircraft.name}: no [pid.NAME] table with roll, pitch, yaw gains; add one"
        )
    if name is not None and name not in pids:
        raise AircraftError(f"aircraft {aircraft.name}: no PID {name!r}; it has: {', '.join(pids)}")
    return pids[name or next(iter(pids))]
