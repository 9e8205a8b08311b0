"""The policy's input as the firmware computes it, for N aircraft at once.

Blocks and their meaning are `toolchain.contract.OBSERVATION_BLOCKS`; values are float32.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from toolchain.contract import RATE_ERROR_INTEGRAL_LIMIT_RAD, ObservationBlock, observation_count

Array = NDArray[np.float32]


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
