"""Rotor speed from a counter of blades that pass an optical sensor."""

from __future__ import annotations

import math

import numpy as np

from neuroflight.sim.arrays import Array
from neuroflight.toolchain.errors import DynoError

BLADES_MIN, BLADES_MAX = 1, 12  # pulses a revolution: blades, or the marks on a motor's bell


def unwrapped(counts: Array, modulus: float) -> Array:
    """Unwrap counts that restarted at `modulus` into one rising row, (N,). Raises DynoError on one set back.

    A step of more than half the modulus is one back: the counter was set anew.
    """
    steps = np.diff(counts)
    steps = np.where(steps < 0, steps + modulus, steps)
    if (steps < 0).any() or (steps > modulus / 2).any():
        row = int(np.argmax((steps < 0) | (steps > modulus / 2)))
        raise DynoError(
            f"a counter went from {counts[row]:g} to {counts[row + 1]:g}, expected it to rise; did the "
            f"sensor start anew?"
        )
    return np.concatenate([counts[:1], counts[0] + np.cumsum(steps)])


def speed_of_pulses(time: Array, edges: Array, counts: Array, blades: int, window_s: float) -> Array:
    """Compute the rotor speed [rad/s] at `time` [s], (N,), as the mean over a window around it.

    edges: when a count was reached [s], (E,), not falling; counts: (E,), the pulses up to then. Where the
    sensor stamps its pulses, the speed is exact between them; where only the count is known, an edge is the
    row that shows it first, and the speed is uncertain by some row / window_s. Of an oscilloscope's trace the
    counts are 0, 1, 2 ... The window is symmetric, so that nothing is delayed.
    """
    new = np.concatenate([[True], np.diff(counts) > 0])
    at, reached = edges[new], counts[new]
    after = np.interp(time + window_s / 2, at, reached)
    before = np.interp(time - window_s / 2, at, reached)
    speed: Array = (after - before) / window_s * (2 * math.pi / blades)
    return speed
