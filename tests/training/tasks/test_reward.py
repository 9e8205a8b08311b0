"""Rewards against their formulas, computed by hand."""

from typing import Any

import numpy as np
import pytest

from neuroflight.training.tasks.reward import (
    REWARDS,
    CalmReward,
    NormalizedReward,
    ProgressReward,
    Reward,
    SparseReward,
    TrackingReward,
    Transition,
)

REWARD = TrackingReward(error=1.0, output=0.5, change=2.0)
STILL = [0.2, 0.2, 0.2, 0.2]
THREE = {"error": [0, 0, 0], "action": [0, -1, 0, 0.4], "before": [0, 0, 0, 0.4]}  # motors stand


def worth(
    reward: Reward,
    *,
    error: Any,
    action: Any = STILL,
    before: Any = STILL,
    error_before: Any = (0.0, 0.0, 0.0),
    setpoint: Any = (0.0, 0.0, 0.0),
    setpoint_before: Any = None,
) -> float:
    """Reward of one step; rates in deg/s, actions before they are clipped."""
    unclipped = np.array([action], np.float32)
    step = Transition(
        setpoint=np.deg2rad([setpoint]),
        setpoint_before=np.deg2rad([setpoint if setpoint_before is None else setpoint_before]),
        error=np.deg2rad([error]),
        error_before=np.deg2rad([error_before]),
        unclipped=unclipped,
        action=np.clip(unclipped, 0, 1),
        action_before=np.array([before], np.float32),
    )
    value = reward(step)
    assert value.shape == (1,)
    assert value.dtype == np.float32
    return float(value[0])


def test_the_tracking_reward_is_its_formula() -> None:
    expected = -1.5 - 0.5 * 0.25 - 2.0 * 0.1
    seen = worth(REWARD, error=[50.0, -100.0, 0.0], action=[0.1, 0.3, 0.2, 0.4])
    assert seen == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        ([29.0, -30.0, 30.0], 0.0),
        ([0.0, 0.0, 0.0], 0.0),
        ([31.0, -30.0, 30.0], -1.0),
        ([0.0, -91.0, 0.0], -1.0),
    ],
)
def test_the_sparse_reward_is_nothing_or_a_penalty(error: list[float], expected: float) -> None:
    assert worth(SparseReward(), error=error) == expected
    assert worth(SparseReward(threshold_deg_s=92.0), error=error) == 0.0


def test_settling_costs_the_same_at_any_distance_beyond_its_limit() -> None:
    settle = TrackingReward(error=0.0, settle=0.5, output=0.0)
    assert worth(settle, error=[5.0, 0.0, 0.0]) == pytest.approx(-0.25, rel=1e-6)
    assert worth(settle, error=[-10.0, 20.0, 300.0]) == pytest.approx(-1.5, rel=1e-6)


def test_less_error_output_and_change_each_raise_the_tracking_reward() -> None:
    base = worth(REWARD, error=[30.0, 30.0, 30.0])
    assert worth(REWARD, error=[15.0, 15.0, 15.0]) > base
    assert worth(REWARD, error=[30.0, 30.0, 30.0], action=[0.1] * 4, before=[0.1] * 4) > base
    assert worth(REWARD, error=[30.0, 30.0, 30.0], action=[0.3, 0.1, 0.3, 0.1]) < base


@pytest.mark.parametrize(
    ("error", "expected"),
    [([0, 0, 0], 0.0), ([90, -180, 90], -0.4), ([300, 300, -300], -1.0), ([2000, 0, 0], -1.0)],
)
def test_the_reward_of_chapter_3_is_the_normalized_error(error: list[float], expected: float) -> None:
    assert worth(NormalizedReward(), error=error) == pytest.approx(expected, rel=1e-6)
    half = NormalizedReward(rate_max_deg_s=150.0)
    assert worth(half, error=error) == pytest.approx(max(-1.0, 2 * expected), rel=1e-6)


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        # 3^2 + 4^2 = 25; 300 (1 - 0.2) = 240; four motors at 0.5 100^2 each
        ({"error": [3, -4, 0]}, -25 + 240 + 20_000),
        # changes of 10, 0, 20 and 0 percent: 0.5 (4 10,000 - 100 - 400)
        ({"error": [3, -4, 0], "action": [0.3, 0.2, 0.0, 0.2]}, -25 + 247.5 + 19_750),
        # 6 deg/s is outside of a band of 5, and inside that of a command of 61
        ({"error": [6, 0, 0]}, -36 + 240),
        ({"error": [6, 0, 0], "setpoint": [61, 0, 0]}, -36 + 240 + 20_000),
        ({"error": [6, 0, 0], "setpoint": [0, 61, 0]}, -36 + 240),
        # a network may ask for more than there is; what counts is what it gets
        ({"error": [20, 0, 0], "action": [2, 2, 2, 2]}, -400),
    ],
)
def test_the_reward_of_chapter_4_is_its_formula(options: dict[str, Any], expected: float) -> None:
    assert worth(CalmReward(), **options) == pytest.approx(expected, rel=1e-5)
    assert worth(CalmReward(scale=1e-3), **options) == pytest.approx(1e-3 * expected, rel=1e-5)


def test_the_reward_of_chapter_4_takes_radians_and_thousandths() -> None:
    reward = CalmReward(error=np.deg2rad(1.0) ** 2, change=50.0, change_max=10.0)
    # (0.3 rad/s)^2 = 0.09; 300 (1 - 0.175) = 247.5; 50, 0, 150 and 0 thousandths of 100
    options: dict[str, Any] = {"setpoint": [200, 0, 0], "action": [0.25, 0.2, 0.05, 0.2]}
    expected = -0.09 + 247.5 + 0.5 * (100**2 - 50**2) + 0.5 * 2 * 100**2
    assert worth(reward, error=[np.rad2deg(0.3), 0.0, 0.0], **options) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        # from (30, 0, 40), 2,500, to (0, 20, 0), 400, outside of the band
        ({"error_before": [30, 0, -40], "error": [0, 20, 0]}, 2500 - 400),
        # in the band: 1000 (1 - 0.2)
        ({"error_before": [0, 0, 5], "error": [0, 0, -3]}, 25 - 9 + 800),
        # less than 12 % earns no more than 12 %
        ({"error": [0, 0, 0], "action": [0.05] * 4, "before": [0.05] * 4}, 880),
        # the largest change counts: 0.3, with a mean output of 0.225
        ({"error": [0, 0, 0], "action": [0.3, 0.2, 0.3, 0.1], "before": [0.0, 0.2, 0.2, 0.2]}, -300 + 775),
        # asked for 1.5 and 1.25: 0.75 beyond in all; outputs of 1, 1, 0, 0 from the same, mean 0.5
        ({"error": [0, 0, 0], "action": [1.5, 1.25, 0, -3], "before": [1, 1, 0, 0]}, 500 - 0.75e9),
        # all at full, nothing beyond
        ({"error": [0, 0, 0], "action": [1] * 4, "before": [1] * 4}, -1e9),
        ({"error": [9, 0, 0], "action": [2, 1, 1, 1], "before": [1] * 4}, -81 - 2e9),
        # three motors stand: only while a rate is asked for, at the sample that the action answers
        (THREE, 880),
        ({**THREE, "setpoint": [0, 0, 9], "setpoint_before": [0, 0, 0]}, 880),
        ({**THREE, "setpoint_before": [0, 0, 9]}, 880 - 1e9),
        # two may stand
        ({**THREE, "action": [0, 0, 0.4, 0.4], "before": [0, 0, 0.4, 0.4], "setpoint": [0, 0, 9]}, 800),
    ],
)
def test_the_reward_of_chapter_5_is_its_formula(options: dict[str, Any], expected: float) -> None:
    assert worth(ProgressReward(), **options) == pytest.approx(expected, rel=1e-5, abs=1e-2)
    assert worth(ProgressReward(scale=1e-3), **options) == pytest.approx(1e-3 * expected, rel=1e-5, abs=1e-5)


@pytest.mark.parametrize("name", REWARDS)
def test_each_of_many_aircraft_gets_its_own_reward(name: str) -> None:
    rng = np.random.default_rng(1)
    shapes = {"setpoint": 3, "setpoint_before": 3, "error": 3, "error_before": 3}
    rates = {key: rng.uniform(-2, 2, (20, width)) for key, width in shapes.items()}
    unclipped, before = rng.uniform(-0.2, 1.2, (2, 20, 6)).astype(np.float32)
    whole = Transition(**rates, unclipped=unclipped, action=np.clip(unclipped, 0, 1), action_before=before)
    rewards = REWARDS[name]()(whole)
    assert rewards.shape == (20,)
    for k in range(20):
        part = {key: getattr(whole, key)[[k]] for key in (*shapes, "unclipped", "action", "action_before")}
        assert REWARDS[name]()(Transition(**part))[0] == rewards[k]
