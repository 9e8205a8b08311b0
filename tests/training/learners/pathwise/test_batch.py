"""Moments from outside that episodes are drawn with."""

from __future__ import annotations

import numpy as np
import pytest

from training.learners.pathwise.batch import (
    CALM,
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


def test_moments_from_outside_have_a_part_that_stays() -> None:
    drawn = disturbances(COUNT, 3000, 1000, LARGEST, np.random.default_rng(1)).astype(np.float64)
    pushed = drawn[np.abs(drawn).max(axis=(1, 2)) > 0.0]
    assert len(pushed) / COUNT == pytest.approx(1.0 - CALM, abs=0.05)
    stays = pushed.mean(axis=1)
    moves = pushed - stays[:, None]
    assert stays[:, 0].std() > moves[..., 0].std() > 0.0
    assert np.abs(pushed[..., 2]).mean() / np.abs(pushed[..., 0]).mean() == pytest.approx(YAW, rel=0.1)
    # Straight lines: nothing jumps from a control step to the next.
    assert np.abs(np.diff(pushed, axis=1)).max() < 0.02 * np.abs(pushed).max() * 2.0
