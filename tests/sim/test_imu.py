"""The gyro's numbers."""

import numpy as np
import pytest

from sim.aircraft import load_aircraft
from sim.imu import counts, draw_bias, measured_rate, quantised_rate

NF1 = load_aircraft("nf1")


@pytest.mark.parametrize(
    ("deg_s", "expected"),
    [
        (0.0, 0),
        (1.0, 16),  # 16.384
        (2000 / 32768 * 0.499, 0),
        (2000 / 32768 * 0.501, 1),
        (-2000 / 32768 * 2.501, -3),
        (1999.99, 32767),
        (2500.0, 32767),
        (-2500.0, -32768),
    ],
)
def test_counts_round_to_nearest_and_saturate(deg_s: float, expected: int) -> None:
    assert counts(np.deg2rad(np.array([deg_s])))[0] == expected


def test_quantised_rate_is_within_half_a_count() -> None:
    rate = np.random.default_rng(0).uniform(-30, 30, (1000, 3))
    half = np.deg2rad(2000 / 32768) / 2
    rounding = 35 * 2.0**-24  # of float32 at the largest rate, 35 rad/s
    assert np.abs(quantised_rate(rate) - rate).max() <= half + rounding * 2


def test_noise_and_bias_have_the_logged_spread() -> None:
    rng = np.random.default_rng(1)
    rate = np.zeros((200_000, 3))
    seen = np.rad2deg(measured_rate(rate, np.zeros(3), NF1.gyro, rng))
    assert seen.std(axis=0) == pytest.approx([1.3373, 0.9990, 1.4516], rel=0.02)
    bias = np.rad2deg(draw_bias(NF1.gyro, 100_000, rng))
    assert bias.std() == pytest.approx(0.25, rel=0.02)
    assert bias.mean() == pytest.approx(0.0, abs=0.01)
