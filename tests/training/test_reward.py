"""The reward points where it should."""

import numpy as np
import pytest

from training.reward import TrackingReward

REWARD = TrackingReward(error=1.0, output=0.5, change=2.0)
STILL = np.full((1, 4), 0.2, np.float32)


def test_reward_is_its_formula() -> None:
    error = np.deg2rad([[50.0, -100.0, 0.0]])
    action = np.array([[0.1, 0.3, 0.2, 0.4]], np.float32)
    expected = -1.5 - 0.5 * 0.25 - 2.0 * np.mean([0.1, 0.1, 0.0, 0.2])
    assert REWARD(error, action, STILL)[0] == pytest.approx(expected, rel=1e-6)


def test_less_error_less_output_and_less_change_are_each_worth_more() -> None:
    some = np.deg2rad([[30.0, 30.0, 30.0]])
    base = REWARD(some, STILL, STILL)
    assert REWARD(some / 2, STILL, STILL) > base
    assert REWARD(some, STILL / 2, STILL / 2) > base
    restless = STILL + np.array([[0.1, -0.1, 0.1, -0.1]], np.float32)
    assert REWARD(some, restless, STILL) < base
