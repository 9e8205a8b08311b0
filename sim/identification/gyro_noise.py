"""Noise of a gyro and an accelerometer from a recording at rest, for the aircraft file."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from neuroflight.sim.aircraft.edit import Changes, Value
from neuroflight.sim.arrays import Array, Flags
from neuroflight.sim.identification.recording import SAMPLES_MIN, Recording
from neuroflight.toolchain.contract import AXES
from neuroflight.toolchain.errors import TraceError

POINTS_A_DECADE = 12  # of the Allan deviation
GROUPS_MIN = 9  # averages in the longest time: the deviation there is known to about a quarter
FLICKER = math.sqrt(2 * math.log(2) / math.pi)  # Allan deviation over bias instability, where it is flat
SETTLED = 20  # correlation times after which filtered noise averages out like white noise
WHITE_LAG = 0.05  # lag-1 autocorrelation below which noise is called white
FLOOR = 1.25  # the deviation stands this much above white noise at its least: sqrt(2) if a walk ends it
# Motion: over 0.1 to 10 s the reading wanders more than the noise within 0.1 s explains.
MOTION_S = (0.1, 10.0)
MOTION_RATIO = 3.0
MOTION_WANDER = math.radians(0.1)  # [rad/s], Allan deviation; a gyro at rest drifts an order less in 10 s
MOTION_RATE = math.radians(2.0)  # [rad/s], off the mean over 0.1 s
MOTION_NOISE = 8.0  # and this many standard deviations of a mean of white noise


@dataclass(frozen=True, eq=False)
class SensorNoise:
    """Noise of one sensor at rest; arrays are (3,), in the unit of the sensor."""

    mean: Array
    sigma: Array  # standard deviation of a sample, without what rounding in the log adds
    step: Array  # that the log is rounded to; as good as 0 where it is not
    lag: Array  # autocorrelation of neighbouring samples, 0 for white noise
    bandwidth_hz: Array  # of the first-order low-pass that would leave this autocorrelation; NaN for white
    density: Array  # [unit/sqrt(Hz)] of the white part
    instability: Array  # bias instability: the least Allan deviation over `FLICKER`
    instability_s: Array  # [s], averaging time it was found at
    floor: Flags  # False: the record shows no floor, the instability is at most this
    tau: Array  # (K,) averaging times [s]
    deviation: Array  # (K, 3) Allan deviation


@dataclass(frozen=True, eq=False)
class Noise:
    """The figures of a record, gyro in rad/s and accelerometer in m/s^2."""

    rate_hz: float
    samples: int
    gaps: int
    gyro: SensorNoise
    accelerometer: SensorNoise | None
    moved: bool  # the aircraft was not at rest: the figures are no noise

    @property
    def duration(self) -> float:
        """Length of the record [s]."""
        return self.samples / self.rate_hz

    @property
    def bias(self) -> float:
        """Spread of the gyro's bias over episodes [rad/s], estimated from one record: RMS of the three means.

        Each axis is one draw of a zero-mean bias, so the spread of this estimate is 41 %.
        """
        return float(np.sqrt(np.mean(self.gyro.mean**2)))


def allan_deviation(values: Array, rate_hz: float) -> tuple[Array, Array]:
    """Compute the overlapping Allan deviation of even samples (N, 3): times [s] (K,), deviations (K, 3).

    Source: IEEE Std 952, annex C. White noise of density D gives D / sqrt(tau), a constant rate ramp and
    a random walk rise.
    """
    count = len(values)
    longest = max(count // GROUPS_MIN, 1)
    lengths = np.unique(
        np.geomspace(1, longest, math.ceil(POINTS_A_DECADE * math.log10(longest)) + 1).round()
    )
    tau = lengths / rate_hz
    deviation = np.empty((len(tau), values.shape[1]))
    for axis in range(values.shape[1]):
        sums = np.concatenate([[0.0], np.cumsum(values[:, axis] - values[:, axis].mean())])
        for row, length in enumerate(lengths.astype(np.intp)):
            second = sums[2 * length :] - 2.0 * sums[length:-length] + sums[: -2 * length]
            deviation[row, axis] = math.sqrt(float(np.mean(second * second)) / 2.0) / length
    return tau, deviation


def measure_noise(recording: Recording) -> Noise:
    """Compute the figures of a record at rest. Raises TraceError if a gyro axis never changes."""
    for axis, values in zip(AXES, recording.gyro.T, strict=True):
        if (values == values[0]).all():
            raise TraceError(
                f"gyro {axis} reads {np.rad2deg(values[0]):g} deg/s throughout: stuck, or its noise is lost "
                "in the log's rounding; log more digits"
            )
    gyro = _sensor(recording.gyro, recording.rate_hz)
    acceleration = recording.acceleration
    return Noise(
        rate_hz=recording.rate_hz,
        samples=len(recording.gyro),
        gaps=recording.gaps,
        gyro=gyro,
        accelerometer=None if acceleration is None else _sensor(acceleration, recording.rate_hz),
        moved=_moved(recording.gyro, recording.rate_hz, gyro),
    )


def resting_part(recording: Recording) -> tuple[float, float] | None:
    """Return begin and end [s] of the longest part with the aircraft at rest; None if there is none."""
    length = max(1, round(MOTION_S[0] * recording.rate_hz))
    blocks = recording.gyro[: len(recording.gyro) // length * length].reshape(-1, length, 3)
    spread = blocks.std(axis=1).max(axis=1)
    # At rest a gyro's mean is near 0 and its noise is like that of the calmest tenth of the recording.
    calm = (np.abs(blocks.mean(axis=1)) < MOTION_RATE).all(axis=1)
    if not calm.any():
        return None
    calm &= spread < MOTION_RATIO * float(np.quantile(spread[calm], 0.1))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], calm, [False]]).astype(np.int8)))
    first, end = max(zip(edges[::2], edges[1::2], strict=True), key=lambda run: int(run[1] - run[0]))
    part = recording.gyro[first * length : end * length]
    if len(part) < SAMPLES_MIN or (part == part[0]).all(axis=0).any():
        return None
    if _moved(part, recording.rate_hz, _sensor(part, recording.rate_hz)):
        return None
    return float(first * length / recording.rate_hz), float(end * length / recording.rate_hz)


def doubts(noise: Noise) -> list[str]:
    """List reasons to distrust the figures, one sentence each."""
    found = []
    if noise.moved:
        found.append("the aircraft moved: these figures are not noise alone; record it at rest on the ground")
    if noise.gaps:
        found.append(
            f"samples are missing in {noise.gaps} places; they are taken as if they followed at once"
        )
    for axis, sigma, step in zip(AXES, noise.gyro.sigma, noise.gyro.step, strict=True):
        if sigma < step / 2:
            found.append(
                f"{axis}: the log is rounded to {np.rad2deg(step):.3g} deg/s, too coarse for its noise; "
                "log more digits"
            )
    slow = noise.gyro.bandwidth_hz
    if not noise.moved and np.isfinite(slow).any():
        found.append(
            f"samples are not white (neighbours correlate by {_each(noise.gyro.lag, 2)}): they passed a "
            f"low-pass like one of first order at {np.nanmedian(slow):.0f} Hz; if the chip has it, that is "
            "its bandwidth_hz. The twin's noise has this standard deviation but is white"
        )
    if (noise.gyro.lag < -WHITE_LAG).any():
        found.append(
            f"samples alternate (neighbours correlate by {_each(noise.gyro.lag, 2)}): a vibration near half "
            "the sample rate, or a filter in the log"
        )
    return found


def aircraft_keys(noise: Noise) -> Changes:
    """Return the figures as keys of an aircraft file, to four digits."""
    keys: dict[str, dict[str, Value]] = {
        "gyro": {
            "noise_deg_s": tuple(_digits(value) for value in np.rad2deg(noise.gyro.sigma)),
            "bias_deg_s": _digits(math.degrees(noise.bias)),
        }
    }
    if noise.accelerometer is not None:
        keys["accelerometer"] = {"noise_m_s2": tuple(_digits(v) for v in noise.accelerometer.sigma)}
    return keys


def _sensor(values: Array, rate_hz: float) -> SensorNoise:
    mean = values.mean(axis=0)
    away = values - mean
    variance = np.mean(away * away, axis=0)
    step = np.array([np.diff(np.unique(axis)).min(initial=math.inf) for axis in values.T])
    step = np.where(np.isfinite(step), step, 0.0)
    # Rounding adds a uniform, white error of its own (Sheppard's correction).
    rounding = step * step / 12.0
    own = np.where(variance > 2 * rounding, variance - rounding, variance)
    lag = np.clip(np.mean(away[1:] * away[:-1], axis=0) / np.where(own > 0.0, own, 1.0), -1.0, 1.0)
    coloured = lag > np.maximum(WHITE_LAG, 4.0 / math.sqrt(len(values)))
    inside = np.where(coloured, np.minimum(lag, 1.0 - 1e-9), 0.5)
    bandwidth_hz = np.where(coloured, -np.log(inside) * rate_hz / (2 * math.pi), np.nan)
    tau, deviation = allan_deviation(values, rate_hz)
    shortest = np.where(coloured, SETTLED / (2 * math.pi * bandwidth_hz), 1.0 / rate_hz)
    white = np.empty(3)
    for axis in range(3):
        decade = (tau >= 0.999 * shortest[axis]) & (tau <= 10.001 * shortest[axis])
        decade |= tau == tau[np.argmin(np.abs(tau - shortest[axis]))]
        white[axis] = math.sqrt(float(np.mean(deviation[decade, axis] ** 2 * tau[decade])))
    lowest = np.argmin(deviation, axis=0)
    least = deviation[lowest, np.arange(3)]
    return SensorNoise(
        mean=mean,
        sigma=np.sqrt(own),
        step=step,
        lag=lag,
        bandwidth_hz=bandwidth_hz,
        density=white,
        instability=least / FLICKER,
        instability_s=tau[lowest],
        floor=(least > FLOOR * white / np.sqrt(tau[lowest])) & (lowest < len(tau) - 1),
        tau=tau,
        deviation=deviation,
    )


def _moved(rate: Array, rate_hz: float, gyro: SensorNoise) -> bool:
    """Return True if the aircraft turned while it was recorded."""
    length = max(1, round(MOTION_S[0] * rate_hz))
    blocks = rate[: len(rate) // length * length].reshape(-1, length, 3).mean(axis=1)
    usual = np.maximum(MOTION_RATE, MOTION_NOISE * gyro.sigma / math.sqrt(length))
    if (np.abs(blocks - np.median(blocks, axis=0)) > usual).any():
        return True
    within = (gyro.tau >= MOTION_S[0] / 5) & (gyro.tau <= MOTION_S[0])
    after = (gyro.tau > MOTION_S[0]) & (gyro.tau <= MOTION_S[1])
    if not (within.any() and after.any()):
        return False
    level = np.sqrt(np.mean(gyro.deviation[within] ** 2 * gyro.tau[within, None], axis=0))
    wander = gyro.deviation[after]
    return bool(
        ((wander > MOTION_WANDER) & (wander * gyro.tau[after, None] ** 0.5 > MOTION_RATIO * level)).any()
    )


def _digits(value: float) -> float:
    return float(f"{value:.4g}")


def _each(values: Array, digits: int) -> str:
    return " / ".join(f"{value:.{digits}f}" for value in values)
