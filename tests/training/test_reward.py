"""The reward points where it should."""

from typing import Any

import numpy as np
import pytest

from training.reward import TrackingReward, Transition

REWARD = TrackingReward(error=1.0, output=0.5, change=2.0)
STILL = np.full((1, 4), 0.2, np.float32)


def value(error: Any, action: Any, before: Any) -> float:
    step = Transition(
        setpoint=error,
        error=error,
        error_before=error,
        action=action,
        action_before=before,
        excess=np.zeros_like(action),
    )
    return float(REWARD(step)[0])


def test_reward_is_its_formula() -> None:
    error = np.deg2rad([[50.0, -100.0, 0.0]])
    action = np.array([[0.1, 0.3, 0.2, 0.4]], np.float32)
    expected = -1.5 - 0.5 * 0.25 - 2.0 * np.mean([0.1, 0.1, 0.0, 0.2])
    assert value(error, action, STILL) == pytest.approx(expected, rel=1e-6)


def test_less_error_less_output_and_less_change_are_each_worth_more() -> None:
    some = np.deg2rad([[30.0, 30.0, 30.0]])
    base = value(some, STILL, STILL)
    assert value(some / 2, STILL, STILL) > base
    assert value(some, STILL / 2, STILL / 2) > base
    restless = STILL + np.array([[0.1, -0.1, 0.1, -0.1]], np.float32)
    assert value(some, restless, STILL) < base
