"""Figures of noise against records whose parameters are known.

Bounds are five standard errors of each estimate unless a comment says otherwise.
"""

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.signal import lfilter

from neuroflight.sim.aircraft.model import Gyro
from neuroflight.sim.arrays import Array
from neuroflight.sim.identification.gyro_noise import aircraft_keys, allan_deviation, doubts, measure_noise
from neuroflight.sim.identification.gyro_noise_plot import draw_noise
from neuroflight.sim.identification.recording import Recording
from neuroflight.sim.physics.imu import GyroModel, quantised_rate
from neuroflight.toolchain.errors import TraceError
from tests.sampling import examples

SIGMA, MEAN = np.array([1.3373, 0.9990, 1.4516]), np.array([-0.2546, 0.2419, 0.0790])
COUNT, RATE = 60_000, 1000.0


def white(count: int = COUNT, seed: int = 1) -> Array:
    """Samples in deg/s."""
    return np.asarray(MEAN + np.random.default_rng(seed).standard_normal((count, 3)) * SIGMA)


def record(gyro_deg_s: Array, rate_hz: float = RATE, acceleration: Array | None = None) -> Recording:
    return Recording(rate_hz, np.deg2rad(gyro_deg_s), acceleration, 0)


def low_passed(samples: Array, bandwidth_hz: float) -> Array:
    kept = math.exp(-2 * math.pi * bandwidth_hz / RATE)
    return np.asarray(lfilter([1 - kept], [1.0, -kept], samples, axis=0))


def test_sigma_mean_and_density_are_recovered_when_noise_is_white() -> None:
    noise = measure_noise(record(white()))
    error = 5 / math.sqrt(2 * COUNT)
    assert np.rad2deg(noise.gyro.sigma) == pytest.approx(SIGMA, rel=error)
    assert (np.abs(np.rad2deg(noise.gyro.mean) - MEAN) < 5 * SIGMA / math.sqrt(COUNT)).all()
    assert np.rad2deg(noise.gyro.density) == pytest.approx(SIGMA / math.sqrt(RATE), rel=0.03)
    assert noise.duration == pytest.approx(60.0)
    assert np.isnan(noise.gyro.bandwidth_hz).all()
    assert not noise.gyro.floor.any()
    assert not noise.moved
    assert doubts(noise) == []


def test_aircraft_keys_hold_sigma_and_the_spread_of_the_means_when_written() -> None:
    keys = aircraft_keys(measure_noise(record(white())))
    noise, bias = keys["gyro"]["noise_deg_s"], keys["gyro"]["bias_deg_s"]
    assert noise == pytest.approx(SIGMA, rel=0.02)
    assert bias == pytest.approx(math.sqrt((0.2546**2 + 0.2419**2 + 0.0790**2) / 3), rel=0.03)
    assert "accelerometer" not in keys


def test_figures_are_those_of_the_twins_gyro_when_it_made_the_record() -> None:
    settings = Gyro(noise=(0.03, 0.02, 0.01), bias=0.005)
    model = GyroModel(settings, 1, 1 / RATE, np.random.default_rng(2), 1.0)
    model.reset(np.arange(1))
    still, speed = np.zeros((1, 3)), np.zeros((1, 4))
    samples = np.array([quantised_rate(model.measure(still, None, speed))[0] for _ in range(20_000)])
    noise = measure_noise(Recording(RATE, samples.astype(np.float64), None, 0))
    assert noise.gyro.sigma == pytest.approx([0.03, 0.02, 0.01], rel=0.025)
    assert np.rad2deg(noise.gyro.step) == pytest.approx([2000 / 32768] * 3, rel=1e-4)


@pytest.mark.parametrize("sigma", [0.6, 1.0, 3.0])
def test_sigma_is_without_the_rounding_when_the_log_is_in_whole_degrees(sigma: float) -> None:
    samples = np.rint(np.random.default_rng(3).standard_normal((COUNT, 3)) * sigma + [0.3, 0.0, -0.2])
    noise = measure_noise(record(samples))
    assert np.rad2deg(noise.gyro.sigma) == pytest.approx([sigma] * 3, rel=0.02)
    assert doubts(noise) == []


def test_log_gets_a_warning_when_rounding_hides_the_noise() -> None:
    noise = measure_noise(record(np.rint(np.random.default_rng(3).standard_normal((COUNT, 3)) * 0.3)))
    assert [line.split(":")[0] for line in doubts(noise)] == ["roll", "pitch", "yaw"]
    assert "rounded to 1 deg/s" in doubts(noise)[0]


@pytest.mark.parametrize("bandwidth_hz", [20.0, 90.0, 250.0])
def test_bandwidth_is_recovered_when_noise_passed_a_low_pass(bandwidth_hz: float) -> None:
    source = np.random.default_rng(4).standard_normal((COUNT, 3)) * 5.0
    noise = measure_noise(record(low_passed(source, bandwidth_hz)))
    assert noise.gyro.bandwidth_hz == pytest.approx([bandwidth_hz] * 3, rel=0.08)
    # Below the bandwidth the noise is still the source's. The Allan deviation over the decade used is worth
    # about duration / (10 x its longest time) averages.
    assert np.rad2deg(noise.gyro.density) == pytest.approx([5.0 / math.sqrt(RATE)] * 3, rel=0.12)
    (line,) = doubts(noise)
    assert "not white" in line
    assert not noise.moved


def test_samples_get_a_warning_when_they_alternate() -> None:
    source = np.random.default_rng(5).standard_normal((COUNT, 3))
    (line,) = doubts(measure_noise(record(source[1:] - 0.5 * source[:-1])))
    assert "alternate" in line


def test_allan_deviation_falls_with_the_root_of_time_when_noise_is_white() -> None:
    tau, deviation = allan_deviation(white(), RATE)
    assert tau[0] == pytest.approx(1 / RATE)
    assert tau[-1] == pytest.approx(COUNT // 9 / RATE)
    expected = SIGMA / np.sqrt(RATE * tau)[:, None]
    averages = 60.0 / tau[:, None]
    assert (np.abs(deviation / expected - 1) < 5 / np.sqrt(averages)).all()


def test_allan_deviation_rises_with_the_root_of_time_when_the_rate_walks() -> None:
    """A random walk of K a root second gives K sqrt(tau / 3), for times of many samples."""
    steps = np.random.default_rng(6).standard_normal((COUNT, 3))
    tau, deviation = allan_deviation(np.cumsum(steps, axis=0) * 2.0 / math.sqrt(RATE), RATE)
    long = tau > 0.05
    expected = 2.0 * np.sqrt(tau[long] / 3)
    assert (np.abs(deviation[long].T / expected - 1) < 5 / np.sqrt(60.0 / tau[long])).all()


def test_allan_deviation_is_exact_when_the_rate_is_a_ramp() -> None:
    """A ramp of R a second gives R tau / sqrt(2)."""
    tau, deviation = allan_deviation(np.tile(3.0 * np.arange(2000)[:, None] / RATE, 3), RATE)
    assert deviation[:, 0] == pytest.approx(3.0 * tau / math.sqrt(2), rel=1e-6)


def test_bias_instability_is_the_floor_when_the_record_shows_one() -> None:
    """White noise N and a walk K: the least deviation is sqrt(2 N K / sqrt(3)), at sqrt(3) N / K."""
    rng, density, walk = np.random.default_rng(7), 0.03, 0.03
    count = 400_000
    samples = rng.standard_normal((count, 3)) * density * math.sqrt(RATE)
    samples += np.cumsum(rng.standard_normal((count, 3)), axis=0) * walk / math.sqrt(RATE)
    noise = measure_noise(record(samples))
    least = math.sqrt(2 * density * walk / math.sqrt(3))
    assert noise.gyro.floor.all()
    assert np.rad2deg(noise.gyro.instability) == pytest.approx([least / 0.664] * 3, rel=0.2)
    assert (np.abs(np.log10(noise.gyro.instability_s / math.sqrt(3))) < 0.5).all()


@pytest.mark.parametrize(
    "motion",
    [
        lambda t: 6.0 * np.sin(2 * np.pi * 0.7 * t),
        lambda t: 1.0 * np.sin(2 * np.pi * 0.5 * t),
        lambda t: 30.0 * np.sin(2 * np.pi * 4.0 * t),
        lambda t: np.where(np.abs(t - 30.0) < 0.2, 15.0, 0.0),
        lambda t: 0.3 * t,
    ],
    ids=["swing", "slow swing", "shake", "knock", "turn"],
)
def test_motion_is_noticed_when_the_aircraft_turns(motion: Callable[[Array], Array]) -> None:
    samples = white()
    samples[:, 1] += motion(np.arange(COUNT) / RATE)
    noise = measure_noise(record(samples))
    assert noise.moved
    assert "moved" in doubts(noise)[0]


@pytest.mark.parametrize(("scale", "rate_hz"), [(0.05, 8000.0), (1.0, 100.0), (20.0, 1000.0)])
def test_white_noise_is_neither_motion_nor_a_floor_when_at_rest(scale: float, rate_hz: float) -> None:
    for seed in range(examples(24)):
        noise = measure_noise(record(scale * white(20_000, round(rate_hz) + seed), rate_hz))
        assert not noise.moved
        assert not noise.gyro.floor.any()


def test_drift_of_a_warming_gyro_is_not_called_motion() -> None:
    drift = 0.005 * np.arange(COUNT)[:, None] / RATE  # 0.3 deg/s in a minute
    assert not measure_noise(record(0.05 * white() + drift)).moved


def test_accelerometer_is_measured_when_there_is_one() -> None:
    force = np.random.default_rng(8).standard_normal((COUNT, 3)) * [0.1, 0.2, 0.3] + [0.0, 0.5, 9.8]
    noise = measure_noise(record(white(), acceleration=force))
    assert noise.accelerometer is not None
    assert noise.accelerometer.sigma == pytest.approx([0.1, 0.2, 0.3], rel=0.015)
    assert aircraft_keys(noise)["accelerometer"]["noise_m_s2"] == pytest.approx((0.1, 0.2, 0.3), rel=0.015)


def test_gaps_are_mentioned_when_there_are_any() -> None:
    gyro = np.deg2rad(white())
    assert "missing in 3 places" in doubts(measure_noise(Recording(RATE, gyro, None, 3)))[0]


def test_record_is_refused_when_an_axis_is_stuck() -> None:
    samples = white()
    samples[:, 2] = 0.25
    with pytest.raises(TraceError, match=r"gyro yaw reads 0\.25 deg/s throughout"):
        measure_noise(record(samples))


def test_plot_has_two_panels_a_sensor_when_drawn() -> None:
    force = np.random.default_rng(8).standard_normal((COUNT, 3))
    recording = record(white(), acceleration=force)
    figure = draw_noise(measure_noise(recording), recording, "at rest")
    titles = [panel.get_title(loc="left") for panel in figure.axes]
    assert titles == [
        "gyro, Allan deviation",
        "gyro, samples about their mean",
        "accelerometer, Allan deviation",
        "accelerometer, samples about their mean",
    ]
    assert all(panel.get_xlabel() and panel.get_ylabel() for panel in figure.axes)


def test_plot_is_drawn_when_one_sample_is_far_out() -> None:
    samples = white()
    samples[5, 0] = 1e9
    recording = record(samples)
    histogram = draw_noise(measure_noise(recording), recording, "glitch").axes[1]
    assert len(histogram.patches) == 3
    corners = [len(np.asarray(outline.get_path().vertices)) for outline in histogram.patches]
    assert max(corners) < 500  # as many bins as ever, however far the slip lies
