"""Moments from outside that episodes are drawn with."""

from __future__ import annotations

import numpy as np
import pytest

from neuroflight.training.learners.pathwise.batch import (
    CALM,
    LEAST,
    WASH_HZ,
    WASH_YAW,
    WASHED,
    YAW,
    disturbances,
    washes,
)

COUNT, LARGEST = 1000, 30.0


@pytest.mark.parametrize("rate_hz", [1000, 2000])
def test_wash_has_its_band_and_size(rate_hz: int) -> None:
    drawn = washes(COUNT, rate_hz, rate_hz, LARGEST, np.random.default_rng(1)).astype(np.float64)
    shaken = drawn[np.abs(drawn).max(axis=(1, 2)) > 0.0]
    assert len(shaken) / COUNT == pytest.approx(WASHED, abs=0.05)
    # Uniform to the largest, so the mean square is a third of its square.
    assert shaken[..., :2].std() == pytest.approx(LARGEST / np.sqrt(3.0), rel=0.08)
    assert shaken[..., 2].std() / shaken[..., 0].std() == pytest.approx(WASH_YAW, rel=0.05)
    power = np.square(np.abs(np.fft.rfft(shaken[..., 0], axis=1))).mean(axis=0)  # by 1 Hz
    low, high = (round(edge) for edge in WASH_HZ)
    assert power[low : high + 1].sum() > 0.45 * power.sum()
    assert power[2 * high] < 0.35 * power[high // 4]


def test_disturbances_are_of_drawn_size_and_smooth_and_have_a_part_that_stays() -> None:
    drawn = disturbances(COUNT, 3000, 1000, LARGEST, np.random.default_rng(1)).astype(np.float64)
    sizes = np.sqrt(np.square(drawn[:, ::150, :2]).mean(axis=(1, 2)))
    assert (sizes == 0.0).mean() == pytest.approx(CALM, abs=0.05)
    pushed = drawn[sizes > 0.0]
    # Log-uniform from LEAST of the largest; what moves and what stays have this standard deviation each.
    assert np.median(sizes[sizes > 0.0]) == pytest.approx(LARGEST * np.sqrt(2.0 * LEAST), rel=0.2)
    stays = pushed.mean(axis=1)
    moves = pushed - stays[:, None]
    assert stays[:, 0].std() > moves[..., 0].std() > 0.0
    assert pushed[..., 2].std() == pytest.approx(YAW * pushed[..., 0].std(), rel=0.15)
    assert np.abs(np.diff(drawn, axis=1)).max() < 10.0 * LARGEST * 0.001 / 0.15
