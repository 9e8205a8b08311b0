"""The attitude-rate PID: the baseline that every policy is compared with.

u_axis = c (K_P e + K_I sum(e) dt - a K_D d gyro/dt) / 1000 with the rate error e and the gyro in deg/s,
spread over the motors by a mixer that follows from the geometry unless the settings name their own. The sum
is then lifted until no motor is below zero, and narrowed if it spans more than the whole range: the
differences between motors, which turn the aircraft, stay.

a is 1 up to a throttle, the breakpoint, and falls from there to 1 - rate at full throttle: that is where K_D
swings first when the motors answer late. c is (nominal / measured)^2 of the battery's voltage, 1 to
PID_COMPENSATION_MAX: rotor speed goes with the voltage, thrust with its square. Both are 1 where the settings
do not name them.

Three choices are ours. The derivative is the gyro's, not the error's: no kick when the sticks jump. It may
be low-passed, as on every flight controller: bare, the NF1's gyro noise alone moves the motors by a tenth
of their range each step. And the outputs are lifted just as far as they must be. With the published gains
and mixer, without noise and delay, 1,000 commands give MAE 4.50 / 4.77 / 3.77 deg/s and MSE 410 / 455 / 177
(docs/results.md). Koch 2019, table 5.7, prints MAE 4 / 4 / 3, which its IAE = 1000 MAE shows to be cut from
4.773 / 4.941 / 3.829, and MSE 414 / 492 / 199. The derivative of the error gives the same to
0.01 deg/s, lifting by half the span 0.2 deg/s more, and clipping at zero half as much error again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sim.aircraft.model import Aircraft, PidSettings
from toolchain.contract import PID_COMPENSATION_MAX
from toolchain.errors import AircraftError

Array = NDArray[np.float64]
SCALE = 1e-3  # motor fraction of one unit of the sum; Koch 2019, ch. 5, after Betaflight's mixer
INTEGRAL_OUTPUT_MAX = 1.0  # motor fraction that the integral term alone may ask for


def mixer(aircraft: Aircraft) -> Array:
    """Share of each motor (M) in roll, pitch and yaw (3), shape (M, 3); the largest of an axis is 1.

    A rotor left of the centre of mass (y > 0) rolls right, one behind it (x < 0) pitches the nose down, one
    that turns clockwise yaws left by its reaction. Of all shares that turn one axis alone and add no
    thrust, these are the smallest.
    """
    x, y = aircraft.rotor_positions[:, :2].T
    moments = np.stack([y, -x, -aircraft.spins, np.ones(aircraft.motor_count)])  # a newton of each rotor
    shares = np.linalg.pinv(moments)[:, :3]
    scaled: Array = shares / np.abs(shares).max(axis=0)
    return scaled


def desaturated(demand: Array) -> Array:
    """Demands (N, M) moved into 0..1: narrowed where they span more than 1, lifted to be >= 0, cut at 1."""
    lowest, highest = demand.min(axis=1, keepdims=True), demand.max(axis=1, keepdims=True)
    scale = np.maximum(1.0, highest - lowest)
    moved: Array = (demand - np.minimum(lowest, 0.0)) / scale
    return moved.clip(0.0, 1.0)


class Pid:
    """N PID controllers in float64, all with the same settings or each with its own."""

    def __init__(
        self, mix: Array, settings: PidSettings | Sequence[PidSettings], count: int, control_rate_hz: int
    ) -> None:
        """mix: (M, 3), the share of each motor in roll, pitch, yaw; settings: for all, or `count` of them.

        `mix` is used, not the mixer of the settings.
        """
        each = [settings] if isinstance(settings, PidSettings) else list(settings)
        if len(each) not in (1, count):
            raise ValueError(f"{len(each)} settings for {count} controllers: expected 1 or {count}")
        self._mix = mix
        self._dt = 1.0 / control_rate_hz
        gains = np.array([item.gains for item in each]) * SCALE
        self._p, self._i, self._d = np.moveaxis(gains, 2, 0)
        with np.errstate(divide="ignore"):
            self._integral_max = np.where(self._i > 0, INTEGRAL_OUTPUT_MAX / self._i, 0.0)
        self._smoothing = np.array([[self._share(item.derivative_cutoff_hz)] for item in each])
        # A throttle is of float32, and one that equals the breakpoint is not above it.
        self._breakpoint = np.array([[item.tpa_breakpoint] for item in each], np.float32).astype(np.float64)
        self._tpa_slope = np.array([[item.tpa_rate / (1.0 - item.tpa_breakpoint)] for item in each])
        self._nominal = np.array([[item.nominal_voltage or 0.0] for item in each])
        self._compensation: float | Array = 1.0
        self._integral = np.zeros((count, 3))  # [deg]
        self._slope = np.zeros((count, 3))  # [deg/s^2], of the gyro, low-passed
        self._previous: Array | None = None  # gyro of the step before [deg/s]

    def _share(self, cutoff_hz: float | None) -> float:
        """Part of a new value that a first-order low-pass takes over in a step."""
        return 1.0 if cutoff_hz is None else 1.0 - math.exp(-2 * math.pi * cutoff_hz * self._dt)

    def reset(self) -> None:
        """Clear integral and derivative; the derivative of the next step is zero. The voltage stays."""
        self._integral[:] = 0.0
        self._slope[:] = 0.0
        self._previous = None

    def compensate(self, voltage: Array) -> None:
        """Fly from now on by the packs' voltages (count,) [V], as filtered; NaN where none is known."""
        known = voltage > 0.0
        ratio = self._nominal / np.where(known, voltage, 1.0)[:, None]
        factor = (ratio * ratio).clip(1.0, PID_COMPENSATION_MAX)
        self._compensation = np.where(known[:, None], factor, 1.0)

    def step(
        self, setpoint: NDArray[np.float32], gyro: NDArray[np.float32], throttle: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """See Controller."""
        rate = np.rad2deg(gyro.astype(np.float64))
        error = np.rad2deg(setpoint.astype(np.float64)) - rate
        slope = 0.0 if self._previous is None else (rate - self._previous) / self._dt
        self._slope += self._smoothing * (slope - self._slope)
        self._previous = rate
        self._integral = np.clip(self._integral + error * self._dt, -self._integral_max, self._integral_max)
        above = np.maximum(throttle.astype(np.float64)[:, None] - self._breakpoint, 0.0)
        d = (1.0 - self._tpa_slope * above) * self._d
        demand = self._compensation * (self._p * error + self._i * self._integral - d * self._slope)
        y: NDArray[np.float32] = desaturated(demand @ self._mix.T).astype(np.float32)
        return y


def aircraft_pid(
    aircraft: Aircraft, count: int = 1, control_rate_hz: int = 1000, name: str | None = None
) -> Pid:
    """The PID called `name` in the aircraft file, its first one unless given. Raises AircraftError."""
    settings = pid_settings(aircraft, name)
    mix = mixer(aircraft) if settings.mixer is None else np.array(settings.mixer).T
    return Pid(mix, settings, count, control_rate_hz)


def pid_settings(aircraft: Aircraft, name: str | None = None) -> PidSettings:
    """Settings of the PID called `name`, the first one unless given. Raises AircraftError."""
    pids = dict(aircraft.pids)
    if not pids:
        raise AircraftError(
            f"aircraft {aircraft.name}: no [pid.NAME] table with roll, pitch, yaw gains; add one, or let "
            f"`neuroflight tune-pid --write` do it"
        )
    if name is not None and name not in pids:
        raise AircraftError(f"aircraft {aircraft.name}: no PID {name!r}; it has: {', '.join(pids)}")
    return pids[name or next(iter(pids))]
