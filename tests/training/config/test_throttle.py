"""Throttles of episodes: those that stay, and those that move."""

import numpy as np
import pytest

from neuroflight.training.config.throttle import RAMP_S, moving_throttle
from neuroflight.training.config.training_config import WorldConfig


def test_throttle_begins_where_it_is_to_and_stays_in_range() -> None:
    start = np.linspace(0.1, 0.8, 200, dtype=np.float32)
    throttle = moving_throttle(start, 0.8, 1000, 1000, np.random.default_rng(1))
    assert throttle.shape == (200, 1000)
    assert throttle.dtype == np.float32
    assert throttle[:, 0] == pytest.approx(start)
    assert throttle.min() == 0.0
    assert 0.75 < throttle.max() <= 0.8 + 1e-6


def test_throttle_holds_and_ramps() -> None:
    throttle = moving_throttle(np.full(200, 0.4, np.float32), 0.8, 1000, 1000, np.random.default_rng(1))
    moving = np.diff(throttle, axis=1) != 0.0
    assert 0.2 < moving.mean() < 0.6
    assert moving.any(axis=1).mean() > 0.9
    longest = max(len(run) for row in moving for run in "".join("x" if m else " " for m in row).split())
    assert longest <= RAMP_S * 1000 + 1


def test_only_the_share_of_the_episodes_moves() -> None:
    world = WorldConfig(throttle_max=0.8, throttle_share=0.5, throttle_steps=0.4)
    throttle = world.draw_throttles(2000, 300, 1000, np.random.default_rng(3))
    moved = (throttle != throttle[:, :1]).any(axis=1)
    assert (throttle[:, 0] == 0.0).mean() == pytest.approx(0.5, abs=0.05)
    assert moved.mean() == pytest.approx(0.2 * 0.65, abs=0.06)
    assert not moved[throttle[:, 0] == 0.0].any()


def test_no_throttle_moves_unless_asked() -> None:
    throttle = WorldConfig(throttle_max=0.8).draw_throttles(50, 300, 1000, np.random.default_rng(3))
    assert (throttle == throttle[:, :1]).all()
