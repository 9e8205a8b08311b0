"""Models of gyro and accelerometer, and the 16-bit counts of a gyro chip. Vectorised over N aircraft.

A reading is the true value turned to the chip, lagged by its low-pass, plus the constant of the episode,
white noise and vibration from the rotors. Effects that the aircraft file leaves out are skipped.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sim.aircraft.model import Accelerometer, Gyro
from toolchain.contract import GYRO_COUNTS, GYRO_FULL_SCALE_DEG_S

Array = NDArray[np.float64]
Which = NDArray[np.intp] | slice  # some of the aircraft
EVERYONE = slice(None)
RATE_PER_COUNT = np.float32(np.deg2rad(GYRO_FULL_SCALE_DEG_S / GYRO_COUNTS))  # [rad/s], the firmware's
ONE = 1.0  # times the noise of the settings

# Phase between axes of the vibration [rad]: an unbalanced rotor shakes across its own axis in a circle.
VIBRATION_PHASE = np.array([0.0, math.pi / 2, math.pi / 4])


def draw_bias(noise: Gyro | Accelerometer, count: int, rng: np.random.Generator) -> Array:
    """Constant offset of each aircraft's sensor for one episode, in the sensor's unit, (count, 3)."""
    return rng.normal(0.0, noise.bias, (count, 3))


def measured_rate(
    rate: Array,
    bias: Array,
    noise: Gyro | Accelerometer,
    rng: np.random.Generator,
    factor: Array | float = ONE,
) -> Array:
    """Reading before rounding, (N, 3): the true value with bias and `factor` times white noise.

    factor: one for all or (N, 1).
    """
    scale = _noise_of(noise.noise)
    if factor is not ONE:
        scale = scale * factor
    return np.asarray(rate + bias + rng.standard_normal(rate.shape) * scale)


@lru_cache(maxsize=16)
def _noise_of(noise: tuple[float, float, float]) -> Array:
    return np.array(noise)


def counts(rate: Array) -> NDArray[np.int16]:
    """Rate [rad/s] as the chip's 16-bit counts at +-2000 deg/s: round half to even, then saturate."""
    scaled = np.rint(np.rad2deg(rate) * (GYRO_COUNTS / GYRO_FULL_SCALE_DEG_S))
    return np.clip(scaled, -GYRO_COUNTS, GYRO_COUNTS - 1).astype(np.int16)


def quantised_rate(rate: Array) -> NDArray[np.float32]:
    """Rate [rad/s] after the chip and the firmware's conversion back, float32."""
    return counts(rate).astype(np.float32) * RATE_PER_COUNT


def rotor_vibration(phase: Array, speed: Array, speed_max: float, amplitude: Array) -> Array:
    """Vibration of each axis from the rotors' unbalance, (N, 3), in the unit of `amplitude` (3,).

    phase: angle of each rotor [rad], speed: its speed [rad/s], both (N, M). An unbalance pulls with the
    square of the speed: `amplitude` is that of one rotor at `speed_max` [rad/s].
    """
    strength = np.square(speed / speed_max)
    waves = np.sin(phase[:, :, None] + VIBRATION_PHASE)
    return np.asarray(np.matmul(strength[:, None, :], waves)[:, 0, :] * amplitude)


def rotation_by(turn: Array) -> Array:
    """Rotation matrix (3, 3) of a turn about the axis and by the length of `turn` [rad] (Rodrigues)."""
    angle = float(np.linalg.norm(turn))
    x, y, z = turn / angle if angle > 0.0 else turn
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + math.sin(angle) * k + (1.0 - math.cos(angle)) * (k @ k))


class _Sensor:
    """Three axes of N aircraft: lag, bias, white noise and vibration, in the unit of the settings."""

    def __init__(
        self, settings: Gyro | Accelerometer, count: int, dt: float, rng: np.random.Generator
    ) -> None:
        self._settings = settings
        self._rng = rng
        self._bias = np.zeros((count, 3))
        self._factor: Array | None = None  # of noise and bias, (N, 1); None: as the settings say
        self._amplitude = np.array(settings.vibration)
        self.vibrates = bool(self._amplitude.any())  # whether `measure` needs the rotors' phases
        bandwidth = settings.bandwidth_hz
        # First-order low-pass, exact for an input that stands still over the sample.
        self._follow = None if bandwidth is None else -math.expm1(-2.0 * math.pi * bandwidth * dt)
        self._lagged = np.zeros((count, 3))
        self._fresh = np.ones(count, dtype=np.bool_)  # aircraft whose low-pass starts at its next input

    def reset(self, index: NDArray[np.intp]) -> None:
        """A new episode for the aircraft of `index`: their bias is drawn anew."""
        bias = draw_bias(self._settings, len(index), self._rng)
        self._bias[index] = bias if self._factor is None else bias * self._factor[index]
        self._fresh[index] = True

    def vary(self, factor: Array) -> None:
        """White noise from now on, and bias from the next reset on, `factor` times the settings', (N,)."""
        self._factor = factor[:, None]

    def _read(self, value: Array, phase: Array | None, speed: Array, speed_max: float, which: Which) -> Array:
        if self._follow is not None:
            lagged = np.where(self._fresh[which, None], value, self._lagged[which])
            value = lagged + self._follow * (value - lagged)
            self._lagged[which] = value
            self._fresh[which] = False
        factor = ONE if self._factor is None else self._factor[which]
        reading = measured_rate(value, self._bias[which], self._settings, self._rng, factor)
        if self.vibrates:
            if phase is None:
                raise ValueError("a sensor with vibration needs the rotors' phases, got none")
            reading += rotor_vibration(phase, speed, speed_max, self._amplitude)
        return reading


class GyroModel(_Sensor):
    """The gyros of N aircraft, sampled every `dt` [s]; `reset` before the first `measure`.

    `rng` gives a bias (n, 3) for each reset of n aircraft and noise (N, 3) for each measurement, nothing
    else. Rounding and saturation are the chip's: see `counts`.
    """

    def __init__(self, gyro: Gyro, count: int, dt: float, rng: np.random.Generator) -> None:
        super().__init__(gyro, count, dt, rng)
        # Rows times this matrix: the body's rate in the axes of a chip turned by `misalignment`.
        self._turn = rotation_by(np.array(gyro.misalignment)) if any(gyro.misalignment) else None

    def measure(
        self,
        rate: Array,
        rotor_phase: Array | None,
        rotor_speed: Array,
        speed_max: float,
        which: Which = EVERYONE,
    ) -> Array:
        """Reading of this sample [rad/s], (K, 3), of the true body rate (K, 3) of the aircraft of `which`.

        rotor_phase [rad] and rotor_speed [rad/s], (K, M), only matter to a gyro that vibrates; the phase may
        be None otherwise. Raises ValueError if it is None and needed.
        """
        if self._turn is not None:
            rate = rate @ self._turn
        return self._read(rate, rotor_phase, rotor_speed, speed_max, which)


class AccelerometerModel(_Sensor):
    """The accelerometers of N aircraft, like `GyroModel`; they saturate at full scale."""

    def __init__(self, accelerometer: Accelerometer, count: int, dt: float, rng: np.random.Generator) -> None:
        super().__init__(accelerometer, count, dt, rng)
        self._full_scale = accelerometer.full_scale

    def measure(
        self,
        specific_force: Array,
        rotor_phase: Array | None,
        rotor_speed: Array,
        speed_max: float,
        which: Which = EVERYONE,
    ) -> Array:
        """Reading [m/s^2], (K, 3), of the specific force (K, 3), body axes, as `GyroModel.measure` does."""
        reading = self._read(specific_force, rotor_phase, rotor_speed, speed_max, which)
        return np.clip(reading, -self._full_scale, self._full_scale)
