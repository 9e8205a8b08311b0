"""The pilot's thrust in episodes in which it changes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

HOLD_LEAST_S, HOLD_MEAN_S = 0.05, 0.3  # between changes, exponentially distributed beyond the least
RAMP_S = 0.3  # longest time that a change takes; a pilot's hand needs 50 ms and more
CLOSED_SHARE = 0.2  # of the changes, which close the throttle


def moving_throttle(
    start: NDArray[np.float32], highest: float, steps: int, rate_hz: int, rng: np.random.Generator
) -> NDArray[np.float32]:
    """Draw the throttle 0..1 at each control step (N, steps) that begins at `start` (N,).

    It stays for a random time, then goes to a random value between 0 and `highest` along a ramp, and so on.
    """
    count = len(start)
    changes = 1 + int(steps / rate_hz / HOLD_LEAST_S)
    holds = HOLD_LEAST_S + rng.exponential(HOLD_MEAN_S - HOLD_LEAST_S, (count, changes))
    ramps = rng.uniform(0.0, RAMP_S, (count, changes))
    targets = rng.uniform(0.0, highest, (count, changes))
    targets[rng.random((count, changes)) < CLOSED_SHARE] = 0.0
    now = np.arange(steps) / rate_hz
    throttle = np.empty((count, steps), np.float32)
    for row, begin, hold, ramp, target in zip(throttle, start, holds, ramps, targets, strict=True):
        ends = np.cumsum(hold + ramp)
        times = np.stack([ends - ramp, ends], axis=1).ravel()
        places = np.repeat(np.concatenate([[begin], target]), 2)[1:-1]
        row[:] = np.interp(now, times, places)
    return throttle
