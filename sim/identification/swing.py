"""The moment of inertia of an aircraft from the gyro's log of its swing on wires.

Hung with its axis vertical through the centre of mass, the aircraft turns to and fro. On a bifilar pendulum
(two parallel wires) gravity turns it back with m g d^2 / (4 L) [N m/rad], on a torsion wire the wire does,
with its stiffness K. The rate is a decaying sinusoid, exp(-c t) cos(w t), and J = K / (w^2 + c^2).

Source of the bifilar formula: J = m g d^2 T^2 / (16 pi^2 L), d between the wires, L their length,
at small angles.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from neuroflight.sim.analysis.confidence import NORMAL
from neuroflight.sim.arrays import Array
from neuroflight.sim.identification.recording import Recording
from neuroflight.toolchain.contract import AXES, GRAVITY
from neuroflight.toolchain.errors import TraceError

PERIODS_MIN = 5.0
SAMPLES_A_PERIOD = 40  # samples are averaged down to this: faster ones hold noise, not swing
PERIOD_MIN_S, PERIOD_MAX_S = 0.05, 30.0
EXPLAINED_MIN = 0.9  # share of the rate's variance that the sinusoid must explain
OTHER_MAX = 0.3  # RMS of another axis, of the swinging one's: more is a wobble, or no vertical axis
AMPLITUDE_MAX = math.radians(15.0)  # the period of a bifilar pendulum grows by 0.43 % at it, J by 0.86 %
DAMPING_MAX = 0.1  # c / w; beyond it drag that grows with the square of the rate would bend the decay
OUTLIER = 3.0  # times the noise: what is further off counts linearly


@dataclass(frozen=True)
class Swing:
    """The decaying sinusoid in a log."""

    axis: int  # of the body, about which it swings
    period_s: float  # of the swing without damping, 2 pi / sqrt(w^2 + c^2)
    period_margin_s: float  # half of its 95 % confidence interval
    damping: float  # c / w
    amplitude: float  # [rad], at the start of the log
    periods: float  # in the log
    explained: float  # share of the variance
    time: Array  # (K,) [s] of averaged samples
    rate: Array  # (K,) [rad/s]
    fitted: Array  # (K,) [rad/s]


@dataclass(frozen=True)
class Moment:
    """A moment of inertia [kg m^2] with half of its 95 % confidence interval."""

    value: float
    margin: float


def find_swing(recording: Recording, name: str, axis: int | None = None) -> Swing:
    """Find the swing of a log; axis: the swinging one, found if None. Raises TraceError without a swing."""
    gyro = recording.gyro - recording.gyro.mean(axis=0)
    spread = gyro.std(axis=0)
    axis = int(np.argmax(spread)) if axis is None else axis
    if recording.gaps:
        raise TraceError(
            f"{name}: samples are missing in {recording.gaps} places, which shifts the swing; log slower, or "
            "cut a part out without gaps"
        )
    if spread[axis] == 0.0:
        raise TraceError(f"{name}: the {AXES[axis]} rate never changes: nothing swings")
    guess_hz, length = _strongest(gyro[:, axis], recording.rate_hz), len(gyro) / recording.rate_hz
    if not 1.0 / PERIOD_MAX_S <= guess_hz <= 1.0 / PERIOD_MIN_S or guess_hz * length < PERIODS_MIN:
        raise TraceError(
            f"{name}: {guess_hz * length:.1f} periods of {1.0 / guess_hz:.3g} s in {length:.3g} s of "
            f"{AXES[axis]}, expected at least {PERIODS_MIN:g} periods of {PERIOD_MIN_S:g} to "
            f"{PERIOD_MAX_S:g} s; log a longer swing"
        )
    every = max(1, int(recording.rate_hz / guess_hz / SAMPLES_A_PERIOD))
    count = len(gyro) // every
    blocks: Array = gyro[: count * every].reshape(count, every, 3).mean(axis=1).astype(np.float64)
    time = (np.arange(count) + 0.5 * (every - 1) / every) * (every / recording.rate_hz)
    swing = _fit(np.asarray(time, np.float64), blocks[:, axis], guess_hz, axis)
    _check(swing, blocks.std(axis=0), name)
    return swing


def bifilar_stiffness(mass: float, distance: float, length: float) -> float:
    """Compute the stiffness [N m/rad] of a bifilar pendulum: `mass` [kg], `length`, `distance` [m]."""
    return mass * GRAVITY * distance**2 / (4.0 * length)


def moment(swing: Swing, stiffness: float, *, bifilar: bool = False) -> Moment:
    """Compute J of a swing on wires of `stiffness` [N m/rad]; bifilar: finite angles add to the margin."""
    value = stiffness * (swing.period_s / (2.0 * math.pi)) ** 2
    relative = 2.0 * swing.period_margin_s / swing.period_s
    if bifilar:  # T grows by the factor 1 + angle^2 / 16, at the start of the log the most
        relative = math.hypot(relative, swing.amplitude**2 / 8.0)
    return Moment(value, value * relative)


def reference_stiffness(swing: Swing, inertia: float) -> tuple[float, float]:
    """Compute the stiffness [N m/rad] of wires from a swing of known `inertia`; its relative margin."""
    stiffness = inertia * (2.0 * math.pi / swing.period_s) ** 2
    return stiffness, 2.0 * swing.period_margin_s / swing.period_s


def _strongest(values: Array, rate_hz: float) -> float:
    """Find the frequency [Hz] of the strongest line of the spectrum, to a quarter of a line's width."""
    padded = 4 * len(values)
    power = np.abs(np.fft.rfft(values * np.hanning(len(values)), padded))
    return float(1 + np.argmax(power[1:])) * rate_hz / padded


def _fit(time: Array, rate: Array, guess_hz: float, axis: int) -> Swing:
    """Fit frequency, damping, both phases and an offset by least squares, outliers held down."""
    turn = 2.0 * math.pi * guess_hz

    def model(p: Array) -> Array:
        decay = np.exp(-p[1] * time)
        found: Array = decay * (p[2] * np.cos(p[0] * time) + p[3] * np.sin(p[0] * time)) + p[4]
        return found

    def slopes(p: Array) -> Array:
        decay = np.exp(-p[1] * time)
        cosine, sine = decay * np.cos(p[0] * time), decay * np.sin(p[0] * time)
        along = time * (p[3] * cosine - p[2] * sine)
        return np.column_stack(
            [along, -time * (p[2] * cosine + p[3] * sine), cosine, sine, np.ones_like(time)]
        )

    columns = np.column_stack([np.cos(turn * time), np.sin(turn * time), np.ones_like(time)])
    start = np.concatenate([[turn, 0.0], np.linalg.lstsq(columns, rate, rcond=None)[0]])
    scale = np.array([1.0 / time[-1], 1.0 / time[-1], rate.std(), rate.std(), rate.std()])
    rough = least_squares(lambda p: model(p) - rate, start, slopes, x_scale=scale)
    noise = 1.4826 * float(np.median(np.abs(rough.fun))) or 1e-12
    best = least_squares(
        lambda p: model(p) - rate, rough.x, slopes, x_scale=scale, loss="soft_l1", f_scale=OUTLIER * noise
    )
    p: Array = best.x
    left = rate - model(p)
    # Neighbouring residuals that go together count as fewer samples.
    together = (
        float(np.clip(np.mean(left[1:] * left[:-1]) / np.mean(left**2), 0.0, 0.99)) if left.any() else 0.0
    )
    variance = float(np.mean(left**2)) * (1.0 + together) / (1.0 - together)
    jacobian = slopes(p)
    covariance = variance * np.linalg.inv(jacobian.T @ jacobian)[:2, :2]
    square = p[0] ** 2 + p[1] ** 2
    period = 2.0 * math.pi / math.sqrt(square)
    gradient = -period / square * p[:2]
    return Swing(
        axis=axis,
        period_s=period,
        period_margin_s=NORMAL * math.sqrt(float(gradient @ covariance @ gradient)),
        damping=float(p[1] / p[0]),
        amplitude=math.hypot(p[2], p[3]) / p[0],
        periods=float(time[-1] * p[0] / (2.0 * math.pi)),
        explained=1.0 - float(left.var() / rate.var()),
        time=time,
        rate=rate,
        fitted=model(p),
    )


def _check(swing: Swing, spread: Array, name: str) -> None:
    """Raise TraceError unless the log shows a free swing about one axis."""
    axis = AXES[swing.axis]
    if swing.explained < EXPLAINED_MIN:
        raise TraceError(
            f"{name}: no swing: a decaying sinusoid explains {100 * swing.explained:.0f} % of the {axis} "
            f"rate, expected at least {100 * EXPLAINED_MIN:g} %; log it hanging freely, after it was let go"
        )
    others = np.delete(spread, swing.axis)
    if others.max() > OTHER_MAX * spread[swing.axis]:
        other = AXES[int(np.argmax(np.where(np.arange(3) == swing.axis, 0.0, spread)))]
        raise TraceError(
            f"{name}: {other} turns with {others.max() / spread[swing.axis]:.2f} of {axis}'s rate, expected "
            f"at most {OTHER_MAX:g}; hang it with the axis vertical, and let it go without a push"
        )
    if swing.amplitude > AMPLITUDE_MAX:
        raise TraceError(
            f"{name}: it swings {math.degrees(swing.amplitude):.0f} degrees, expected at "
            f"most {math.degrees(AMPLITUDE_MAX):g}: the period depends on the angle there; "
            "wait until it swings less"
        )
    if not 0.0 <= swing.damping + 0.01 <= DAMPING_MAX + 0.01:
        raise TraceError(
            f"{name}: the swing grows or is damped too much (c/w {swing.damping:.3f}, expected 0 to "
            f"{DAMPING_MAX:g}); take the propellers off, use thinner wires"
        )
