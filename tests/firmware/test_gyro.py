"""gyro.c: counts to body rates and the still calibration."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from toolchain.contract import CALIBRATION_MS

LSB_RAD_S = math.radians(2000) / 32768
CLOCKWISE_DEG = (0, 90, 180, 270)  # in the order of enum board_alignment
Gyro = Callable[..., Any]


@pytest.fixture
def make_gyro(puppet: Any) -> Gyro:
    def make(rate_hz: int = 1000, alignment: int = 0, stuck_ms: int = 0) -> Any:
        gyro = puppet.new("struct gyro *")
        assert puppet.lib.gyro_init(gyro, rate_hz, alignment, stuck_ms) == 0
        return gyro

    return make


@pytest.fixture
def step(puppet: Any) -> Callable[..., list[float]]:
    out = puppet.new("float[3]")

    def one(gyro: Any, counts: Any) -> list[float]:
        sample = puppet.new("struct imu_sample *", ([int(c) for c in counts], (0, 0, 0), 0, True))
        puppet.lib.gyro_step(gyro, sample, out)
        return list(out)

    return one


@pytest.mark.parametrize("alignment", range(4))
def test_rates_match_the_float64_formula_when_counts_are_random(
    make_gyro: Gyro, step: Callable[..., list[float]], alignment: int
) -> None:
    gyro = make_gyro(alignment=alignment)
    # The chip is turned clockwise, so its readings turn by as much into body axes.
    angle = -math.radians(CLOCKWISE_DEG[alignment])
    turn = np.array(
        [[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0], [0, 0, 1]]
    )
    rng = np.random.default_rng(alignment)
    # Half the range: no further apart than a gyro moves in a sample.
    for counts in [(-25000, 25000, -25000), *rng.integers(-25000, 25001, (500, 3))]:
        expected = np.round(turn) @ np.array(counts, float) * LSB_RAD_S
        np.testing.assert_allclose(step(gyro, counts), expected, rtol=1.2e-7, atol=0)


@pytest.mark.parametrize("rate_hz", [1000, 4000, 8000])
def test_bias_is_removed_when_the_whole_window_was_still(
    make_gyro: Gyro, step: Callable[..., list[float]], rate_hz: int
) -> None:
    gyro = make_gyro(rate_hz, alignment=1)
    bias = np.array([100, -37, 5])
    rng = np.random.default_rng(1)
    noise = rng.normal(0, 20, (rate_hz * CALIBRATION_MS // 1000, 3)).round()
    for index, row in enumerate(noise):
        assert not gyro.calibrated, index
        step(gyro, bias + row)
    assert gyro.calibrated
    residue = np.array(step(gyro, bias)) / LSB_RAD_S
    x, y, z = -noise.mean(axis=0)
    np.testing.assert_allclose(residue, [y, -x, z], atol=1e-3)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize(
    ("mean_deg_s", "sigma_deg_s", "still"),
    [(0, 4.9, True), (0, 5.1, False), (19.9, 0, True), (20.1, 0, False), (-20.1, 0, False)],
)
def test_calibration_refuses_motion_when_spread_or_mean_is_beyond_its_limit(
    make_gyro: Gyro,
    step: Callable[..., list[float]],
    axis: int,
    mean_deg_s: float,
    sigma_deg_s: float,
    still: bool,
) -> None:
    gyro = make_gyro()
    for index in range(CALIBRATION_MS):
        deg_s = mean_deg_s + (sigma_deg_s if index % 2 else -sigma_deg_s)
        counts = [0, 0, 0]
        counts[axis] = round(deg_s * 32768 / 2000)
        step(gyro, counts)
    assert bool(gyro.calibrated) is still


def test_calibration_begins_anew_when_the_first_window_saw_motion(
    make_gyro: Gyro, step: Callable[..., list[float]]
) -> None:
    gyro = make_gyro()
    step(gyro, (30000, 0, 0))
    for _ in range(2 * CALIBRATION_MS - 2):
        step(gyro, (10, 0, 0))
    assert not gyro.calibrated
    step(gyro, (10, 0, 0))
    assert gyro.calibrated
    assert step(gyro, (10, 0, 0)) == [0, 0, 0]


@pytest.mark.parametrize("pair", [(-32759, -32759), (32759, 32759), (-20000, 31000)])
def test_sums_do_not_overflow_when_counts_are_extreme(
    make_gyro: Gyro, step: Callable[..., list[float]], pair: tuple[int, int]
) -> None:
    gyro = make_gyro(8000)
    for index in range(8 * CALIBRATION_MS):
        step(gyro, (pair[index % 2],) * 3)
    assert not gyro.calibrated


def test_init_refuses_when_the_alignment_is_unknown(puppet: Any) -> None:
    gyro = puppet.new("struct gyro *")
    assert puppet.lib.gyro_init(gyro, 1000, 4, 0) == puppet.lib.NF_ERR_ALIGNMENT
