"""Spectra of a controller's motor outputs, and the smoothness figure Sm.

Sm = 2 / (n f_s) sum M_i f_i over n components (Mysore et al. 2021, "Regularizing Action Policies for Smooth
Control with Reinforcement Learning", eq. 4): the mean over components of amplitude times frequency in parts
of half the sampling rate. Here a signal is one motor of one whole episode, sampled each millisecond before
throttle mix and idle; there is no window, M_i is the amplitude of a sine at f_i, and the n components are
those from 1 / T up to half the sampling rate, the constant part left out. A sine weighs as 1 / n and noise
as 1 / sqrt(n): figures compare between episodes of one length only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from neuroflight.sim.arrays import Array

SAMPLE_S = 0.001  # [s] between the samples taken of an output, or its own step where that is longer
BANDS = 60  # of a drawn spectrum, evenly spaced in the logarithm of frequency
CHUNK = 64  # signals transformed at a time: their complex copies are the large ones


@dataclass(frozen=True, eq=False)
class Components:
    """Amplitudes of a controller's outputs, averaged over its motors."""

    frequency_hz: Array  # (n,) rising, above 0
    amplitude: Array  # (..., n) motor fraction
    rate_hz: float  # of the samples


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Mean amplitude of one component of a controller's motor outputs, band by band."""

    frequency_hz: Array  # (B,) rising, mean of each band's components
    amplitude: Array  # (B,) motor fraction

    def document(self) -> dict[str, list[float]]:
        """Return the spectrum for JSON, rounded to significant digits."""
        return {
            "frequency_hz": [float(f"{value:.5g}") for value in self.frequency_hz],
            "amplitude": [float(f"{value:.4g}") for value in self.amplitude],
        }


def components(output: ArrayLike, step_s: float) -> Components:
    """Compute the components of outputs (..., T, M), rows `step_s` [s] apart; none of one sample."""
    stride = max(1, round(SAMPLE_S / step_s))
    y = np.asarray(output)[..., ::stride, :]
    samples, motors = y.shape[-2:]
    frequency = np.arange(1, samples // 2 + 1) / (samples * stride * step_s)
    signals = y.reshape(-1, samples, motors)
    found = np.empty((len(signals), len(frequency)))
    for start in range(0, len(signals), CHUNK):
        part = slice(start, start + CHUNK)
        found[part] = np.abs(np.fft.rfft(signals[part], axis=1)[:, 1:]).mean(axis=2)
    found *= 2.0 / samples
    if samples % 2 == 0:
        found[:, -1:] /= 2.0  # the component at half the sampling rate has no mirror image
    return Components(frequency, found.reshape(*y.shape[:-2], -1), 1.0 / (stride * step_s))


def smoothness(parts: Components) -> Array:
    """Compute Sm of each episode, (...); 0 without a component."""
    count = max(1, len(parts.frequency_hz))
    weighed: Array = 2.0 / (count * parts.rate_hz) * (parts.amplitude @ parts.frequency_hz)
    return weighed


def spectrum(parts: Components, count: int = BANDS) -> Spectrum:
    """Average over episodes and over `count` bands of frequency; bands without a component are left out."""
    frequency = parts.frequency_hz
    mean = parts.amplitude.mean(axis=tuple(range(parts.amplitude.ndim - 1)))
    if len(frequency) < 2:
        return Spectrum(frequency, mean)
    edges = np.geomspace(frequency[0], frequency[-1], count + 1)[1:-1]
    band = np.searchsorted(edges, frequency, side="right")
    size = np.bincount(band)
    some = size > 0
    centre, height = (np.bincount(band, weights=w)[some] / size[some] for w in (frequency, mean))
    return Spectrum(centre, height)
