"""Figures of a manoeuvre: errors, overshoot behind each change of a command, stray, the hover behind it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuroflight.sim.analysis.holding import SETTLED_S
from neuroflight.sim.analysis.metrics import CHANGE_S, tracking
from neuroflight.sim.arrays import Array
from neuroflight.sim.flight.trace import Trace

SHAKE_HZ = (20.0, 80.0)  # of prop wash on a 5-inch: the controller suppresses slower motion, the mass faster
STEP_MIN_DEG_S = 20.0  # a smaller change of a command has no overshoot to speak of


@dataclass(frozen=True)
class ManoeuvreFigures:
    """Figures of one flight, without the hovers before and behind it; errors are against the true rate."""

    mae: float  # [deg/s], mean of the axes
    mse: float  # [(deg/s)^2], likewise
    overshoot: float  # [%] of the largest relative step past a command, of commanded axes
    stray: float  # [deg/s], mean |rate| of the axes that are never commanded
    stray_peak: float  # [deg/s], and the largest
    thrust: float  # mean over weight
    change: float  # mean |change| of a motor's fraction in 1 ms
    rest: float  # [deg/s], mean |rate| of the axes in the hover behind, from SETTLED_S on
    rest_worst: float  # [deg/s], of the axis with the most
    drift: float  # [deg], turned in that time about the axis with the most
    shake: float  # [deg/s], root mean square of the errors between SHAKE_HZ, of all axes


def manoeuvre_figures(
    trace: Trace, thrust: Array, commanded: tuple[bool, bool, bool], settle_s: float, hover_s: float
) -> ManoeuvreFigures:
    """Compute the figures of a flight from `settle_s` [s] on, whose last `hover_s` are a hover.

    thrust: of all rotors over weight at each row of the trace, (N,). commanded: axes that have a command at
    some time, and not all of them. Raises ValueError if nothing is left of the flight, or of the hover.
    """
    step_s = 1.0 / trace.control_rate_hz
    begin = round(settle_s * trace.control_rate_hz)
    end = len(trace.t) - round(hover_s * trace.control_rate_hz)
    if begin >= end or hover_s <= SETTLED_S:
        raise ValueError(
            f"a flight of {len(trace.t)} rows, {begin} of them before the figures, {len(trace.t) - end} of "
            f"them a hover"
        )
    flown = slice(begin, end)
    setpoint, rate = np.rad2deg(trace.setpoint[flown].astype(np.float64)), np.rad2deg(trace.rate[flown])
    errors = tracking(trace.setpoint[flown], trace.rate[flown], step_s)
    still = np.rad2deg(trace.rate[end + round(SETTLED_S / step_s) :], dtype=np.float64)
    rests = np.abs(still).mean(axis=0)
    axes = np.array(commanded)
    alone = np.abs(rate[:, ~axes])
    stride = max(1, round(CHANGE_S / step_s))
    return ManoeuvreFigures(
        mae=float(errors.mae.mean()),
        mse=float(errors.mse.mean()),
        overshoot=max(
            (overshoot(setpoint[:, axis], rate[:, axis]) for axis in np.flatnonzero(axes)), default=0.0
        ),
        stray=float(alone.mean()),
        stray_peak=float(alone.max()),
        thrust=float(thrust[flown].mean()),
        change=float(np.abs(np.diff(trace.motors[begin:end:stride], axis=0)).mean()),
        rest=float(rests.mean()),
        rest_worst=float(rests.max()),
        drift=float(np.abs(still.sum(axis=0) * step_s).max()),
        shake=shake(rate - setpoint, step_s),
    )


def shake(error: Array, step_s: float) -> float:
    """Compute the root mean square of errors (T, 3) between SHAKE_HZ, of all axes."""
    parts = np.fft.rfft(error - error.mean(axis=0), axis=0)
    frequency = np.fft.rfftfreq(len(error), step_s)
    inside = (frequency >= SHAKE_HZ[0]) & (frequency <= SHAKE_HZ[1])
    power = 2.0 * (np.abs(parts[inside]) ** 2).sum(axis=0) / len(error) ** 2
    return float(np.sqrt(power.mean()))


def overshoot(setpoint: Array, rate: Array) -> float:
    """Return the largest overshoot of a rate (T,) past the jumps of a setpoint (T,), in % of the jump.

    A jump counts until the next one. Jumps below STEP_MIN_DEG_S [deg/s] do not count.
    """
    jumps = np.flatnonzero(np.abs(np.diff(setpoint)) >= STEP_MIN_DEG_S) + 1
    most = 0.0
    for begin, end in zip(jumps, [*jumps[1:], len(setpoint)], strict=True):
        step = setpoint[begin] - setpoint[begin - 1]
        past = (rate[begin:end] - setpoint[begin]) * np.sign(step)
        most = max(most, float(100.0 * past.max() / abs(step)))
    return most
