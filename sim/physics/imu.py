"""Models of gyro and accelerometer of N aircraft, computed by sensor.c; the 16-bit counts of a gyro chip.

A reading is the true value turned to the chip, lagged by its low-pass, plus the constant of the episode,
white noise and vibration from the rotors. Effects that the aircraft file leaves out are skipped.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.aircraft.mass import Vector
from neuroflight.sim.aircraft.model import Accelerometer, Gyro
from neuroflight.sim.arrays import Array, Array32, Indices
from neuroflight.sim.physics.library import assign, library, pointer, random_source, struct
from neuroflight.toolchain.contract import GYRO_COUNTS, GYRO_FULL_SCALE_DEG_S

# Where vibration is drawn and the aircraft's file has none: the axes over the worst one as logs of a racer
# have them (docs/reference/aircraft.md); 2 and 3 times the turns over the turns are assumed: three blades.
VIBRATION_AXES, VIBRATION_HARMONICS = (1.0, 1.0, 0.5), (0.1, 0.4)
RATE_PER_COUNT = np.float32(np.deg2rad(GYRO_FULL_SCALE_DEG_S / GYRO_COUNTS))  # [rad/s], the firmware's


def draw_bias(noise: Gyro | Accelerometer, count: int, rng: np.random.Generator) -> Array:
    """Draw the offset of each aircraft's sensor for one episode, in its unit, (count, 3)."""
    return rng.normal(0.0, noise.bias, (count, 3))


def counts(rate: Array) -> NDArray[np.int16]:
    """Convert a rate [rad/s] to 16-bit counts at +-2000 deg/s: half to even, saturated."""
    scaled = np.rint(np.rad2deg(rate) * (GYRO_COUNTS / GYRO_FULL_SCALE_DEG_S))
    return np.minimum(np.maximum(scaled, -GYRO_COUNTS), GYRO_COUNTS - 1).astype(np.int16)


def quantised_rate(rate: Array) -> Array32:
    """Compute a rate [rad/s] after the chip and the firmware's conversion back, float32."""
    return counts(rate).astype(np.float32) * RATE_PER_COUNT


def rotation_by(turn: Array) -> Array:
    """Compute the rotation (3, 3) about the axis and by the length of `turn` [rad] (Rodrigues)."""
    angle = float(np.linalg.norm(turn))
    x, y, z = turn / angle if angle > 0.0 else turn
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + math.sin(angle) * k + (1.0 - math.cos(angle)) * (k @ k))


def vibration_axes(gyro: Gyro) -> tuple[Vector, tuple[float, ...]]:
    """Return a gyro's vibration on each axis over that on its worst one, and its multiples."""
    worst = max(gyro.vibration)
    if worst == 0.0:
        return VIBRATION_AXES, VIBRATION_HARMONICS
    x, y, z = (axis / worst for axis in gyro.vibration)
    return (x, y, z), gyro.harmonics


class _Sensor:
    """Three axes of N aircraft: lag, bias, white noise and vibration, in the unit of the settings."""

    def __init__(
        self,
        settings: Gyro | Accelerometer,
        count: int,
        dt: float,
        rng: np.random.Generator,
        speed_max: float,
        **more: object,
    ) -> None:
        """speed_max: of a rotor [rad/s], where it vibrates as set; more: members of C's struct."""
        self._settings = settings
        self._rng = rng
        self._factor = np.ones(count)  # of noise and bias
        self._bias = np.zeros((count, 3))
        self._lagged = np.zeros((count, 3))
        self._fresh = np.ones(count, dtype=np.bool_)  # aircraft whose low-pass starts at its next input
        self._draws = np.zeros((count, 3))
        self._shake = np.full(count, max(settings.vibration))
        bandwidth = settings.bandwidth_hz
        self.state = struct(
            "sensor",
            random=random_source(rng),
            noise=settings.noise,
            vibrates=any(settings.vibration),
            shake=self._shake,
            speed_max=speed_max,
            lags=bandwidth is not None,
            # First-order low-pass, exact for an input that stands still over the sample.
            follow=0.0 if bandwidth is None else -math.expm1(-2.0 * math.pi * bandwidth * dt),
            factor=self._factor,
            bias=self._bias,
            lagged=self._lagged,
            fresh=self._fresh,
            draws=self._draws,
        )
        assign(self.state, **more)

    @property
    def vibrates(self) -> bool:
        """True if `measure` needs the rotors' phases."""
        return bool(self.state.vibrates)

    def reset(self, index: Indices) -> None:
        """Start a new episode for the aircraft of `index`: draw a new bias."""
        bias = draw_bias(self._settings, len(index), self._rng)
        self._bias[index] = bias * self._factor[index, None]
        self._fresh[index] = True

    def vary(self, factor: Array) -> None:
        """Scale white noise from now on, and bias from the next reset on, by `factor` (N,)."""
        self._factor[:] = factor

    def measure(self, value: Array, rotor_phase: Array | None, rotor_speed: Array) -> Array:
        """Return the reading of this sample, (N, 3), of the true value (N, 3) in body axes.

        rotor_phase [rad] and rotor_speed [rad/s], (N, M), only matter to a sensor that vibrates; the phase
        may be None otherwise. Raises ValueError if it is None and needed.
        """
        if self.vibrates and rotor_phase is None:
            raise ValueError("a sensor with vibration needs the rotors' phases, got none")
        given = [np.ascontiguousarray(rows, np.float64) for rows in (value, rotor_speed)]
        phase = library().ffi.NULL if rotor_phase is None else pointer(np.ascontiguousarray(rotor_phase))
        reading = np.empty_like(given[0])
        everyone: Any = library().ffi.NULL
        library().lib.sensor_read(
            self.state,
            len(reading),
            everyone,
            pointer(given[0]),
            given[1].shape[1],
            phase,
            pointer(given[1]),
            pointer(reading),
        )
        return reading


class GyroModel(_Sensor):
    """The gyros of N aircraft, sampled every `dt` [s]; `reset` before the first `measure`. In rad/s.

    `rng` gives a bias (n, 3) for each reset of n aircraft and noise (N, 3) for each measurement, nothing
    else. Rounding and saturation are the chip's: see `counts`.
    """

    def __init__(self, gyro: Gyro, count: int, dt: float, rng: np.random.Generator, speed_max: float) -> None:
        # Rows times this matrix: the body's rate in the axes of a chip turned by `misalignment`.
        turn = rotation_by(np.array(gyro.misalignment)).ravel().tolist()
        amplitude, harmonics = vibration_axes(gyro)
        more = {"turned": any(gyro.misalignment), "turn": turn, "harmonics": harmonics}
        super().__init__(gyro, count, dt, rng, speed_max, amplitude=amplitude, **more)

    def shake(self, vibration: Array) -> None:
        """Vibrate from now on by `vibration` (N,) [rad/s] on the worst axis; NaN: as the file says."""
        self._shake[:] = np.where(np.isnan(vibration), max(self._settings.vibration), vibration)
        self.state.vibrates = self.vibrates or not np.isnan(vibration).all()


class AccelerometerModel(_Sensor):
    """The accelerometers of N aircraft, like `GyroModel`, in m/s^2; they saturate at full scale."""

    def __init__(
        self,
        accelerometer: Accelerometer,
        count: int,
        dt: float,
        rng: np.random.Generator,
        speed_max: float,
    ) -> None:
        full_scale = accelerometer.full_scale
        worst = max(accelerometer.vibration)
        amplitude = [axis / worst for axis in accelerometer.vibration] if worst else accelerometer.vibration
        more = {"saturates": True, "full_scale": full_scale, "amplitude": amplitude}
        super().__init__(accelerometer, count, dt, rng, speed_max, **more)
