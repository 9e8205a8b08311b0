"""Oscillation of motors: change in a millisecond, amplitude and frequency. Pure functions."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from neuroflight.sim.analysis.metrics import CHANGE_S

SWING_HZ = (20.0, 200.0)  # above: no rotor follows; below: the response to the command itself


def swing(motors: ArrayLike, step_s: float) -> tuple[float, float]:
    """Return amplitude and main frequency [Hz] of motors (T, M) between 20 and 200 Hz.

    The amplitude is that of a sine with the power of this band, mean over the motors; a Hann window keeps
    what is slower out of it.
    """
    values = np.asarray(motors, np.float64)
    window = np.hanning(len(values))[:, None]
    spectrum = np.abs(np.fft.rfft((values - values.mean(axis=0)) * window, axis=0)) ** 2
    frequency = np.fft.rfftfreq(len(values), step_s)
    inside = (frequency >= SWING_HZ[0]) & (frequency <= SWING_HZ[1])
    power = 2.0 * spectrum[inside].mean(axis=1) / (len(values) * float((window**2).sum()))
    return float(np.sqrt(2.0 * power.sum())), float(frequency[inside][power.argmax()])


def change(motors: ArrayLike, step_s: float) -> float:
    """Compute the mean |change| of a motor's fraction in 1 ms, of motors (T, M)."""
    samples = np.asarray(motors)[:: max(1, round(CHANGE_S / step_s))]
    return float(np.abs(np.diff(samples, axis=0)).mean(dtype=np.float64))
