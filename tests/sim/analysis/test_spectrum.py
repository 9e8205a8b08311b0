"""Spectra of signals whose components are known."""

from __future__ import annotations

import numpy as np
import pytest

from neuroflight.sim.analysis.spectrum import components, smoothness, spectrum

STEP_S = 0.001
T = np.arange(4000) * STEP_S


def sine(amplitude: float, frequency_hz: float, t: np.ndarray = T) -> np.ndarray:
    """One motor, (T, 1), around a constant that has no part in a spectrum."""
    return (0.3 + amplitude * np.sin(2 * np.pi * frequency_hz * t + 0.4))[:, None]


@pytest.mark.parametrize(("amplitude", "frequency_hz"), [(0.2, 10.0), (0.01, 123.25), (0.05, 499.75)])
def test_component_has_the_amplitude_of_a_sine_when_it_is_one(amplitude: float, frequency_hz: float) -> None:
    parts = components(sine(amplitude, frequency_hz), STEP_S)
    at = int(np.argmin(np.abs(parts.frequency_hz - frequency_hz)))
    assert parts.frequency_hz[at] == pytest.approx(frequency_hz)
    assert parts.amplitude[at] == pytest.approx(amplitude)
    assert np.delete(parts.amplitude, at).max() < 1e-12


def test_component_at_half_the_sampling_rate_is_an_alternation_when_it_is_one() -> None:
    parts = components((0.3 + 0.05 * (-1.0) ** np.arange(4000))[:, None], STEP_S)
    assert parts.frequency_hz[-1] == 500.0
    assert parts.amplitude[-1] == pytest.approx(0.05)


def test_smoothness_is_amplitude_times_frequency_when_sines_are_summed() -> None:
    # 2 / (n f_s) sum M f with n = 2000 components and f_s = 1000 Hz: 1e-6 (0.2 * 10 + 0.01 * 123.25)
    both = sine(0.2, 10.0) + sine(0.01, 123.25)
    assert float(smoothness(components(both, STEP_S))) == pytest.approx(1e-6 * (2.0 + 1.2325))


def test_smoothness_is_known_when_the_output_is_white_noise() -> None:
    # Rayleigh's mean: M = sigma sqrt(pi / T) for T samples, and f is half of f_s / 2 on average.
    noise = np.random.default_rng(1).normal(0.4, 0.02, (200, 4000, 4))
    found = smoothness(components(noise, STEP_S))
    assert found.shape == (200,)
    assert found.mean() == pytest.approx(0.5 * 0.02 * np.sqrt(np.pi / 4000), rel=5e-3)


def test_smoothness_is_zero_when_nothing_changes() -> None:
    assert float(smoothness(components(np.full((4000, 4), 0.3), STEP_S))) == pytest.approx(0.0, abs=1e-15)


def test_motors_are_averaged_and_episodes_kept_apart() -> None:
    still = np.full_like(sine(0.1, 20.0), 0.3)
    outputs = np.stack([np.hstack([sine(0.1, 20.0), still]), np.hstack([still, still])])
    parts = components(outputs, STEP_S)
    assert parts.amplitude.shape == (2, 2000)
    assert parts.amplitude.max(axis=1) == pytest.approx([0.05, 0.0])


def test_samples_are_a_millisecond_apart_when_the_controller_is_faster() -> None:
    fine = np.arange(8000) * 0.0005
    slow, fast = components(sine(0.1, 20.0), STEP_S), components(sine(0.1, 20.0, fine), 0.0005)
    assert np.allclose(slow.frequency_hz, fast.frequency_hz)
    assert smoothness(fast) == pytest.approx(smoothness(slow))


def test_spectrum_rises_by_bands_when_all_components_are_alike() -> None:
    alternation = np.zeros((4000, 1))
    alternation[2000] = 1.0  # an impulse: every component is 2 / T
    drawn = spectrum(components(alternation, STEP_S))
    assert (np.diff(drawn.frequency_hz) > 0).all()
    assert 20 < len(drawn.frequency_hz) <= 60
    assert drawn.frequency_hz[0] == 0.25
    assert drawn.amplitude[:-1] == pytest.approx(np.full(len(drawn.amplitude) - 1, 2 / 4000))


@pytest.mark.parametrize("samples", [1, 2, 3])
def test_few_samples_have_few_components(samples: int) -> None:
    parts = components(np.zeros((5, samples, 4)), STEP_S)
    assert parts.amplitude.shape == (5, samples // 2)
    assert smoothness(parts).tolist() == [0.0] * 5
    assert len(spectrum(parts).frequency_hz) == samples // 2
