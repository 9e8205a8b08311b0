"""The policy's input as the firmware computes it, for N aircraft at once.

Blocks and their meaning are `toolchain.contract.OBSERVATION_BLOCKS`; values are float32.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from toolchain.contract import (
    GYRO_FULL_SCALE_DEG_S,
    RATE_ERROR_INTEGRAL_LIMIT_RAD,
    RATE_FULL_STICK_DEG_S,
    ObservationBlock,
    observation_count,
)

Array = NDArray[np.float32]

_RATE_MAX = math.radians(GYRO_FULL_SCALE_DEG_S)
_ERROR_MAX = math.radians(RATE_FULL_STICK_DEG_S) + _RATE_MAX
_LIMITS = {
    "rate": (-_RATE_MAX, _RATE_MAX),
    "rate_error": (-_ERROR_MAX, _ERROR_MAX),
    "rate_error_delta": (-2 * _ERROR_MAX, 2 * _ERROR_MAX),
    "rate_error_integral": (-RATE_ERROR_INTEGRAL_LIMIT_RAD, RATE_ERROR_INTEGRAL_LIMIT_RAD),
    "previous_action": (0.0, 1.0),
    "throttle": (0.0, 1.0),
}


def limits(blocks: tuple[ObservationBlock, ...], motors: int) -> tuple[Array, Array]:
    """Least and greatest value of each observation, (n,) each, raw units: gyro and sticks at their ends."""
    pairs = [_LIMITS[block.name] for block in blocks for _ in range(block.count(motors))]
    low, high = np.array(pairs, np.float32).T
    return low, high


class Observer:
    """Builds observations (N, n) step by step; holds what blocks with memory need."""

    def __init__(
        self, blocks: tuple[ObservationBlock, ...], count: int, motors: int, control_rate_hz: int
    ) -> None:
        self._names = tuple(block.name for block in blocks)
        self._dt = np.float32(1.0 / control_rate_hz)
        self.width = observation_count(blocks, motors)
        self._error = np.zeros((count, 3), np.float32)
        self._integral = np.zeros((count, 3), np.float32)
        self._fresh = np.ones(count, bool)

    def reset(self, index: NDArray[np.intp]) -> None:
        """Forget the past of the aircraft of `index`, as arming does: their next delta is zero."""
        self._fresh[index] = True
        self._integral[index] = 0.0

    def observe(
        self,
        which: NDArray[np.intp] | slice,
        setpoint: Array,
        rate: Array,
        previous_action: Array,
        throttle: Array,
    ) -> Array:
        """Observation (K, n) of this control step for the K aircraft of `which`, raw units.

        setpoint, rate: (K, 3) [rad/s]; previous_action: (K, M); throttle: (K,). Call once a step.
        """
        error = setpoint - rate
        delta = np.where(self._fresh[which, None], np.float32(0.0), error - self._error[which])
        limit = np.float32(RATE_ERROR_INTEGRAL_LIMIT_RAD)
        integral = np.clip(self._integral[which] + error * self._dt, -limit, limit)
        self._error[which] = error
        self._integral[which] = integral
        self._fresh[which] = False
        blocks = {
            "rate": rate,
            "rate_error": error,
            "rate_error_delta": delta,
            "rate_error_integral": integral,
            "previous_action": previous_action,
            "throttle": throttle[:, None],
        }
        return np.concatenate([blocks[name] for name in self._names], axis=1)
