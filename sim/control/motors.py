"""From controller outputs to motor commands: throttle mix, idle, DShot values. Pure and vectorised.

float32 in the firmware's order of operations.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.arrays import Array, Array32
from neuroflight.toolchain.contract import DSHOT_MAX, DSHOT_MIN, DSHOT_SPAN, DSHOT_STOP, DshotCommand, Mix
from neuroflight.toolchain.errors import LinkError


def throttle_mix(y: Array32, throttle: Array32, mix: Mix = Mix.ATTITUDE_FIRST) -> Array32:
    """Compute motor fractions (N, M) of outputs y (N, M) and the pilot's thrust (N,), all 0..1; see Mix."""
    if mix is Mix.ATTITUDE_FIRST:
        lift = throttle * (np.float32(1.0) - y.max(axis=1))
        return _within(y + lift[:, None])
    total = y[:, 0]
    for motor in range(1, y.shape[1]):
        total = total + y[:, motor]
    u = throttle[:, None] + (y - (total / np.float32(y.shape[1]))[:, None])
    low, high = u.min(axis=1), u.max(axis=1)
    nothing = np.float32(0.0)
    shift = np.where(low < nothing, -low, np.where(high > 1.0, np.float32(1.0) - high, nothing))
    return _within(u + shift[:, None])


def _within(u: Array32) -> Array32:
    """Limit to 0..1, which rounding may exceed a little."""
    return np.minimum(np.maximum(u, np.float32(0.0)), np.float32(1.0))


def raised(u: Array32, idle: float) -> Array32:
    """Raise fractions u in 0..1 above the idle (0..1), any shape."""
    floor = np.float32(idle)
    above: Array32 = floor + (np.float32(1.0) - floor) * u
    return above


def dshot_values(u: Array32, idle: float) -> NDArray[np.uint16]:
    """Compute DShot throttle values (N, M), 48..2047, of fractions u in 0..1 above the idle (0..1)."""
    scaled = np.float32(DSHOT_SPAN) * raised(u, idle) + np.float32(0.5)
    return np.uint16(DSHOT_MIN) + scaled.astype(np.uint16)


_THROTTLES = np.full(DSHOT_MAX + 2, np.nan)  # the fraction of each DShot value; the last is of all above
_THROTTLES[[DSHOT_STOP, DshotCommand.EXTENDED_TELEMETRY]] = 0.0
_THROTTLES[DSHOT_MIN:-1] = np.arange(DSHOT_SPAN + 1) / DSHOT_SPAN
_EACH = {value: fraction for value, fraction in enumerate(_THROTTLES.tolist()) if fraction == fraction}


def motor_fractions(dshot: NDArray[np.uint16]) -> Array:
    """Compute the motor fractions 0..1 that an ESC decodes: 0 for 0, otherwise (v - 48) / 1999.

    dshot: 11-bit values, any shape. Raises LinkError on a value that is no throttle; the command that ESCs
    are asked by what they measure, which a firmware sends by itself before arming, leaves a motor standing.
    """
    fractions = _THROTTLES.take(dshot, mode="clip")
    if fractions.size and np.isnan(fractions.min()):
        raise LinkError(
            f"DShot value {dshot[np.isnan(fractions)][0]} is no throttle, expected {DSHOT_STOP} "
            f"or {DSHOT_MIN} to {DSHOT_MAX}: the firmware is broken"
        )
    return fractions


def each_fraction(dshot: NDArray[np.uint16]) -> list[float]:
    """Compute `motor_fractions` of the few values (M,) of one aircraft, faster. Raises LinkError like it."""
    try:
        return [_EACH[value] for value in dshot.tolist()]
    except KeyError:
        fractions: list[float] = motor_fractions(dshot).tolist()  # raises the error
        return fractions


def motor_commands(y: Array32, throttle: Array32, idle: float, mix: Mix = Mix.ATTITUDE_FIRST) -> Array:
    """Compute motor fractions (N, M) that ESCs decode, of outputs y (N, M) under the pilot's thrust (N,)."""
    return motor_fractions(dshot_values(throttle_mix(y, throttle, mix), idle))
