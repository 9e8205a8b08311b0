"""The noise of a residual: its density over frequency, and the filter that makes it white.

What the equations leave is gyro noise, which is white, gusts and wash, which grow towards low
frequencies, and lines of vibration. Its density is estimated from windows of the residual itself. The filter
is the causal one of that density (its minimum phase, by the cepstrum): with it, least squares are the
prediction error method, which a controller that answers to the noise does not bias. Source: Ljung,
System Identification, chapters 8 and 13; Oppenheim and Schafer, Discrete-Time Signal Processing,
chapter 13, from memory.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import fft
from scipy.signal import lfilter

from neuroflight.sim.arrays import Array, Flags

WINDOW_S = 4.0
WINDOWS_MIN = 6  # shorter windows are taken where there are fewer
MEMORY_S = 2.0  # of the whitening filter
FLOOR = 1e-13  # of the largest density


def density(residuals: Sequence[Array], used: Sequence[Flags], step: float) -> tuple[Array, Array]:
    """Estimate the density of a residual's pieces (N,) over frequency; white noise's is its variance.

    used: rows (N,) that count. Robust to bursts: windows far louder than the usual count less. Returns
    frequencies (F,) [Hz] from 0 and densities (F,).
    """
    longest = max(len(residual) for residual in residuals)
    rows = sum(int(flags.sum()) for flags in used)
    length = min(WINDOW_S / step, longest, 2 * rows / (WINDOWS_MIN + 1))
    while True:
        size = fft.next_fast_len(max(16, int(length)), real=True)
        power = _windows(residuals, used, size)
        if len(power) >= WINDOWS_MIN or size < 0.3 / step:
            break
        length = 0.7 * size
    if not len(power):
        power = np.full((1, size // 2 + 1), float(np.mean([np.var(one) for one in residuals])) + 1e-30)
    total = np.log(power + 1e-300).mean(axis=1)
    weight = np.minimum(1.0, np.exp(np.median(total) + 0.7 - total))
    mean = weight @ power / weight.sum()
    return np.asarray(fft.rfftfreq(size, step)), _smooth(mean)


def _windows(residuals: Sequence[Array], used: Sequence[Flags], size: int) -> Array:
    taper = np.hanning(size + 1)[:-1]
    found = []
    for residual, flags in zip(residuals, used, strict=True):
        sums = np.concatenate([[0], np.cumsum(flags)])
        starts = np.arange(0, len(residual) - size + 1, max(1, size // 2))
        starts = starts[sums[starts + size] - sums[starts] == size]
        if len(starts):
            cut = residual[starts[:, None] + np.arange(size)] * taper
            found.append(np.abs(fft.rfft(cut, axis=1)) ** 2 / (taper**2).sum())
    return np.concatenate(found) if found else np.empty((0, size // 2 + 1))


def _smooth(power: Array) -> Array:
    """Average over neighbours, more of them at high frequencies, in logarithms."""
    at = np.arange(len(power))
    reach = np.rint(0.05 * at + 0.3).astype(int)
    low, high = np.maximum(at - reach, 0), np.minimum(at + reach + 1, len(power))
    sums = np.concatenate([[0.0], np.cumsum(power)])
    smooth = (sums[high] - sums[low]) / (high - low)
    smooth[0] = max(smooth[0], smooth[min(1, len(smooth) - 1)])  # the window's taper leaves little at 0
    return np.asarray(np.maximum(smooth, FLOOR * smooth.max() + 1e-300))


def whitener(frequency: Array, power: Array, step: float) -> Array:
    """Return the causal filter (L,) whose output has a variance of 1 for noise of this density."""
    length = round(MEMORY_S / step)
    size = fft.next_fast_len(4 * length, real=True)
    fine = fft.rfftfreq(size, step)
    gain = -0.5 * np.interp(fine, frequency, np.log(power))
    cepstrum = fft.irfft(gain, size)
    half = (size + 1) // 2
    cepstrum[1:half] *= 2.0
    cepstrum[size // 2 + 1 :] = 0.0
    taps = fft.irfft(np.exp(fft.rfft(cepstrum)), size)[:length]
    taps[length // 2 :] *= np.linspace(1.0, 0.0, length - length // 2)
    return np.asarray(taps)


def high_pass(gains: Array, leak: float, step: float) -> Array:
    """Sum gains (N - 1, K) of each row over the row before, leaking by `leak` [1/s]: (N, K)."""
    out = np.zeros((len(gains) + 1, gains.shape[1]))
    out[1:] = lfilter([1.0], [1.0, -np.exp(-leak * step)], gains, axis=0)
    return out
