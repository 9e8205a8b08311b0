"""The gyro filter `mean`: controllers see the mean of the gyro's samples of a control period.

The gyro runs faster than the controllers: the NF1's four times. One sample in four has twice the noise of
the mean of four, which comes three eighths of a control period late. float32, as filters.c.
"""

from __future__ import annotations

import numpy as np

from neuroflight.sim.arrays import Array32, Which
from neuroflight.toolchain.contract import GYRO_RATE_DEFAULT_HZ


def samples_per_step(gyro_mean: bool, control_rate_hz: int) -> int:
    """Return the gyro samples in a control period of a batch: as many as the mean takes, otherwise one."""
    return max(1, GYRO_RATE_DEFAULT_HZ // control_rate_hz) if gyro_mean else 1


class GyroMean:
    """The last samples of N gyros."""

    def __init__(self, count: int, samples: int) -> None:
        """Keep `samples`, 1 or more, for a mean."""
        self._last = np.zeros((samples, count, 3), np.float32)  # the oldest first
        self._share = np.float32(1.0 / samples)
        self._fresh = np.ones(count, bool)

    def reset(self, index: Which) -> None:
        """Let the next sample of the aircraft of `index` be their first, as if it had been there before."""
        self._fresh[index] = True

    def add(self, rate: Array32, which: Which = slice(None)) -> None:
        """Add a sample (K, 3) [rad/s] of the gyros of `which`."""
        last = self._last[:, which]
        last[:-1] = last[1:]
        last[-1] = rate
        fresh = self._fresh[which]
        if fresh.any():
            last[:, fresh] = rate[fresh]
            self._fresh[which] = False
        self._last[:, which] = last

    def mean(self, which: Which = slice(None)) -> Array32:
        """Compute the mean (K, 3) [rad/s] of the gyros of `which`."""
        total = self._last[0, which]
        for sample in self._last[1:]:
            total = total + sample[which]
        mean: Array32 = total * self._share
        return mean
