"""Figures of a flight: tracking errors and control effort. Pure functions.

Errors are setpoint - rate in deg/s. The sums IAE, ISE, ITAE and ITSE follow Koch 2019, chapter 5: over
1 ms samples, divided by the seconds of the episode, so that IAE = 1000 MAE and ISE = 1000 MSE; t in ITAE
and ITSE is [s] from the beginning of the episode.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike

from neuroflight.sim.analysis.response import ResponseFigures, hold, response_figures
from neuroflight.sim.analysis.spectrum import components, smoothness
from neuroflight.sim.arrays import Array
from neuroflight.sim.flight.trace import Trace
from neuroflight.toolchain.contract import IDLE_DEFAULT, Mix

SAMPLES_PER_S = 1000.0  # the 1 ms samples of the sums
CHANGE_S = 0.001  # the time over which |delta u| is taken


@dataclass(frozen=True)
class Tracking:
    """Errors per axis, each of shape (..., 3): roll, pitch, yaw."""

    mae: Array  # [deg/s]
    mse: Array  # [(deg/s)^2]
    iae: Array
    ise: Array
    itae: Array
    itse: Array

    def mean(self) -> Tracking:
        """Average over all leading axes (episodes), shape (3,)."""
        return Tracking(*(getattr(self, field.name).reshape(-1, 3).mean(axis=0) for field in fields(self)))


@dataclass(frozen=True)
class Effort:
    """The controller's outputs, before the throttle mix; or motor fractions where that cannot be undone."""

    output: float  # mean control output, fraction 0..1
    change: float  # mean |y_t - y_(t-1)| over motors and 1 ms steps


@dataclass(frozen=True)
class FlightFigures:
    """All figures of one flight, averaged over its episodes."""

    tracking: Tracking  # against the true rate
    gyro_mae: Array  # (3,) [deg/s], against what the controller measured
    effort: Effort
    smoothness: float  # Sm, see sim.analysis.spectrum; mean over the episodes
    response: ResponseFigures | None  # None where no command is held for a second


def tracking(setpoint: ArrayLike, rate: ArrayLike, step_s: float) -> Tracking:
    """Compute errors over time.

    setpoint, rate: [rad/s], shape (..., T, 3), rows `step_s` [s] apart. Raises ValueError on other shapes.
    """
    wanted, flown = np.asarray(setpoint, np.float64), np.asarray(rate, np.float64)
    if wanted.shape != flown.shape or wanted.ndim < 2 or wanted.shape[-1] != 3 or not wanted.shape[-2]:
        raise ValueError(f"setpoint {wanted.shape} and rate {flown.shape}: expected equal (..., T, 3), T > 0")
    error = np.abs(np.rad2deg(wanted - flown))
    square = error * error
    t = (np.arange(error.shape[-2]) * step_s)[:, None]
    return Tracking(
        mae=error.mean(axis=-2),
        mse=square.mean(axis=-2),
        iae=SAMPLES_PER_S * error.mean(axis=-2),
        ise=SAMPLES_PER_S * square.mean(axis=-2),
        itae=SAMPLES_PER_S * (t * error).mean(axis=-2),
        itse=SAMPLES_PER_S * (t * square).mean(axis=-2),
    )


def controller_output(
    motors: ArrayLike,
    throttle: ArrayLike,
    idle: float = IDLE_DEFAULT,
    mix: Mix | None = Mix.ATTITUDE_FIRST,
) -> Array:
    """Compute the controller's y (..., T, M) from motor fractions u', by undoing idle and throttle mix.

    u' = idle + (1 - idle) u and u_i = T (1 - max y) + y_i, so max u = T + (1 - T) max y, from which max y
    and then y follow. At full throttle the mix keeps only differences: max y is then taken as max u.
    motors: (..., T, M) fractions; throttle: (..., T), 0..1. mix: None is another rule than ours. That and
    the centred mix cannot be undone, the latter as it takes the outputs' mean away: these give u.
    """
    u = (np.asarray(motors, np.float64) - idle) / (1.0 - idle)
    if mix is not Mix.ATTITUDE_FIRST:
        return u.clip(0.0, 1.0)
    thrust = np.asarray(throttle, np.float64)[..., None]
    top = u.max(axis=-1, keepdims=True)
    room = 1.0 - thrust
    highest = np.where(room > 0, (top - thrust) / np.where(room > 0, room, 1.0), top).clip(0.0, 1.0)
    y: Array = u - thrust * (1.0 - highest)
    return y.clip(0.0, 1.0)


def effort(output: ArrayLike, step_s: float) -> Effort:
    """Compute mean output and mean change over 1 ms of outputs y (..., T, M), rows `step_s` [s] apart."""
    y = np.asarray(output, np.float64)
    stride = max(1, round(CHANGE_S / step_s))
    samples = y[..., ::stride, :]
    changes = np.abs(np.diff(samples, axis=-2))
    return Effort(output=float(y.mean()), change=float(changes.mean()) if changes.size else 0.0)


def figures(
    trace: Trace,
    episodes: int = 1,
    idle: float = IDLE_DEFAULT,
    mix: Mix | None = Mix.ATTITUDE_FIRST,
) -> FlightFigures:
    """Compute the figures of a flight of `episodes` equal episodes; mix: see `controller_output`.

    Raises ValueError if its rows do not divide.
    """
    steps = len(trace.t)
    if episodes < 1 or steps % episodes:
        raise ValueError(f"{steps} rows do not divide into {episodes} equal episodes")
    step_s = trace.step_s or CHANGE_S
    setpoint, rate, gyro = (
        array.reshape(episodes, -1, 3) for array in (trace.setpoint, trace.rate, trace.gyro)
    )
    held = hold(setpoint, rate, step_s)
    output = controller_output(trace.motors, trace.throttle, idle, mix)
    parts = components(output.reshape(episodes, -1, output.shape[1]), step_s)
    return FlightFigures(
        tracking=tracking(setpoint, rate, step_s).mean(),
        gyro_mae=tracking(setpoint, gyro, step_s).mae.mean(axis=0),
        effort=effort(output, step_s),
        smoothness=float(smoothness(parts).mean()),
        response=response_figures(held) if held else None,
    )
